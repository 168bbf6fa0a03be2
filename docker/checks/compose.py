"""The compose file."""

import json
import subprocess
import tempfile

import yaml

from .images import unknown_flags, variables
from .report import DOCKER, ROOT, Report, tool

FILE = DOCKER / "compose.yaml"
# Largest budget (60 s), withdrawal (1 s), Zenoh's and the connections' closing (3 s and 2 s): server/src/lib.rs, Running::shutdown.
DRAIN_S = 66


def check(report: Report) -> None:
    """Checks docker/compose.yaml."""
    compose = yaml.safe_load(FILE.read_text())
    report.all_of(
        "docker/compose.yaml: hardened services, loopback ports, files and dependencies that exist", problems(compose)
    )
    router = (ROOT / "Cargo.lock").read_text().split('name = "zenoh"\nversion = "')[1].split('"')[0]
    image = compose["services"]["router"]["image"]
    report.all_of(
        "docker/compose.yaml: the router has the version of the server's Zenoh",
        [] if image == f"eclipse/zenoh:{router}" else [f"{image}, and Cargo.lock has zenoh {router}"],
    )
    zenoh_files(report)
    for program in (["docker", "compose"], ["docker-compose"]):
        path = tool(program[0])
        if path is None:
            continue
        command = [path, *program[1:]]
        version = subprocess.run([*command, "version", "--short"], capture_output=True, text=True, check=False)
        if version.returncode:
            continue
        name = f"{' '.join(program)} config"
        if not version.stdout.removeprefix("v").startswith("1."):
            report.run(name, [*command, "--file", FILE, "config", "--quiet"])
            return
        # Version 1, which is Debian's, knows everything in the file but its name.
        with tempfile.NamedTemporaryFile("w", suffix=".yaml") as copy:
            lines = FILE.read_text().splitlines(keepends=True)
            copy.write("".join(line for line in lines if not line.startswith("name:")))
            copy.flush()
            report.run(
                f"{name}, version 1, without the file's name",
                [*command, "--project-directory", DOCKER, "--file", copy.name, "config", "--quiet"],
            )
        return
    report.skip("docker compose config", "Docker Compose is not installed")


def zenoh_files(report: Report) -> None:
    """Zenoh's own word on the routers' files."""
    try:
        import zenoh
    except ImportError:
        report.skip("the routers' files", "zenoh is not installed (PyPI: eclipse-zenoh)")
        return
    for path in sorted(DOCKER.glob("zenoh-*.json5")):
        try:
            mode = json.loads(zenoh.Config.from_file(str(path)).get_json("mode"))
        except zenoh.ZError as why:
            report.bad(f"docker/{path.name} is taken by Zenoh", str(why))
        else:
            report.all_of(f"docker/{path.name} is taken by Zenoh", [] if mode == "router" else [f"its mode is {mode}"])


def problems(compose: dict) -> list[str]:
    """What is wrong with the services, by the compose specification's basics and the house's rules."""
    found = []
    services, volumes = compose["services"], compose.get("volumes", {})
    for name, service in services.items():
        if service.get("read_only") is not True or service.get("cap_drop") != ["ALL"]:
            found.append(f"{name} is not read-only without capabilities")
        if "no-new-privileges:true" not in service.get("security_opt", []):
            found.append(f"{name} may get new privileges")
        if str(service.get("user", "1")).split(":")[0] in ("0", "root"):
            found.append(f"{name} runs as root")
        if "mem_limit" not in service:
            found.append(f"{name} has no limit of memory")
        if build := service.get("build"):
            if not (FILE.parent / build["context"] / build["dockerfile"]).is_file():
                found.append(f"{name}: there is no {build['dockerfile']}")
        elif ":" not in service["image"] or service["image"].endswith(":latest"):
            found.append(f"{name}: {service['image']} names no version")
        for port in service.get("ports", []):
            if not port.startswith("127.0.0.1:"):
                found.append(f"{name} is open to more than the loopback: {port}")
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            if source.startswith(".") and not (FILE.parent / source).exists():
                found.append(f"{name}: there is no {source}")
            if not source.startswith(".") and source not in volumes:
                found.append(f"{name}: the volume {source} is not declared")
        needed = service.get("depends_on", [])
        for other in needed:
            if other not in services:
                found.append(f"{name} depends on {other}, which doesn't exist")
            elif isinstance(needed, dict) and "healthcheck" not in services[other]:
                found.append(f"{name} waits for {other}'s health, which nobody checks")
    return found + server_problems(services["server"])


def server_problems(server: dict) -> list[str]:
    """What is wrong with the server's service."""
    found = unknown_flags(server["command"])
    found += [f"the server has no variable {one}" for one in server["environment"] if one not in variables()]
    grace = int(server["stop_grace_period"].removesuffix("s"))
    if grace < DRAIN_S:
        found.append(f"stop_grace_period is {grace} s, a drain takes up to {DRAIN_S} s")
    if "shm_size" not in server or not any(one.startswith("/tmp") for one in server["tmpfs"]):
        found.append("the server needs shm_size and /tmp")
    port = server["environment"]["STEREOD_HTTP"].rsplit(":", 1)[1]
    if not any(one.endswith(f":{port}") for one in server["ports"]):
        found.append(f"the server listens on {port}, which is not published")
    return found
