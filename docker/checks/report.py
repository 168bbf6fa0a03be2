"""What was checked, what was not and why, and what is wrong."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

DOCKER = Path(__file__).resolve().parents[1]
ROOT = DOCKER.parent


class Report:
    """Prints a line for each check and counts the failures."""

    def __init__(self) -> None:
        self.failures = 0
        self.passed = 0
        self.skipped = 0

    def good(self, what: str) -> None:
        """A check passed."""
        self.passed += 1
        print(f"ok       {what}")

    def skip(self, what: str, why: str) -> None:
        """A check could not be made here."""
        self.skipped += 1
        print(f"skipped  {what}: {why}")

    def bad(self, what: str, why: str) -> None:
        """A check failed."""
        self.failures += 1
        print(f"FAILED   {what}: {why}")

    def all_of(self, what: str, problems: list[str]) -> None:
        """A check passed if there are no problems."""
        for problem in problems:
            self.bad(what, problem)
        if not problems:
            self.good(what)

    def run(self, what: str, command: list[str | Path]) -> bool:
        """A check passed if a command ends with 0; what it says is shown if not."""
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
        if done.returncode == 0:
            self.good(what)
            return True
        self.bad(what, f"{Path(command[0]).name} ended with {done.returncode}\n{done.stdout}{done.stderr}".rstrip())
        return False


def tool(name: str) -> str | None:
    """Where a program is: beside this Python (its virtual environment), or on the path."""
    beside = Path(os.path.abspath(sys.executable)).with_name(name)
    return str(beside) if os.access(beside, os.X_OK) else shutil.which(name)
