"""The image's last stage, really built by buildah around the release binary, and run. Its base is made by debootstrap: no registry is asked."""

import os
import shutil
import socket
import subprocess
import urllib.request
from pathlib import Path

from .report import DOCKER, ROOT, Report, tool

WHAT = "the image is built by buildah, and runs"
SUITE = "bookworm"
MIRROR = "http://deb.debian.org/debian"
BASE = ROOT / "target/docker/base"
STORE = ROOT / "target/docker/images"
BINARY = STORE / "binary/stereod"
ENVIRONMENT = {**os.environ, "STORAGE_DRIVER": "vfs", "BUILDAH_ISOLATION": "chroot"}
PAIR = ROOT / "clients/console/public/sample"
# Runs inside: a server that is healthy, until somebody says that it is enough, and its own exit code.
LIFE = """
stereod serve & server=$!
until healthy 2>/dev/null; do kill -0 $server || exit 1; sleep 0.1; done
echo "ready $(id -u)"
read -r _
kill -TERM $server
wait $server
"""


def check(report: Report) -> None:
    """Builds the stage, starts it as its own user, asks its health, has a pair matched, and stops it."""
    binary = Path(os.environ.get("STEREOD", ROOT / "target/release/stereod"))
    missing = [name for name in ("buildah", "debootstrap", "strip") if tool(name) is None]
    if missing:
        report.skip(WHAT, f"{' and '.join(missing)} not installed (Debian)")
    elif os.geteuid() != 0:
        report.skip(WHAT, "debootstrap and buildah's chroot take root")
    elif not binary.is_file():
        report.skip(WHAT, "target/release/stereod is not built (or name one by STEREOD=)")
    elif why := base_missing():
        report.skip(WHAT, why)
    else:
        shutil.rmtree(STORE, ignore_errors=True)
        try:
            problems = build_and_run(binary)
            megabytes = round(BINARY.stat().st_size / 1e6)
            report.all_of(f"{WHAT} ({megabytes} MB over its base)", problems)
        except subprocess.CalledProcessError as failed:
            report.bad(WHAT, f"{' '.join(map(str, failed.cmd))}\n{failed.stderr}")
        finally:
            shutil.rmtree(STORE, ignore_errors=True)


def base_missing() -> str | None:
    """Makes the base where it isn't there yet; why that is not possible."""
    if (BASE / "etc/debian_version").is_file():
        return None
    made = BASE.with_name("unfinished")
    shutil.rmtree(made, ignore_errors=True)
    made.parent.mkdir(parents=True, exist_ok=True)
    command = ["debootstrap", "--variant=minbase", SUITE, made, MIRROR]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stdout.strip().splitlines()
        return f"debootstrap could not make its base ({lines[-1] if lines else done.returncode})"
    made.rename(BASE)
    return None


def buildah(*words: str | Path) -> str:
    """What buildah prints."""
    done = subprocess.run(
        ["buildah", *store(), *words], env=ENVIRONMENT, capture_output=True, text=True, check=True, cwd=ROOT
    )
    return done.stdout.strip()


def store() -> list[str]:
    """Where images are kept: not where the machine has its own."""
    return ["--root", f"{STORE}/root", "--runroot", f"{STORE}/run"]


def build_and_run(binary: Path) -> list[str]:
    """What is wrong with the image."""
    empty = buildah("from", "scratch")
    buildah("add", "--quiet", empty, BASE, "/")
    buildah("commit", "--quiet", empty, f"debootstrapped:{SUITE}")
    # In the place of the stages that compile, and of the base that a registry would have.
    BINARY.parent.mkdir()
    shutil.copy(binary, BINARY)
    # As the stage that compiles does.
    subprocess.run(["strip", "--strip-debug", BINARY], capture_output=True, text=True, check=True)
    buildah(
        *("build", "--quiet", "--format", "docker", "--file", DOCKER / "Dockerfile", "--tag", "stereod"),
        *("--build-context", f"binary={BINARY.parent}"),
        *("--build-context", f"debian:{SUITE}-slim=container-image://localhost/debootstrapped:{SUITE}"),
        ROOT,
    )
    container = buildah("from", "stereod")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    command = ["buildah", *store(), "run", "--env", f"STEREOD_HTTP={address}", container, "bash", "-c", LIFE]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=ENVIRONMENT, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as running:
        problems = []
        said = next((line for line in running.stdout if line.startswith("ready")), "")
        if said.strip() != "ready 10001":
            problems.append(f"it did not become healthy as user 10001: {said}")
        else:
            problems += problems_of_a_pair(address)
        _, errors = running.communicate("enough\n", timeout=90)
        if running.returncode:
            problems.append(f"it ended with {running.returncode}\n{errors}")
    return problems


def problems_of_a_pair(address: str) -> list[str]:
    """Has the sample matched."""
    boundary = "a-boundary"
    body = b"".join(
        f'--{boundary}\r\nContent-Disposition: form-data; name="{side}"; filename="{side}.jpg"\r\n\r\n'.encode()
        + (PAIR / f"{side}.jpg").read_bytes()
        + b"\r\n"
        for side in ("left", "right")
    )
    headers = {
        "Content-Type": f"multipart/form-data; boundary={boundary}",
        "Accept": "image/png",
        "X-Latency-Budget-Ms": "60000",
    }
    request = urllib.request.Request(
        f"http://{address}/v1/stereo", body + f"--{boundary}--\r\n".encode(), headers
    )
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            picture = answer.read()
    except OSError as why:
        return [f"a pair was not matched: {why}"]
    return [] if picture.startswith(b"\x89PNG") else ["a pair was answered with something that is no PNG"]
