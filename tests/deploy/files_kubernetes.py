"""Checks the rendered manifests of deploy/kubernetes against their schemas, against each other, and
against the program."""

import copy
import json
import re
import subprocess

import kubernetes_validate
import lupa.luajit21 as lua
import yaml

import files_program as program

FOLDER = "deploy/kubernetes"
VERSION = "1.37"
SERVER = {"app.kubernetes.io/name": "mlswarp", "app.kubernetes.io/component": "server"}


def rendered(folder):
    """The objects of a kustomization, each valid YAML without duplicate keys."""
    said = subprocess.run(
        ["kubectl", "kustomize", f"{FOLDER}/{folder}"], check=True, capture_output=True, text=True
    )
    if said.stderr.strip():
        raise AssertionError(f"{folder}: {said.stderr.strip()}")
    return list(yaml.safe_load_all(said.stdout))


def name_of(obj):
    return f"{obj['kind']} {obj['metadata']['name']}"


# --- schemas --------------------------------------------------------------------------------------


def by_schema(objects, kept):
    """Schema errors of each object, including unknown fields."""
    complaints = [[] for _ in objects]
    others = []
    for index, obj in enumerate(objects):
        try:
            kubernetes_validate.validate(obj, VERSION, strict=True)
        except kubernetes_validate.SchemaNotFoundError:
            others.append(index)
        except kubernetes_validate.ValidationError as refused:
            complaints[index].append(f"{'/'.join(map(str, refused.path))}: {refused.message}")
    done = subprocess.run(
        ["node", "kinds.mjs"],
        cwd=kept,
        check=True,
        capture_output=True,
        text=True,
        input=json.dumps([objects[i] for i in others]),
    )
    for index, said in zip(others, json.loads(done.stdout)):
        complaints[index] += said
    return [[f"{name_of(obj)}: {text}" for text in said] for obj, said in zip(objects, complaints)]


# --- against each other ---------------------------------------------------------------------------


class Cluster:
    """A set of objects and its cross references."""

    def __init__(self, objects):
        self.objects = objects

    def kind(self, *kinds):
        return [o for o in self.objects if o["kind"] in kinds]

    def named(self, kind, name):
        return next((o for o in self.kind(kind) if o["metadata"]["name"] == name), None)

    def workloads(self):
        return self.kind("Deployment", "StatefulSet")

    def selected(self, labels):
        """The workloads whose pods carry all of these labels."""
        return [
            w
            for w in self.workloads()
            if labels and labels.items() <= w["spec"]["template"]["metadata"]["labels"].items()
        ]

    def server(self):
        [one] = self.selected(SERVER)
        return one

    def variables(self):
        """The environment of the server's container, without secrets."""
        [container] = containers(self.server())
        found = {}
        for source in container.get("envFrom", []):
            config = self.named("ConfigMap", source["configMapRef"]["name"])
            found.update(config["data"] if config else {})
        found.update({e["name"]: e.get("value", "") for e in container.get("env", [])})
        return found


def containers(workload):
    return workload["spec"]["template"]["spec"]["containers"]


def ports(workload):
    return {p["name"]: p["containerPort"] for c in containers(workload) for p in c.get("ports", [])}


def across(cluster):
    """Checks that referenced names, labels and ports exist."""
    said = []

    def expect(holds, text):
        if not holds:
            said.append(text)

    def pods(labels, whose):
        found = cluster.selected(labels)
        expect(len(found) == 1, f"{whose} selects {len(found)} workloads by {labels}")
        return found[0] if found else None

    for workload in cluster.workloads():
        labels, spec = (
            workload["spec"]["selector"]["matchLabels"],
            workload["spec"]["template"]["spec"],
        )
        expect(
            pods(labels, name_of(workload)) is workload,
            f"{name_of(workload)} does not select its own pods",
        )
        for spread in spec.get("topologySpreadConstraints", []):
            expect(
                cluster.selected(spread["labelSelector"]["matchLabels"]) == [workload],
                f"{name_of(workload)} is spread by other pods' labels",
            )
        said += hardening(workload)
        volumes = {v["name"] for v in spec.get("volumes", [])} | {
            v["metadata"]["name"] for v in workload["spec"].get("volumeClaimTemplates", [])
        }
        mounts = {m["name"] for c in spec["containers"] for m in c.get("volumeMounts", [])}
        expect(
            mounts == volumes, f"{name_of(workload)} mounts {sorted(mounts)}, has {sorted(volumes)}"
        )
        for volume in spec.get("volumes", []):
            if "configMap" in volume:
                expect(
                    cluster.named("ConfigMap", volume["configMap"]["name"]),
                    f"{name_of(workload)}: no ConfigMap {volume['configMap']['name']}",
                )
        for container in spec["containers"]:
            for source in container.get("envFrom", []):
                expect(
                    cluster.named("ConfigMap", source["configMapRef"]["name"]),
                    f"no ConfigMap {source['configMapRef']['name']}",
                )
            for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
                asked = container.get(probe, {})
                port = asked.get("httpGet", asked.get("tcpSocket", {})).get("port")
                expect(
                    port is None or port in ports(workload),
                    f"{name_of(workload)}: {probe} asks port {port}",
                )

    for service in cluster.kind("Service"):
        target = pods(service["spec"].get("selector"), name_of(service))
        for port in service["spec"]["ports"]:
            expect(
                target is None or port["targetPort"] in ports(target),
                f"{name_of(service)}: no port {port['targetPort']} in its pods",
            )
    for budget in cluster.kind("PodDisruptionBudget"):
        pods(budget["spec"].get("selector", {}).get("matchLabels"), name_of(budget))
    for policy in cluster.kind("NetworkPolicy"):
        target = pods(policy["spec"]["podSelector"].get("matchLabels"), name_of(policy))
        for rule in policy["spec"].get("ingress", []):
            for port in rule["ports"]:
                expect(
                    target is None or port["port"] in ports(target),
                    f"{name_of(policy)}: no port {port['port']} in its pods",
                )
            said += strangers(cluster, policy, rule["from"], None)
        for rule in policy["spec"].get("egress", []):
            said += strangers(cluster, policy, rule["to"], {p["port"] for p in rule["ports"]})
    for monitor in cluster.kind("PodMonitor"):
        target = pods(monitor["spec"]["selector"]["matchLabels"], name_of(monitor))
        job = (
            target["spec"]["template"]["metadata"]["labels"].get(monitor["spec"].get("jobLabel"))
            if target
            else None
        )
        expect(
            f'job="{job}"' in open("deploy/prometheus/alerts.yaml").read(),
            f"{name_of(monitor)}: no alert asks for job {job}",
        )
        for endpoint in monitor["spec"]["podMetricsEndpoints"]:
            expect(
                target is None or endpoint["port"] in ports(target),
                f"{name_of(monitor)}: no port {endpoint['port']}",
            )
    for scaler in cluster.kind("HorizontalPodAutoscaler"):
        wanted = scaler["spec"]["scaleTargetRef"]
        target = cluster.named(wanted["kind"], wanted["name"])
        expect(target, f"{name_of(scaler)}: no {wanted['kind']} {wanted['name']}")
        expect(
            target is None or "replicas" not in target["spec"],
            f"{name_of(scaler)} and its target both say how many",
        )
        expect(
            target is None or "cpu" in containers(target)[0]["resources"]["requests"],
            f"{name_of(scaler)}: processor time of what was not asked for",
        )
    said += ways_in(cluster)
    return said


def strangers(cluster, policy, peers, wanted):
    """A peer in this namespace is one of these pods and listens on the port; other peers are named
    by their namespace."""
    said = []
    for peer in peers:
        if "namespaceSelector" not in peer:
            found = cluster.selected(peer["podSelector"].get("matchLabels"))
            if len(found) != 1:
                said.append(f"{name_of(policy)}: {peer} is nobody here")
            elif wanted is not None and not wanted <= set(ports(found[0]).values()):
                said.append(f"{name_of(policy)}: {name_of(found[0])} does not listen on {wanted}")
    return said


def hardening(workload):
    spec = workload["spec"]["template"]["spec"]
    pod = spec.get("securityContext", {})
    rules = {
        "runs as somebody": pod.get("runAsNonRoot") is True and pod.get("runAsUser", 0) > 0,
        "has the runtime's filter of system calls": pod.get("seccompProfile", {}).get("type")
        == "RuntimeDefault",
        "has no token": spec.get("automountServiceAccountToken") is False,
    }
    for container in spec["containers"]:
        own, limits = container.get("securityContext", {}), container.get("resources", {})
        rules |= {
            "cannot write to its root": own.get("readOnlyRootFilesystem") is True,
            "cannot gain rights": own.get("allowPrivilegeEscalation") is False,
            "has no capability": own.get("capabilities", {}).get("drop") == ["ALL"]
            and "add" not in own["capabilities"],
            "gets the memory that it asks for": limits.get("limits", {}).get("memory")
            == limits.get("requests", {}).get("memory")
            is not None,
        }
    return [f"{name_of(workload)}: not so: {rule}" for rule, holds in rules.items() if not holds]


def ways_in(cluster):
    """Gateway, route and policies: the path from outside to a port of the server."""
    said = []

    def expect(holds, text):
        if not holds:
            said.append(text)

    for route in cluster.kind("HTTPRoute"):
        for parent in route["spec"]["parentRefs"]:
            gateway = cluster.named("Gateway", parent["name"])
            listener = (
                next(
                    (x for x in gateway["spec"]["listeners"] if x["name"] == parent["sectionName"]),
                    None,
                )
                if gateway
                else None
            )
            expect(listener, f"{name_of(route)}: no listener {parent}")
            expect(
                listener is None or route["spec"]["hostnames"] == [listener["hostname"]],
                f"{name_of(route)}: other host names than its listener",
            )
        for backend in (b for rule in route["spec"]["rules"] for b in rule["backendRefs"]):
            service = cluster.named("Service", backend["name"])
            expect(
                service and backend["port"] in {p["port"] for p in service["spec"]["ports"]},
                f"{name_of(route)}: no Service {backend}",
            )
    for policy in cluster.kind("BackendTrafficPolicy", "EnvoyExtensionPolicy"):
        for target in policy["spec"]["targetRefs"]:
            expect(
                cluster.named(target["kind"], target["name"]),
                f"{name_of(policy)}: no {target['kind']} {target['name']}",
            )
    return said


# --- against the program --------------------------------------------------------------------------


def against_program(cluster, declared):
    """Names and values of variables, grace, timeouts, ports."""
    said = []

    def expect(holds, text):
        if not holds:
            said.append(text)

    server, variables = cluster.server(), cluster.variables()
    for name in variables:
        expect(name in declared, f"the program has no variable {name}")
    value = {**declared, **variables}
    if said:
        return said
    spec = server["spec"]["template"]["spec"]
    needed = program.seconds(value["MLSWARP_DRAIN_DELAY"]) + program.seconds(
        value["MLSWARP_SHUTDOWN_GRACE"]
    )
    expect(
        needed + 3 <= spec["terminationGracePeriodSeconds"] <= needed + 15,
        f"it takes {needed} s to stop; {spec['terminationGracePeriodSeconds']} are given",
    )
    expect(
        program.seconds(value["MLSWARP_DRAIN_DELAY"]) >= 3, "endpoints need a moment to be known"
    )
    for listener, port in (("MLSWARP_LISTEN", "http"), ("MLSWARP_METRICS_LISTEN", "metrics")):
        expect(
            value[listener] == f"0.0.0.0:{ports(server)[port]}",
            f"{listener}={value[listener]} is not port {ports(server)[port]}",
        )
    keys = next(m["mountPath"] for m in containers(server)[0]["volumeMounts"])
    expect(
        value["MLSWARP_KEYS_FILE"].startswith(keys + "/"),
        f"no keys at {value['MLSWARP_KEYS_FILE']}",
    )
    user = re.search(r"^USER (\d+)", open("deploy/Dockerfile").read(), re.M)[1]
    expect(str(spec["securityContext"]["runAsUser"]) == user, f"the image is made for user {user}")

    for policy in cluster.kind("BackendTrafficPolicy"):
        idle = policy["spec"]["timeout"]["http"]["connectionIdleTimeout"]
        expect(
            program.seconds(idle) < program.seconds(value["MLSWARP_HEADER_TIMEOUT"]),
            f"the server closes idle connections before {idle}",
        )
    for route in cluster.kind("HTTPRoute"):
        for rule in route["spec"]["rules"]:
            whole = program.seconds(rule["timeouts"]["request"])
            expect(
                whole == 0 or whole > program.seconds(value["MLSWARP_REQUEST_TIMEOUT"]),
                f"{name_of(route)} gives up after {whole} s",
            )
    return said


def in_the_program(cluster):
    """Runs the program with the variables of the manifests: it starts, the probe paths respond, and
    the named metrics exist."""
    said = []
    with program.serving(cluster.variables()) as ask:
        for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
            path = containers(cluster.server())[0][probe]["httpGet"]["path"]
            if (
                status := ask("MLSWARP_METRICS_LISTEN", path, headers={"Authorization": "none"})[0]
            ) != 200:
                said.append(f"{probe}: {path} answers {status}")
        for policy in cluster.kind("BackendTrafficPolicy"):
            path = policy["spec"]["healthCheck"]["active"]["http"]["path"]
            if (status := ask("MLSWARP_LISTEN", path, headers={"Authorization": "none"})[0]) != 200:
                said.append(f"{name_of(policy)}: {path} answers {status}")
        [monitor] = cluster.kind("PodMonitor")
        status, metrics = ask(
            "MLSWARP_METRICS_LISTEN", monitor["spec"]["podMetricsEndpoints"][0]["path"]
        )
        names = set(re.findall(r"^# TYPE (\S+) gauge", metrics.decode(), re.M))
        for scaler in cluster.kind("HorizontalPodAutoscaler"):
            for metric in (
                m["pods"]["metric"]["name"]
                for m in scaler["spec"]["metrics"]
                if m["type"] == "Pods"
            ):
                if metric not in names:
                    said.append(f"{name_of(scaler)}: no gauge {metric}")
                rules = yaml.safe_load(open(f"{FOLDER}/monitoring/adapter-values.yaml"))["rules"][
                    "custom"
                ]
                if [
                    r["name"]["as"] for r in rules if r["seriesQuery"].startswith(metric + "{")
                ] != [metric]:
                    said.append(f"{name_of(scaler)}: the adapter's values do not make {metric}")
    return said


SESSION = "0f8fad5b-d9cb-469f-a165-70867728950e"
PATHS = {
    f"/sessions/{SESSION}": SESSION,
    f"/sessions/{SESSION}/warp": SESSION,
    f"/sessions/{SESSION.upper()}/mesh?x=1": SESSION,
    f"/sessions/{SESSION}/drag?frames=mesh&width=auto": SESSION,
    f"/sessions/{SESSION}?a=/b": SESSION,
    "/sessions": None,
    "/sessions/": None,
    "/sessions?x=/sessions/a": None,
    "/warp": None,
    "/": None,
    "/x/sessions/a": None,
}


def affinity(cluster):
    """Runs the Lua filter in LuaJIT, as Envoy does: the hashed header is the session id of the
    path, never a value from the client."""
    said = []
    [policy], [traffic] = cluster.kind("EnvoyExtensionPolicy"), cluster.kind("BackendTrafficPolicy")
    [header] = [h["name"] for h in traffic["spec"]["loadBalancer"]["consistentHash"]["headers"]]
    machine = lua.LuaRuntime(unpack_returned_tuples=True)
    machine.execute(policy["spec"]["lua"][0]["inline"])
    machine.execute(
        """
        function headers_of(path, sent)
          local all = {[":path"] = path, ["NAME"] = sent}
          local map = {
            get = function(_, name) return all[name] end,
            remove = function(_, name) all[name] = nil end,
            add = function(_, name, value)
              all[name] = (all[name] and all[name] .. "," or "") .. value
            end,
          }
          envoy_on_request({headers = function() return map end})
          return all["NAME"]
        end""".replace("NAME", header)
    )
    for path, expected in [*PATHS.items(), (None, None)]:
        for sent in (None, "somebody-else"):
            if (found := machine.globals().headers_of(path, sent)) != expected:
                said.append(f"{name_of(policy)}: {path} with {header}: {sent} gives {found}")
    return said


# --- tests of the checks --------------------------------------------------------------------------


def broken(objects):
    """(mistake, objects) for mistakes that must be found."""

    def change(kind, name, edit):
        changed = copy.deepcopy(objects)
        edit(next(o for o in changed if o["kind"] == kind and o["metadata"]["name"] == name))
        return changed

    pod = lambda o: o["spec"]["template"]["spec"]
    first = lambda o: pod(o)["containers"][0]
    yield (
        "a label",
        change(
            "Service",
            "mlswarp",
            lambda o: o["spec"]["selector"].update({"app.kubernetes.io/name": "mlwarp"}),
        ),
    )
    yield (
        "a port's name",
        change("Service", "mlswarp", lambda o: o["spec"]["ports"][0].update(targetPort="web")),
    )
    yield (
        "a probe's port",
        change(
            "Deployment",
            "mlswarp",
            lambda o: first(o)["livenessProbe"]["httpGet"].update(port="health"),
        ),
    )
    yield (
        "a selector that is missing",
        change("PodDisruptionBudget", "mlswarp", lambda o: o["spec"].pop("selector")),
    )
    yield (
        "the autoscaler's target",
        change(
            "HorizontalPodAutoscaler",
            "mlswarp",
            lambda o: o["spec"]["scaleTargetRef"].update(name="warp"),
        ),
    )
    yield (
        "a peer that is nobody",
        change(
            "NetworkPolicy",
            "mlswarp",
            lambda o: o["spec"]["egress"][1]["to"][0]["podSelector"].update(
                matchLabels={"app": "redis"}
            ),
        ),
    )
    yield (
        "the store's port",
        change(
            "NetworkPolicy",
            "mlswarp",
            lambda o: o["spec"]["egress"][1]["ports"][0].update(port=6380),
        ),
    )
    yield (
        "a route's service",
        change(
            "HTTPRoute",
            "mlswarp",
            lambda o: o["spec"]["rules"][1]["backendRefs"][0].update(port=8080),
        ),
    )
    yield (
        "a listener's name",
        change(
            "HTTPRoute", "mlswarp", lambda o: o["spec"]["parentRefs"][0].update(sectionName="http")
        ),
    )
    yield "a job's name", change("PodMonitor", "mlswarp", lambda o: o["spec"].pop("jobLabel"))
    yield (
        "a policy's target",
        change(
            "BackendTrafficPolicy",
            "mlswarp",
            lambda o: o["spec"]["targetRefs"][0].update(name="route"),
        ),
    )
    yield (
        "a root that can be written",
        change(
            "Deployment",
            "mlswarp",
            lambda o: first(o)["securityContext"].pop("readOnlyRootFilesystem"),
        ),
    )
    yield (
        "memory that is not given",
        change(
            "Deployment",
            "mlswarp",
            lambda o: first(o)["resources"]["requests"].update(memory="1Gi"),
        ),
    )
    yield (
        "grace",
        change("Deployment", "mlswarp", lambda o: pod(o).update(terminationGracePeriodSeconds=20)),
    )
    config = next(
        o["metadata"]["name"]
        for o in objects
        if o["kind"] == "ConfigMap" and o["metadata"]["name"].startswith("mlswarp")
    )
    yield "a variable", change("ConfigMap", config, lambda o: o["data"].update(MLSWARP_DRAIN="5s"))
    yield (
        "a listener",
        change("ConfigMap", config, lambda o: o["data"].update(MLSWARP_LISTEN="0.0.0.0:8081")),
    )
    yield (
        "the proxy's patience",
        change(
            "HTTPRoute",
            "mlswarp",
            lambda o: o["spec"]["rules"][1]["timeouts"].update(request="15s"),
        ),
    )
    yield (
        "idle connections",
        change(
            "BackendTrafficPolicy",
            "mlswarp",
            lambda o: o["spec"]["timeout"]["http"].update(connectionIdleTimeout="1h"),
        ),
    )
    yield (
        "the header",
        change(
            "BackendTrafficPolicy",
            "mlswarp",
            lambda o: o["spec"]["loadBalancer"]["consistentHash"]["headers"][0].update(
                name="session"
            ),
        ),
    )


def unknown_fields(objects):
    """A copy of every object with a field that its schema lacks."""
    for obj in objects:
        changed = copy.deepcopy(obj)
        place = changed.get("spec", changed)
        place["surprise"] = {"is": "unknown"}
        yield changed


def check(kept):
    """Runs all checks; yields (name, messages)."""
    objects = rendered("example")
    cluster, declared = Cluster(objects), program.declared()
    for folder in ("base", "gateway", "monitoring", "valkey"):
        mine = {(o["kind"], o["metadata"]["name"].split("-")[0]) for o in rendered(folder)}
        missing = mine - {(o["kind"], o["metadata"]["name"].split("-")[0]) for o in objects}
        yield f"{folder} renders and is part of the example", [f"{m} is not" for m in missing]
    # In the form that the README creates for the operator.
    rules = {
        "apiVersion": "monitoring.coreos.com/v1",
        "kind": "PrometheusRule",
        "metadata": {"name": "mlswarp"},
        "spec": yaml.safe_load(open("deploy/prometheus/alerts.yaml")),
    }
    objects_and_rules = [*objects, rules]
    surprised = list(unknown_fields(objects_and_rules))
    judged = by_schema(objects_and_rules + surprised, kept)
    count = len(objects_and_rules)
    yield f"{count} objects keep to their schemas", [c for said in judged[:count] for c in said]
    yield (
        "an unknown field is refused in each",
        [f"{name_of(o)} takes it" for o, said in zip(surprised, judged[count:]) if not said],
    )
    yield "names, labels and ports are there", across(cluster)
    yield "variables, grace and timeouts are the program's", against_program(cluster, declared)
    yield "the header of affinity is the session", affinity(cluster)

    def all_of(cluster):
        return {*across(cluster), *against_program(cluster, declared), *affinity(cluster)}

    before = all_of(cluster)
    yield (
        "mistakes are seen",
        [
            f"unseen: {what}"
            for what, changed in broken(objects)
            if not all_of(Cluster(changed)) - before
        ],
    )
    yield (
        "the program starts with these variables, and answers what is asked of it",
        in_the_program(cluster),
    )
