"""deploy/compose.yaml, run by docker-compose: the containers and their addresses."""

import contextlib
import json
import os
import subprocess
import time

from commands import AS_ROOT, ROOT, Failure, run, say, timed, where
from drag_clients import Server
from images import IMAGE

HEALTHY_SECONDS = 60.0
COMPOSE = ROOT / "deploy" / "compose.yaml"
# Services without a Debian package.
WITHOUT = ["grafana"]
# The last number of each address.
PROXY, STORE, PROMETHEUS, REPLICAS = 3, 4, 5, (11, 12, 13)


class Stack:
    def __init__(self, engine, names, services, scratch):
        self.engine, self.names, self.file = engine, names, scratch / "compose.json"
        self.project = f"mlswarp-test-{os.getpid()}"
        self.replicas = {f"mlswarp-{i}": names.address(n) for i, n in enumerate(REPLICAS, 1)}
        self.addresses = {
            "proxy": names.address(PROXY),
            "store": names.address(STORE),
            "prometheus": names.address(PROMETHEUS),
        }
        names.addresses.update(
            {name: [address] for name, address in self.addresses.items()}, mlswarp=[]
        )
        given = {
            "images": {"mlswarp": IMAGE, "services": services},
            "names": names.server,
            "replicas": list(self.replicas.values()),
            "addresses": self.addresses,
            "without": WITHOUT,
        }
        derived = subprocess.run(
            ["/usr/bin/python3", ROOT / "tests/deploy/derive.py", COMPOSE],
            input=json.dumps(given).encode(),
            capture_output=True,
        )
        if derived.returncode != 0:
            raise Failure(
                f"compose.yaml was not derived: {derived.stderr.decode(errors='replace')}"
            )
        self.file.write_bytes(derived.stdout)
        self.proxy = Server(self.addresses["proxy"], 8080)

    def compose(self, *arguments, file=None, **options):
        """Runs docker-compose in the directory of compose.yaml, so that relative paths work."""
        host = [f"DOCKER_HOST={self.engine.host[1]}"] if self.engine.host else []
        place = (
            "--project-directory",
            COMPOSE.parent,
            "--project-name",
            self.project,
            "--file",
            file or self.file,
        )
        return run(
            *self.engine.prefix,
            "env",
            *host,
            where("docker-compose"),
            "--ansi",
            "never",
            *place,
            *arguments,
            **options,
        )

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        if kind is not None:
            with contextlib.suppress(Failure):
                done = self.compose("logs", "--no-color", "--tail", "25", check=False)
                say(
                    "the stack said:\n"
                    + (done.stdout + done.stderr).decode(errors="replace")[-12000:]
                )
        self.compose("down", "--volumes", "--timeout", "5", check=False)

    def start(self):
        """Starts everything except the third replica."""
        with timed("starting the stack"):
            self.compose("up", "--detach", "--no-build", *self.addresses, *list(self.replicas)[:2])
            self.names.addresses["mlswarp"] = list(self.replicas.values())[:2]
            for service in (*self.addresses, *list(self.replicas)[:2]):
                self.wait_healthy(service)
            self.wait_balanced(2)

    def container(self, service):
        found = self.compose("ps", "--quiet", service).stdout.decode().strip()
        if not found:
            raise Failure(f"no container of {service} runs")
        return found

    def state(self, container):
        return json.loads(self.engine.text("inspect", "--format", "{{json .State}}", container))

    def wait_healthy(self, service):
        container, deadline = self.container(service), time.monotonic() + HEALTHY_SECONDS
        while (state := self.state(container))["Health"]["Status"] != "healthy":
            if time.monotonic() > deadline or not state["Running"]:
                raise Failure(
                    f"{service} is {state['Status']}, {state['Health']['Status']}: "
                    f"{state['Health']['Log'][-1:]}"
                )
            time.sleep(0.2)

    def wait_balanced(self, replicas):
        """Waits until the proxy uses this number of replicas."""
        deadline = time.monotonic() + HEALTHY_SECONDS
        figures = Server(self.addresses["proxy"], 8404)
        while (
            count := int(metric(figures, "haproxy_backend_active_servers", 'proxy="sessions"'))
        ) != replicas:
            if time.monotonic() > deadline:
                raise Failure(f"the proxy has {count} replicas in the place of {replicas}")
            time.sleep(0.1)

    def kill(self, service):
        run(*AS_ROOT, "kill", "-KILL", self.state(self.container(service))["Pid"])

    def signal(self, service, name):
        self.engine("kill", "--signal", name, self.container(service))

    def figure(self, service, name, *labels):
        return metric(Server(self.replicas[service], 9090), name, *labels)


def metric(server, name, *labels):
    """The sum of the samples of a metric with these labels."""
    status, _, body = server.ask("GET", "/metrics")
    if status != 200:
        raise Failure(f"/metrics of {server.host} answered {status}")
    total = 0.0
    for line in body.decode().splitlines():
        series, _, value = line.rpartition(" ")
        if series.partition("{")[0] == name and all(label in series for label in labels):
            total += float(value)
    return total
