"""Prometheus' configuration, alerts with their tests, and Grafana's dashboard."""

import json
import re
import tempfile
from pathlib import Path

import yaml

from . import metrics
from .report import DOCKER, Report, tool


def check(report: Report) -> None:
    """Checks docker/prometheus and docker/grafana."""
    alerts = yaml.safe_load((DOCKER / "prometheus/alerts.yml").read_text())
    tests = yaml.safe_load((DOCKER / "prometheus/alerts_test.yml").read_text())
    adapter = yaml.safe_load((DOCKER / "prometheus/adapter.yml").read_text())
    dashboard = json.loads((DOCKER / "grafana/dashboards/stereod.json").read_text())

    problems = alert_problems(alerts, tests)
    report.all_of("alerts: summary, description, action, a place in the runbook, and a test that raises them", problems)
    report.all_of("dashboard: every panel has its place, its text and its data source", dashboard_problems(dashboard))

    made = {rule["name"]["as"] for rule in adapter["rules"]["custom"]}
    queries = "\n".join(metrics.expressions(dashboard))
    metrics.check(report, made)
    promtool(report, queries, adapter)


def alert_problems(alerts: dict, tests: dict) -> list[str]:
    """What alerts lack."""
    raised: dict[str, set[bool]] = {}
    for test in tests["tests"]:
        for case in test["alert_rule_test"]:
            raised.setdefault(case["alertname"], set()).add(bool(case["exp_alerts"]))
    problems = []
    rules = [rule for group in alerts["groups"] for rule in group["rules"]]
    for rule in rules:
        name = rule["alert"]
        for text in ("summary", "description", "action"):
            if not rule["annotations"].get(text):
                problems.append(f"{name} has no {text}")
        if rule["labels"].get("severity") not in ("critical", "warning"):
            problems.append(f"{name} has no severity critical or warning")
        if True not in raised.get(name, set()):
            problems.append(f"{name} is raised by no test")
    if len({rule["alert"] for rule in rules}) != len(rules):
        problems.append("two alerts have the same name")
    runbook = (DOCKER / "RUNBOOK.md").read_text()
    problems += [f"{rule['alert']} is not in RUNBOOK.md" for rule in rules if f"`{rule['alert']}`" not in runbook]
    named = set(re.findall(r"`(Stereod\w+)`", runbook)) - {rule["alert"] for rule in rules}
    return problems + [f"RUNBOOK.md names {name}, which doesn't exist" for name in sorted(named)]


def dashboard_problems(dashboard: dict) -> list[str]:
    """What Grafana would stumble over, or show wrongly."""
    source = yaml.safe_load((DOCKER / "grafana/provisioning/datasources/prometheus.yml").read_text())["datasources"][0]
    problems = []
    taken: dict[tuple[int, int], tuple[str, int]] = {}
    ids = [panel["id"] for panel in dashboard["panels"]]
    if len(set(ids)) != len(ids):
        problems.append("two panels have the same id")
    for panel in dashboard["panels"]:
        title, place = panel["title"], panel["gridPos"]
        if place["x"] + place["w"] > 24:
            problems.append(f"{title} is beyond the right edge")
        for x in range(place["x"], place["x"] + place["w"]):
            for y in range(place["y"], place["y"] + place["h"]):
                other, id_of_other = taken.setdefault((x, y), (title, panel["id"]))
                if id_of_other != panel["id"]:
                    problems.append(f"{title} overlaps {other}")
        if panel["type"] == "row":
            continue
        if not panel["targets"] or not panel["description"]:
            problems.append(f"{title} has no query or no description")
        for of in [panel, *panel["targets"]]:
            if of["datasource"]["uid"] != source["uid"]:
                problems.append(f"{title} has a data source that is not provisioned")
    return sorted(set(problems))


def promtool(report: Report, queries: str, adapter: dict) -> None:
    """What promtool says, of the dashboard's queries too."""
    program = tool("promtool")
    if program is None:
        report.skip("promtool", "not installed (Debian: prometheus)")
        return
    folder = DOCKER / "prometheus"
    report.run("promtool check config", [program, "check", "config", folder / "prometheus.yml"])
    report.run("promtool check rules", [program, "check", "rules", folder / "alerts.yml"])
    report.run("promtool test rules", [program, "test", "rules", folder / "alerts_test.yml"])
    expressions = [line for line in queries.splitlines() if not line.startswith("label_values")]
    for rule in adapter["rules"]["custom"]:
        series = rule["seriesQuery"].split("{")[0]
        query = rule["metricsQuery"].replace("<<.Series>>", series).replace("<<.GroupBy>>", "pod")
        expressions.append(query.replace("<<.LabelMatchers>>", 'namespace="n", pod=~"a|b"'))
    rules = [
        {"record": f"query:{i}", "expr": one.replace("$__rate_interval", "1m")} for i, one in enumerate(expressions)
    ]
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "queries.yml"
        path.write_text(yaml.safe_dump({"groups": [{"name": "queries", "rules": rules}]}))
        report.run(
            f"promtool: {len(rules)} queries of the dashboard and the adapter are PromQL",
            [program, "check", "rules", path],
        )
