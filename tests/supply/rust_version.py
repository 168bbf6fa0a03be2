"""Checks the Rust version that is promised (`rust-version`): `make check-supply`.

One toolchain is installed as a rule, so this is what can be said: nothing that is built asks for a later Rust than promised, everything
that names a version names that one, and whether the tests run with exactly that version or with a later one.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Where else the version stands, and how.
NAMED_IN = {"docker/Dockerfile": r"FROM rust:([\d.]+)", "README.md": r"Rust ([\d.]+) or later"}


def numbers(version: str) -> tuple[int, ...]:
    """The parts of a version, the third 0 if it isn't there."""
    parts = tuple(int(part) for part in version.split("-")[0].split("."))
    return (*parts, 0)[:3]


def output(*command: str) -> str:
    """What a command prints."""
    return subprocess.run(command, cwd=ROOT, check=True, text=True, stdout=subprocess.PIPE).stdout


def main() -> int:
    packages = json.loads(output("cargo", "metadata", "--locked", "--format-version", "1"))["packages"]
    ours = {package["name"]: package for package in packages if package["source"] is None}
    promised = ours["stereod"]["rust_version"]
    wrong = [
        f"{name} promises Rust {package['rust_version']} in edition {package['edition']}, stereod {promised} in 2024"
        for name, package in ours.items()
        if (package["rust_version"], package["edition"]) != (promised, "2024")
    ]
    asking = {
        f"{package['name']} {package['version']}": package["rust_version"]
        for package in packages
        if package["rust_version"] is not None
    }
    wrong += [
        f"{name} needs Rust {version}: choose an earlier version of it, or promise {version}"
        for name, version in asking.items()
        if numbers(version) > numbers(promised)
    ]
    for file, pattern in NAMED_IN.items():
        named = re.findall(pattern, (ROOT / file).read_text())
        if not named or any(numbers(one)[:2] != numbers(promised)[:2] for one in named):
            wrong.append(f"{file} names {named or 'no version'}, the workspace {promised}")
    here = output("rustc", "--version").split()[1]
    if numbers(here) < numbers(promised):
        wrong.append(f"this is Rust {here}, which is earlier than promised")
    for one in wrong:
        print(f"FAILED   rust-version: {one}")
    if wrong:
        return 1
    print(f"ok       rust-version {promised}: none of {len(asking)} packages that say so needs a later one")
    if numbers(here)[:2] == numbers(promised)[:2]:
        print(f"ok       rust-version {promised}: it is the version here, so every build checks it")
    else:
        print(f"skipped  that {promised} builds it: this is {here}, try `cargo +{promised} check --locked --workspace`")
    return 0


if __name__ == "__main__":
    sys.exit(main())
