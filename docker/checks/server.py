"""The server's binary with what the chart and the alerts give it, where one is built."""

import os
import subprocess
import tempfile
import urllib.request
from pathlib import Path

import yaml

from . import metrics
from .chart import RENDERED
from .report import DOCKER, ROOT, Report


def check(report: Report) -> None:
    """Starts the release binary with the chart's configuration, reads its metrics, checks its health as the image does, and stops it."""
    binary = Path(os.environ.get("STEREOD", ROOT / "target/release/stereod"))
    if not binary.is_file():
        report.skip(
            "the binary with the chart's configuration", "target/release/stereod is not built (or name one by STEREOD=)"
        )
        return
    objects = {one["kind"]: one for one in yaml.safe_load_all(RENDERED.read_text()) if one}
    with tempfile.TemporaryDirectory() as folder:
        for name, text in objects["ConfigMap"]["data"].items():
            (Path(folder) / name).write_text(text)
        environment = {
            "STEREOD_HTTP": "127.0.0.1:0",
            "STEREOD_WORKERS": "1",
            "STEREOD_ZENOH_CONFIG": f"{folder}/zenoh.json5",
            "STEREOD_LOG": "stereod=info",
        }
        command = [binary, "serve", "--config", f"{folder}/stereod.toml"]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, env=environment, stdout=pipe, stderr=pipe, text=True) as server:
            try:
                url = server.stdout.readline().strip().rpartition(" ")[2]
                if not url:
                    report.bad("the binary with the chart's configuration", server.stderr.read())
                    return
                # Ready, or not, as soon as the workers have matched their dummy pair.
                next(line for line in server.stderr if "ready" in line)
                with urllib.request.urlopen(f"{url}/metrics", timeout=10) as answer:
                    exposition = answer.read().decode()
                healthy(report, url)
            finally:
                server.terminate()
            code = server.wait(timeout=70)
    report.all_of(
        "the binary takes the chart's configuration, and ends with 0", [f"it ended with {code}"] if code else []
    )
    # Counters and histograms by their samples, as Prometheus sees them.
    names = {line.split("{")[0].split(" ")[0] for line in exposition.splitlines() if not line.startswith("#")}
    gone = sorted(set(metrics.listed()) - names)
    report.all_of("the binary has every metric of server/METRICS.md", [f"{name} is not there" for name in gone])
    wrong = [
        f"{name}: {one}" for name, text in metrics.texts().items() for one in metrics.unknown_values(text, exposition)
    ]
    report.all_of("the binary has every value of a label that alerts and dashboard ask for", wrong)


def healthy(report: Report, url: str) -> None:
    """The image's health check, against a server that is there and one that isn't."""
    script, problems = DOCKER / "healthy", []
    port = url.rsplit(":", 1)[1]
    there = subprocess.run(
        [script], env={"STEREOD_HTTP": f"0.0.0.0:{port}", "PATH": os.defpath}, capture_output=True, check=False
    )
    if there.returncode:
        problems.append(f"it says that a ready server is not: {there.stderr.decode()}")
    absent = subprocess.run(
        [script], env={"STEREOD_HTTP": "0.0.0.0:1", "PATH": os.defpath}, capture_output=True, check=False
    )
    if not absent.returncode:
        problems.append("it says that an absent server is ready")
    report.all_of("docker/healthy tells a ready server from an absent one", problems)
