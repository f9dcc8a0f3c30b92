"""usage: deployments.py ROOT DELTARAYD
Reads what docker/ has for compose, Kubernetes, Envoy, nginx and systemd, and checks it against the server and each other:
flags and variables exist and take the values given, ports and names meet, probes ask for services that are there, what is
mounted exists, budgets stay below limits on memory, and nothing is killed before it has drained.
"""

import glob
import os
import re
import subprocess
import sys

try:
    import yaml
except ImportError:
    print("SKIPPED: PyYAML is missing; it comes with the package python3-yaml")
    sys.exit(77)

from server_flags import Findings, bytes_of, read, server_flags

root, program = sys.argv[1:]
flags = server_flags(program)
findings = Findings()
check = findings.check
docker = os.path.join(root, "docker")
balancer = os.path.join(docker, "balancer")
END_SECONDS = 10  # what the end may take after the drain


def load(*parts):
    return list(yaml.safe_load_all(read(docker, *parts)))


def seconds(text):
    return int(re.fullmatch(r"(\d+)s?", str(text))[1])


def check_stop(grace, where):
    check(seconds(grace) > int(flags["drain-timeout"].default) + END_SECONDS, f"{where}: {grace} are too short to drain")


def check_memory(given, limit, where):
    budgets = [f"{name}-bytes" for name in ("tree", "batch", "network")]
    total = sum(bytes_of(given.get(flags[name].variable, flags[name].default)) for name in budgets)
    # An eighth stays for what is not counted.
    check(total <= bytes_of(limit) * 7 / 8, f"{where}: budgets of {total >> 20} MiB do not fit a limit of {limit}")


def check_values(given, where):
    """The server reads the variables, and stops at a flag that is wrong for another reason."""
    result = subprocess.run([program, "--tls-key", "none"], env=given, capture_output=True, text=True, timeout=60)
    check("--tls-cert is missing" in result.stderr, f"{where}: {result.stderr.strip()}")


# --- Flags and variables, wherever they are named, in comments too
texts = {os.path.relpath(path, root): read(path)
         for pattern in ("*.yaml", "*.service", "Dockerfile", "balancer/*") for path in glob.glob(os.path.join(docker, pattern))}
check(len(texts) == 8, f"not the files that this script knows: {sorted(texts)}")
variables = {flag.variable for flag in flags.values()}
others = {"config", "storage", "platform"}  # of Prometheus and Docker
for path, text in texts.items():
    for variable in set(re.findall(r"DELTARAY_\w+", text)) - variables:
        check(False, f"{path}: the server has no variable {variable}")
    if path != "docker/Dockerfile":
        for flag in set(re.findall(r"(?<![\w-])--([a-z]+(?:-[a-z]+)*)", text)) - set(flags) - others:
            check(False, f"{path}: the server has no flag --{flag}")

# --- The image
dockerfile = texts["docker/Dockerfile"]
image_environment = dict(re.findall(r"(DELTARAY_\w+)=(\S+)", dockerfile))
check_values(image_environment, "Dockerfile")
port, metrics_port = (int(image_environment[f"DELTARAY_{name}LISTEN"].rsplit(":", 1)[1]) for name in ("", "METRICS_"))
exposed = [int(number) for number in re.search(r"^EXPOSE (.*)", dockerfile, re.MULTILINE)[1].split()]
check(exposed == [port, metrics_port], f"Dockerfile: exposes {exposed}, listens at {port} and {metrics_port}")
check(flags["listen"].default.endswith(f":{port}"), "Dockerfile: another port than the server's own")
data_directory = image_environment["DELTARAY_DATA_DIR"]
check(f"VOLUME {data_directory}\n" in dockerfile, "Dockerfile: the data directory is no volume")
user = int(re.search(r"--uid (\d+)", dockerfile)[1])
health_services = {""}
for path in glob.glob(os.path.join(root, "proto", "deltaray", "v1", "*.proto")):
    health_services.update(f"deltaray.v1.{name}" for name in re.findall(r"^service (\w+)", read(path), re.MULTILINE))

# --- nginx
nginx = texts["docker/balancer/nginx.conf"]
upstreams = re.findall(r"^ *server (\w+):(\d+) ", nginx, re.MULTILINE)
listens = int(re.search(r"^ *listen (\d+)", nginx, re.MULTILINE)[1])
check(len(upstreams) == 3 and all(int(number) == port for _, number in upstreams), f"nginx.conf: servers {upstreams}")
replicas = sorted(name for name, _ in upstreams)


# --- Compose
def check_compose(folder, file, ports):
    """`ports`: those that each service listens at, by its name."""
    [project] = load(folder, file)
    for name, service in project["services"].items():
        where = f"{os.path.join(folder, file)}: {name}"
        for published in service.get("ports", []):
            check(int(published.rsplit(":", 1)[1]) in ports[name], f"{where}: nothing listens at {published}")
            check(published.startswith("127.0.0.1:"), f"{where}: other machines reach {published}")
        mounted = {}
        for volume in service.get("volumes", []):
            source, target = volume.split(":")[:2]
            mounted[target] = source
            there = os.path.isfile(os.path.join(docker, folder, source)) if source[0] == "." else source in project["volumes"]
            check(there, f"{where}: {source} is not there")
        for name_of_other in service.get("depends_on", {}):
            check(name_of_other in project["services"], f"{where}: depends on {name_of_other}")
        given = service.get("environment", {})
        if "build" in service:
            context = os.path.normpath(os.path.join(docker, folder, service["build"]["context"]))
            check(os.path.isfile(os.path.join(context, service["build"]["dockerfile"])), f"{where}: no Dockerfile")
            check(os.path.samefile(context, root), f"{where}: is built from {context}")
            check(mounted.get(data_directory) in project["volumes"], f"{where}: meshes are in no volume")
            check_values({**image_environment, **given}, where)
            check_stop(service["stop_grace_period"], where)
            if "mem_limit" in service:
                check_memory(given, service["mem_limit"], where)
        for path in re.findall(r"/etc/\S+|/var/lib/\S+", " ".join([*service.get("command", []), *map(str, given.values())])):
            check(path.rstrip(",") in mounted or "build" in service, f"{where}: {path} is not mounted")
    return project


single = check_compose("", "compose.yaml", {"deltaray": exposed, "prometheus": [9090], "grafana": [3000]})
[prometheus] = load("monitoring", "prometheus.yml")
targets = [target for job in prometheus["scrape_configs"] for set_ in job["static_configs"] for target in set_["targets"]]
check(targets == [f"deltaray:{metrics_port}"] and "deltaray" in single["services"], f"prometheus.yml: {targets}")
several = check_compose("balancer", "compose.yaml", {**dict.fromkeys(replicas, exposed), "balancer": [listens]})
check(sorted(set(several["services"]) - {"balancer"}) == replicas, "balancer/compose.yaml: other servers than nginx.conf")
check(any("mem_limit" in service for service in several["services"].values()), "balancer/compose.yaml: no limit on memory")

# --- Envoy
[envoy] = load("balancer", "envoy.yaml")
[listener], [cluster] = (envoy["static_resources"][part] for part in ("listeners", "clusters"))
check(listener["address"]["socket_address"]["port_value"] == listens, "envoy.yaml: another port than nginx.conf")
addresses = [endpoint["endpoint"]["address"]["socket_address"]
             for group in cluster["load_assignment"]["endpoints"] for endpoint in group["lb_endpoints"]]
check(sorted(address["address"] for address in addresses) == replicas, "envoy.yaml: other servers than nginx.conf")
check(all(address["port_value"] == port for address in addresses), "envoy.yaml: servers listen at another port")
asked = [health["grpc_health_check"].get("service_name", "") for health in cluster["health_checks"]]
check(asked and set(asked) <= health_services, f"envoy.yaml: asks for the health of {asked}")
[manager] = (item["typed_config"] for chain in listener["filter_chains"] for item in chain["filters"])
routed = {route["route"]["cluster"] for host in manager["route_config"]["virtual_hosts"] for route in host["routes"]}
check(routed == {cluster["name"]} == {cluster["load_assignment"]["cluster_name"]}, f"envoy.yaml: leads to {routed}")

# --- Kubernetes
[kustomization] = load("balancer", "kustomization.yaml")
for file in kustomization["resources"] + [file for made in kustomization["configMapGenerator"] for file in made["files"]]:
    check(os.path.isfile(os.path.join(balancer, file)), f"kustomization.yaml: {file} is not there")
maps = {made["name"]: made["files"] for made in kustomization["configMapGenerator"]}
objects = load("balancer", "kubernetes.yaml")
by_kind = {}
for item in objects:
    by_kind.setdefault(item["kind"], {})[item["metadata"]["name"]] = item
pods = []  # labels and ports of each pod
for kind, listened in (("StatefulSet", exposed), ("Deployment", [listens])):
    for name, item in by_kind[kind].items():
        spec, template = item["spec"]["template"]["spec"], item["spec"]["template"]["metadata"]["labels"]
        check(item["spec"]["selector"]["matchLabels"].items() <= template.items(), f"{name}: selects other pods")
        volumes = {volume["name"]: volume for volume in spec["volumes"]}
        [container] = spec["containers"]
        ports = [entry["containerPort"] for entry in container["ports"]]
        check(ports == listened, f"{name}: ports {ports}, listens at {listened}")
        for index in range(item["spec"]["replicas"]):
            pods.append(({**template, "statefulset.kubernetes.io/pod-name": f"{name}-{index}"}, ports))
        for probe in (container[key]["grpc"] for key in container if key.endswith("Probe")):
            check(probe["port"] == port and probe.get("service", "") in health_services, f"{name}: probe {probe}")
        mounts = {mount["mountPath"]: volumes.get(mount["name"]) for mount in container["volumeMounts"]}
        check(all(mounts.values()), f"{name}: mounts what is no volume")
        for volume in volumes.values():
            claim, made = (volume.get(key, {}) for key in ("persistentVolumeClaim", "configMap"))
            check(not claim or claim["claimName"] in by_kind["PersistentVolumeClaim"], f"{name}: {claim}")
            check(not made or made["name"] in maps, f"{name}: {made}")
        for path in (word for word in container.get("command", []) if word.startswith("/")):
            volume = mounts.get(os.path.dirname(path), {})
            check(os.path.basename(path) in maps.get(volume.get("configMap", {}).get("name"), []), f"{name}: no {path}")
        if kind == "StatefulSet":
            given = {entry["name"]: entry["value"] for entry in container["env"]}
            check_values({**image_environment, **given}, name)
            check_memory(given, container["resources"]["limits"]["memory"], name)
            check_stop(spec["terminationGracePeriodSeconds"], name)
            check("persistentVolumeClaim" in mounts.get(data_directory, {}), f"{name}: meshes are in no volume")
            check(spec["securityContext"]["runAsUser"] == user, f"{name}: another user than the image's")
            check(item["spec"]["serviceName"] in by_kind["Service"], f"{name}: no service {item['spec']['serviceName']}")
            check(container["image"] in [image["name"] for image in kustomization["images"]], f"{name}: image")


def selected(labels):
    return [ports for pod, ports in pods if labels.items() <= pod.items()]


for name, service in by_kind["Service"].items():
    chosen = selected(service["spec"]["selector"])
    check(chosen, f"service {name}: no pod has its labels")
    check(name not in replicas or len(chosen) == 1, f"service {name}: {len(chosen)} pods")
    for entry in service["spec"]["ports"]:
        check(all(entry["port"] in ports for ports in chosen), f"service {name}: no pod listens at {entry['port']}")
check(set(replicas) <= set(by_kind["Service"]), "kubernetes.yaml: other servers than nginx.conf")
for name, policy in by_kind["NetworkPolicy"].items():
    chosen = selected(policy["spec"]["podSelector"]["matchLabels"])
    let_in = {entry["port"] for rule in policy["spec"]["ingress"] for entry in rule["ports"]}
    check(chosen and all(let_in == set(ports) for ports in chosen), f"policy {name}: lets in to {let_in}")
    for rule in policy["spec"]["ingress"]:
        for labels in (source["podSelector"]["matchLabels"] for source in rule["from"] if "podSelector" in source):
            check(selected(labels), f"policy {name}: no pod has {labels}")
for name, budget in by_kind["PodDisruptionBudget"].items():
    check(selected(budget["spec"]["selector"]["matchLabels"]), f"disruption budget {name}: no pod has its labels")

# --- systemd
unit = dict(re.findall(r"^(\w+)=(.*)$", texts["docker/deltarayd.service"], re.MULTILINE))
check(f"--data-dir /var/lib/{unit['StateDirectory']}" in unit["ExecStart"], "deltarayd.service: another data directory")
check(int(unit["LimitNOFILE"]) >= int(flags["max-connections"].default) + 128, "deltarayd.service: LimitNOFILE is too low")
check_stop(unit["TimeoutStopSec"], "deltarayd.service")

findings.end(f"{len(texts)} files name {len(objects)} objects of Kubernetes, {len(several['services'])} + "
             f"{len(single['services'])} services, and nothing that is not there")
