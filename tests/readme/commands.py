"""Types every command of the README, as a reader would, against the release binaries: `make test-readme`.

What is built already is not built again (`cargo run ..` becomes the program), the README's ports become free ones, and FOLDER, left.png
and right.png are the demo's pair. A command that is neither run nor named in `LEFT_OUT` with the reason is a failure.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 120

LEFT_OUT = {
    "make demo": "its program is run first of all, for the pair",
    "make test": "this is a part of it",
    "make figures": "takes minutes, and data that can't be had from a registry",
    "make eval": "takes minutes, and data that can't be had from a registry",
    "make stages": "measures for a minute; its options are tested with the evaluation",
    "make load": "takes a quarter of an hour",
    "make soak": "takes half an hour",
    "make rejections": "takes two minutes; what it does is tested with the load generator",
    "make faults": "takes two minutes, and its quick part is in the tests",
    "make check-docker": "has a run of its own",
    "docker compose": "needs Docker",
    "helm install": "needs a cluster",
}
# Servers, cameras and viewers: there until they are stopped, and known to work by what they print.
ENDLESS = {"serve": "listening on ", "camera.py": "is served by", "stream.py": " rungs ("}
# Those whose answer may be no.
ANSWERS = {"cargo load": (0, 2), "stereo doctor": (1,)}


def commands(readme: str) -> list[str]:
    """Every command of every `sh` block, continued lines joined, comments dropped."""
    found = []
    for block in re.findall(r"^```sh\n(.*?)^```", readme, re.MULTILINE | re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            command = re.sub(r"\s{2,}# .*| # \"servers.*", "", line).strip()
            if command:
                found.append(command)
    return found


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


class Reader:
    """Who types the commands."""

    def __init__(self, folder: Path, programs: Path) -> None:
        self.folder = folder
        self.programs = programs
        self.ports = {port: str(free_port()) for port in ("8080", "8081", "7447", "9090")}
        self.running: list[subprocess.Popen[str]] = []

    def translated(self, command: str) -> str:
        """The command with the programs that are there, and ports that are free."""
        for pattern, program in (
            (r"cargo run --release -p stereod --", f"{self.programs}/stereod"),
            (r"cargo run --release -p stereo-cli --", f"{self.programs}/stereo"),
            (r"cargo run --release -p stereo-client --example (\w+) --", rf"{self.programs}/examples/\1"),
            (r"cargo run --release -p stereo-scheduler --example (\w+)", rf"{self.programs}/examples/\1"),
            (r"cargo load", f"{self.programs}/load --seconds 2"),
            (r"^curl ", "curl --fail "),
            (r"^stereo ", f"{self.programs}/stereo "),
            (r"^python ", f"{sys.executable} -u "),
            (r"clients/python/", f"{ROOT}/clients/python/"),
            (r"target/registry-pair/", f"{self.programs.parent}/registry-pair/"),
        ):
            command = re.sub(pattern, program, command)
        if re.search(r"stereod serve\b", command) and "--http" not in command:
            command += " --http 127.0.0.1:8080"
        for named, port in self.ports.items():
            command = re.sub(rf"(?<=:){named}\b", port, command)
        return command.replace("FOLDER", "frames")

    def type(self, command: str) -> str | None:
        """Runs it; what is wrong with it, if anything."""
        endless = next((sign for word, sign in ENDLESS.items() if re.search(rf"\b{re.escape(word)}\b", command)), None)
        if re.search(r" serve\b", command) and "--instance two" not in command:
            # The same ports again: the one before goes.
            self.stop()
        # What stays is the program itself, not a shell around it: when it is stopped, its ports are free.
        process = subprocess.Popen(
            ("exec " if endless else "") + self.translated(command),
            shell=True,
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )
        if endless is not None:
            self.running.append(process)
            return self.wait_for(process, endless) or self.wait_ready(command)
        try:
            output, _ = process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return f"not done after {PATIENCE_S} s"
        good = next((codes for start, codes in ANSWERS.items() if command.startswith(start)), (0,))
        return None if process.returncode in good else f"ended with {process.returncode}:\n{output}"

    def wait_for(self, process: subprocess.Popen[str], sign: str) -> str | None:
        """Reads until the sign comes; the rest is read away so that nobody has to wait."""
        stopper = threading.Timer(PATIENCE_S, os.killpg, (process.pid, signal.SIGKILL))
        stopper.start()
        read = ""
        for line in process.stdout:
            read += line
            if sign in line:
                stopper.cancel()
                threading.Thread(target=process.stdout.read, daemon=True).start()
                return None
        stopper.cancel()
        return f"never printed {sign!r}:\n{read}"

    def wait_ready(self, command: str) -> str | None:
        """A reader is slower than a server that makes ready."""
        if not re.search(r"\bserve\b", command):
            return None
        port = self.ports[next((port for port in ("8081", "9090") if port in command), "8080")]
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/readyz"):
                    return None
            except OSError:
                time.sleep(0.05)
        return "never got ready"

    def stop(self) -> None:
        for process in reversed(self.running):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)
            process.wait()
        self.running.clear()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--programs", type=Path, default=ROOT / "target/release", help="where the release binaries are")
    programs = parser.parse_args().programs.resolve()
    readme = (ROOT / "README.md").read_text()
    failed, typed, left_out = 0, 0, 0
    example = (ROOT / "clients/rust/examples/depth.rs").read_text().split("\n", 2)[2]
    if example not in readme:
        sys.exit("the README has another Rust example than clients/rust/examples/depth.rs: copy it there")
    with tempfile.TemporaryDirectory() as folder:
        reader = Reader(Path(folder), programs)
        subprocess.run([programs / "demo", "--once"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        for side in ("left", "right"):
            image = programs.parent / f"registry-pair/motorcycle_{side}.png"
            shutil.copy(image, reader.folder / f"{side}.png")
            frames = reader.folder / "frames" / side
            frames.mkdir(parents=True)
            for number in range(300):
                (frames / f"{number:06}.png").symlink_to(image)
        try:
            for command in commands(readme):
                if any(command.startswith(known) for known in LEFT_OUT):
                    left_out += 1
                    continue
                wrong = reader.type(command)
                typed += 1
                print(f"{'FAILED' if wrong else 'ok'}: {command}")
                if wrong:
                    failed += 1
                    print(wrong)
        finally:
            reader.stop()
    print(
        f"{typed - failed} commands of the README work, {failed} don't; {left_out} are left out for the reasons in {Path(__file__).name}"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
