"""Writes the software bill of materials of stereod (CycloneDX 1.6, JSON): `make sbom`.

It has what `cargo build` links into or runs for the server on this platform: its normal and build dependencies, each with its licence, the
checksum of Cargo.lock, and the features that the whole workspace asks of it. The same commit gives the same file. Needs Python 3.11.
"""

import json
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from uuid import NAMESPACE_URL, uuid5

import tomllib
from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import HashAlgorithm, HashType, Property
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentScope, ComponentType
from cyclonedx.output.json import JsonV1Dot6
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packageurl import PackageURL

ROOT = Path(__file__).resolve().parents[2]


def output(*command: str) -> str:
    """What a command prints."""
    return subprocess.run(command, cwd=ROOT, check=True, text=True, stdout=subprocess.PIPE).stdout


def host() -> str:
    """The platform's triple."""
    return next(line.split()[1] for line in output("rustc", "-vV").splitlines() if line.startswith("host:"))


def reached(nodes: dict[str, dict], root: str) -> dict[str, set[str]]:
    """What each package that the root needs depends on, by their ids; development dependencies aside."""
    found: dict[str, set[str]] = {}
    waiting = [root]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        found[name] = {
            dependency["pkg"]
            for dependency in nodes[name]["deps"]
            if any(kind["kind"] in (None, "build") for kind in dependency["dep_kinds"])
        }
        waiting += found[name]
    return found


def component(package: dict, checksum: str | None, features: list[str]) -> Component:
    """A package as the bill has it."""
    name, version = package["name"], package["version"]
    # Older packages write a choice of licences with a slash.
    licence = (package["license"] or "").replace("/", " OR ").strip()
    purl = PackageURL("cargo", name=name, version=version)
    return Component(
        type=ComponentType.APPLICATION if name == "stereod" else ComponentType.LIBRARY,
        name=name,
        version=version,
        bom_ref=purl.to_string(),
        purl=purl,
        description=(package["description"] or "").strip() or None,
        scope=ComponentScope.REQUIRED,
        licenses=[LicenseFactory().make_from_string(licence)] if licence else [],
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=checksum)] if checksum else [],
        properties=[Property(name="cargo:features", value=" ".join(features))] if features else [],
    )


def main() -> int:
    target = Path(sys.argv[1])
    metadata = json.loads(output("cargo", "metadata", "--locked", "--format-version", "1", "--filter-platform", host()))
    lock = tomllib.loads((ROOT / "Cargo.lock").read_text())["package"]
    checksums = {(one["name"], one["version"]): one.get("checksum") for one in lock}
    packages = {package["id"]: package for package in metadata["packages"]}
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    root = next(package["id"] for package in packages.values() if package["name"] == "stereod")
    needs = reached(nodes, root)
    components = {
        one: component(
            packages[one], checksums[packages[one]["name"], packages[one]["version"]], nodes[one]["features"]
        )
        for one in needs
    }
    bom = Bom(components=[part for one, part in components.items() if one != root])
    bom.metadata.component = components[root]
    bom.metadata.timestamp = datetime.fromtimestamp(int(output("git", "log", "-1", "--format=%ct")), UTC)
    bom.serial_number = uuid5(NAMESPACE_URL, "\n".join(sorted(needs)) + output("git", "rev-parse", "HEAD"))
    for one, dependencies in needs.items():
        bom.register_dependency(components[one], [components[other] for other in dependencies])
    text = JsonV1Dot6(bom).output_as_string(indent=1)
    wrong = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    nameless = [part.name for part in components.values() if not part.licenses]
    if wrong or nameless:
        sys.exit(f"the bill of materials is not as its schema says: {wrong}, without a licence: {nameless}")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text + "\n")
    print(f"{target}: {len(components) - 1} components of stereod {packages[root]['version']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
