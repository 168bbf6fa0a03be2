"""The Helm chart, by its committed rendering."""

import hashlib
import subprocess
import sys

import yaml

from .compose import DRAIN_S
from .images import instructions, unknown_flags, variables
from .report import DOCKER, ROOT, Report, tool

RENDERED = DOCKER / "helm/rendered.yaml"
KINDS = {
    "ConfigMap",
    "Deployment",
    "HorizontalPodAutoscaler",
    "NetworkPolicy",
    "PodDisruptionBudget",
    "Service",
    "ServiceMonitor",
}
HELM = ["template", "stereod", DOCKER / "helm/stereod", "--values", DOCKER / "helm/rendered.values.yaml"]


def check(report: Report) -> None:
    """Checks docker/helm."""
    objects = {one["kind"]: one for one in yaml.safe_load_all(RENDERED.read_text()) if one}
    if missing := KINDS - objects.keys():
        report.bad("docker/helm/rendered.yaml", f"it has no {', '.join(sorted(missing))}")
        return
    report.all_of("chart: every object is labelled, every selector finds the pods", label_problems(objects))
    report.all_of(
        "chart: probes, drain, rights, volumes, resources",
        pod_problems(objects["Deployment"]["spec"]["template"]["spec"]),
    )
    report.all_of(
        "chart: ports, flags and names agree with the server, the image and each other", wiring_problems(objects)
    )
    report.all_of(
        "chart: rendered.yaml was made of what the chart is now",
        []
        if RENDERED.read_text().startswith(headline())
        else ["make it anew: docker/check --render (with helm installed)"],
    )
    schemas(report, list(objects.values()))
    helm(report)
    kubeconform = tool("kubeconform")
    if kubeconform is None:
        report.skip("kubeconform", "not installed")
    else:
        report.run("kubeconform", [kubeconform, "-strict", "-ignore-missing-schemas", RENDERED])


def headline() -> str:
    """The rendering's first line, which changes with the chart and the values: so that an old one is seen without helm."""
    files = [*(DOCKER / "helm/stereod").rglob("*"), DOCKER / "helm/rendered.values.yaml"]
    digest = hashlib.sha256()
    for path in sorted(path for path in files if path.is_file()):
        digest.update(f"{path.relative_to(DOCKER)}\0{path.read_text()}\0".encode())
    return f"# Made by docker/check --render; chart and values: sha256 {digest.hexdigest()}\n"


def render() -> None:
    """Writes the rendering anew."""
    program = tool("helm")
    if program is None:
        sys.exit("docker/check --render needs helm: install it (https://helm.sh)")
    done = subprocess.run([program, *HELM], stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        sys.exit(done.returncode)
    RENDERED.write_text(headline() + done.stdout)


def label_problems(objects: dict[str, dict]) -> list[str]:
    """Selectors that don't find what they are for."""
    pods = objects["Deployment"]["spec"]["template"]["metadata"]["labels"]
    service = objects["Service"]["metadata"]["labels"]
    selectors = {
        "Deployment": (objects["Deployment"]["spec"]["selector"]["matchLabels"], pods),
        "Service": (objects["Service"]["spec"]["selector"], pods),
        "PodDisruptionBudget": (objects["PodDisruptionBudget"]["spec"]["selector"]["matchLabels"], pods),
        "NetworkPolicy": (objects["NetworkPolicy"]["spec"]["podSelector"]["matchLabels"], pods),
        "ServiceMonitor": (objects["ServiceMonitor"]["spec"]["selector"]["matchLabels"], service),
    }
    for i, spread in enumerate(objects["Deployment"]["spec"]["template"]["spec"]["topologySpreadConstraints"]):
        selectors[f"topologySpreadConstraints[{i}]"] = (spread["labelSelector"]["matchLabels"], pods)
    found = [
        f"{name} selects {selector}, the labels are {labels}"
        for name, (selector, labels) in selectors.items()
        if not selector or not selector.items() <= labels.items()
    ]
    wanted = {
        "app.kubernetes.io/name",
        "app.kubernetes.io/instance",
        "app.kubernetes.io/version",
        "app.kubernetes.io/managed-by",
    }
    for kind, one in objects.items():
        if missing := wanted - one["metadata"].get("labels", {}).keys():
            found.append(f"{kind} has no label {', '.join(sorted(missing))}")
    return found


def pod_problems(pod: dict) -> list[str]:
    """What the pod lacks."""
    (container,) = pod["containers"]
    found = []

    def want(fine: object, otherwise: str) -> None:
        if not fine:
            found.append(otherwise)

    for probe, path in {"livenessProbe": "/livez", "readinessProbe": "/readyz", "startupProbe": "/livez"}.items():
        want(container[probe]["httpGet"] == {"path": path, "port": "http"}, f"{probe} doesn't ask {path}")
    before = int(container["lifecycle"]["preStop"]["exec"]["command"][-1])
    grace = pod["terminationGracePeriodSeconds"]
    want(grace >= before + DRAIN_S, f"{grace} s to stop, but {before} s before and up to {DRAIN_S} s for the drain")
    ready = container["readinessProbe"]
    want(
        before >= ready["periodSeconds"] * ready["failureThreshold"],
        "preStop is shorter than readiness takes to be noticed",
    )
    rights, of_pod = container["securityContext"], pod["securityContext"]
    want(of_pod["runAsNonRoot"] and of_pod["runAsUser"] > 0, "it may run as root")
    want(of_pod["seccompProfile"]["type"] == "RuntimeDefault", "it has no seccomp profile")
    want(rights["readOnlyRootFilesystem"] is True, "its root file system can be written")
    want(rights["allowPrivilegeEscalation"] is False, "it may get more rights")
    want(rights["capabilities"] == {"drop": ["ALL"]}, "it has capabilities")
    want(pod["automountServiceAccountToken"] is False, "it gets a token of the cluster")
    user = next(value for key, value in reversed(instructions("Dockerfile")) if key == "USER")
    want(str(of_pod["runAsUser"]) == user, f"it runs as {of_pod['runAsUser']}, the image has the user {user}")
    volumes = {volume["name"]: volume for volume in pod["volumes"]}
    mounts = {mount["mountPath"]: volumes.get(mount["name"]) for mount in container["volumeMounts"]}
    want(None not in mounts.values(), "a mount has no volume")
    for path in ("/dev/shm", "/tmp"):
        kept = (mounts.get(path) or {}).get("emptyDir", {})
        want(kept.get("medium") == "Memory" and kept.get("sizeLimit"), f"{path} is no memory of a limited size")
    for which in ("requests", "limits"):
        want({"cpu", "memory"} <= container["resources"].get(which, {}).keys(), f"it has no {which} of cpu and memory")
    return found


def wiring_problems(objects: dict[str, dict]) -> list[str]:
    """Names and ports that don't fit."""
    deployment, service = objects["Deployment"], objects["Service"]
    (container,) = deployment["spec"]["template"]["spec"]["containers"]
    environment = {one["name"]: one.get("value", "") for one in container["env"]}
    (port,) = container["ports"]
    found = unknown_flags(container["args"])
    found += [f"the server has no variable {one}" for one in environment if one not in variables()]
    exposed = next(value for key, value in instructions("Dockerfile") if key == "EXPOSE")
    if not environment["STEREOD_HTTP"].endswith(f":{port['containerPort']}") or str(port["containerPort"]) != exposed:
        found.append(f"ports: {environment['STEREOD_HTTP']}, {port['containerPort']}, and {exposed} of the image")
    names = {
        "Service": service["spec"]["ports"][0]["targetPort"],
        "ServiceMonitor": objects["ServiceMonitor"]["spec"]["endpoints"][0]["port"],
        "NetworkPolicy": objects["NetworkPolicy"]["spec"]["ingress"][0]["ports"][0]["port"],
    }
    found += [
        f"{kind} names the port {name}, the pod {port['name']}" for kind, name in names.items() if name != port["name"]
    ]
    if service["spec"]["ports"][0]["name"] != names["ServiceMonitor"]:
        found.append("ServiceMonitor and Service name different ports")
    scaler = objects["HorizontalPodAutoscaler"]["spec"]
    target = scaler["scaleTargetRef"]
    if (target["kind"], target["name"]) != ("Deployment", deployment["metadata"]["name"]):
        found.append(f"the autoscaler scales {target['name']}")
    if "replicas" in deployment["spec"]:
        found.append("the autoscaler and the Deployment both say how many replicas")
    adapter = yaml.safe_load((DOCKER / "prometheus/adapter.yml").read_text())
    made = {rule["name"]["as"] for rule in adapter["rules"]["custom"]}
    found += [
        f"nobody makes the metric {one['pods']['metric']['name']}"
        for one in scaler["metrics"]
        if one["pods"]["metric"]["name"] not in made
    ]
    version = (ROOT / "Cargo.toml").read_text().split('version = "')[1].split('"')[0]
    chart = yaml.safe_load((DOCKER / "helm/stereod/Chart.yaml").read_text())
    if chart["appVersion"] != version:
        found.append(f"the chart is for {chart['appVersion']}, the server is {version}")
    files = objects["ConfigMap"]["data"]
    wanted = [one for one in [*container["args"], *environment.values()] if one.startswith("/etc/stereod/")]
    return found + [
        f"{one} is not in the ConfigMap" for one in wanted if one.removeprefix("/etc/stereod/") not in files
    ]


def schemas(report: Report, objects: list[dict]) -> None:
    """Kubernetes' own schemas, which the package kubernetes-validate brings along."""
    try:
        import kubernetes_validate
    except ImportError:
        report.skip("Kubernetes' schemas", "not installed (PyPI: kubernetes-validate)")
        return
    newest = kubernetes_validate.latest_version()
    for version in ("1.27", newest):
        problems = []
        for one in objects:
            if one["kind"] == "ServiceMonitor":
                continue
            try:
                kubernetes_validate.validate(one, version, strict=True)
            except kubernetes_validate.ValidationError as why:
                problems.append(f"{one['kind']}: {'.'.join(map(str, why.path))}: {why.message}")
        report.all_of(f"chart: the schemas of Kubernetes {version}, strictly", problems)
    report.skip(
        "chart: the ServiceMonitor's schema", "it is the Prometheus operator's, which is not part of Kubernetes"
    )


def helm(report: Report) -> None:
    """What helm says, and whether the committed rendering is what it renders."""
    program = tool("helm")
    if program is None:
        report.skip("helm lint, helm template", "helm is not installed")
        return
    report.run("helm lint", [program, "lint", "--strict", *HELM[2:]])
    done = subprocess.run([program, *HELM], capture_output=True, text=True, check=False)
    same = list(yaml.safe_load_all(done.stdout)) == list(yaml.safe_load_all(RENDERED.read_text()))
    again = "make it anew: docker/check --render"
    report.all_of("helm template renders docker/helm/rendered.yaml", [] if same else [done.stderr.strip() or again])
    variants = {
        "defaults": [],
        "HTTP alone, nothing optional": [
            "zenoh.enabled=false",
            "networkPolicy.enabled=false",
            "podDisruptionBudget.enabled=false",
        ],
        "Zenoh's file as a secret": ["zenoh.existingSecret=zenoh"],
    }
    for name, settings in variants.items():
        command = [program, "template", "stereod", HELM[2], *(word for one in settings for word in ("--set", one))]
        report.run(f"helm template: {name}", command)
    for setting in ("replicas=two", "zenoh.conect=x", "service.port=0", "zenoh.existingSecret=a,zenoh.config=b"):
        done = subprocess.run(
            [program, "template", "stereod", HELM[2], "--set", setting], capture_output=True, check=False
        )
        report.all_of(f"helm refuses {setting}", [] if done.returncode else ["it was taken"])
