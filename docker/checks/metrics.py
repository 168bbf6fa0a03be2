"""Every metric that is named anywhere exists, with its labels, in the server's own list."""

import json
import re

import yaml

from .report import DOCKER, ROOT, Report

# The end of the names of texts for people.
PROSE = "prose"
NAME = re.compile(r"\bstereod_[a-z0-9_]+\b")
SELECTOR = re.compile(r"\b(stereod_[a-z0-9_]+)\{([^}]*)\}")
MATCHER = re.compile(r'([a-z_]+)\s*(=~|!=|!~|=)\s*"([^"]*)"')
BY = re.compile(r"\b(?:by|on)\s*\(([^)]*)\)")
# Labels that Prometheus or Kubernetes adds, not the server.
ADDED = {"instance", "job", "le", "namespace", "pod", "alertname", "alertstate"}


def listed() -> dict[str, set[str]]:
    """Series and their labels, of the table in server/METRICS.md."""
    series: dict[str, set[str]] = {}
    for line in (ROOT / "server/METRICS.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) != 5 or not cells[0].startswith("`"):
            continue
        name, labels = cells[0].strip("`"), set(re.findall(r"`(\w+)`", cells[3]))
        endings = {"counter": ["_total"], "gauge": [""], "histogram": ["_bucket", "_sum", "_count"]}[cells[1]]
        series.update({name + ending: labels for ending in endings})
    return series


def problems_of(text: str, series: dict[str, set[str]], families: bool, known: set[str]) -> list[str]:
    """Names and labels in a text that don't exist; `families`: names without their endings are fine too, as in prose."""
    named = set(series) | known
    if families:
        named |= {re.sub("_(total|bucket|sum|count)$", "", name) for name in series}
    problems = [f"{name} is not in server/METRICS.md" for name in sorted(set(NAME.findall(text)) - named)]
    labels = set().union(*series.values()) | ADDED
    for name, matchers in SELECTOR.findall(text):
        for label, _, _ in MATCHER.findall(matchers):
            if name in series and label not in series[name] | ADDED:
                problems.append(f"{name} has no label {label}")
    for grouped in BY.findall(text):
        for label in re.findall(r"\b[a-z_]+\b", grouped):
            if label not in labels:
                problems.append(f"nothing has the label {label}")
    return problems


def unknown_values(text: str, exposition: str) -> list[str]:
    """Values of labels in a text's selectors that a running server's metrics don't have."""
    problems = []
    for name, matchers in SELECTOR.findall(text):
        for label, _, pattern in MATCHER.findall(matchers):
            if label in ADDED or "$" in pattern:
                continue
            there = set(re.findall(rf'^{name}\{{[^}}]*\b{label}="([^"]*)"', exposition, re.MULTILINE))
            problems += [f'{name} has no {label}="{one}"' for one in pattern.split("|") if one not in there]
    return sorted(set(problems))


def expressions(dashboard: dict) -> list[str]:
    """All queries of a Grafana dashboard."""
    panels = [target["expr"] for panel in dashboard["panels"] for target in panel.get("targets", [])]
    lists = [one["query"]["query"] for one in dashboard["templating"]["list"]]
    return panels + lists


def check(report: Report, known: set[str]) -> None:
    """Checks the names in each text; `known` are those that are made of others."""
    series = listed()
    if len(series) < 10:
        report.bad("server/METRICS.md", "no table of metrics found in it")
        return
    for name, text in texts().items():
        problems = problems_of(text, series, name.endswith(PROSE), known)
        report.all_of(f"{name}: its {len(set(NAME.findall(text)))} metrics exist", problems)
    runbook = set(NAME.findall((DOCKER / "RUNBOOK.md").read_text()))
    unexplained = [
        f"it says nothing about {name}"
        for name in sorted({re.sub("_(total|bucket|sum|count)$", "", name) for name in series})
        if not runbook & {name, f"{name}_total"}
    ]
    report.all_of("docker/RUNBOOK.md: every metric of server/METRICS.md is in it", unexplained)


def texts() -> dict[str, str]:
    """The files in which metrics are named; of those with queries and prose, both by themselves."""
    alerts = yaml.safe_load((DOCKER / "prometheus/alerts.yml").read_text())
    tests = yaml.safe_load((DOCKER / "prometheus/alerts_test.yml").read_text())
    rules = [rule for group in alerts["groups"] for rule in group["rules"]]
    dashboard = json.loads((DOCKER / "grafana/dashboards/stereod.json").read_text())
    found = {
        "docker/prometheus/alerts.yml, queries": "\n".join(rule["expr"] for rule in rules),
        f"docker/prometheus/alerts.yml, {PROSE}": "\n".join(
            text for rule in rules for text in rule["annotations"].values()
        ),
        "docker/prometheus/alerts_test.yml": "\n".join(
            one["series"] for test in tests["tests"] for one in test["input_series"]
        ),
        "docker/grafana/dashboards/stereod.json": "\n".join(expressions(dashboard)),
        f"docker/RUNBOOK.md, {PROSE}": (DOCKER / "RUNBOOK.md").read_text(),
    }
    return found | {
        f"docker/{path}": (DOCKER / path).read_text() for path in ("prometheus/adapter.yml", "helm/rendered.yaml")
    }
