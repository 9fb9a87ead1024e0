#!/usr/bin/python3
"""Adapts deploy/compose.yaml to a machine that cannot pull images and uses only the loopback. Run
by Debian's Python, whose YAML module docker-compose installs. Reads the path of the file, and the
replacements as JSON; writes JSON, which is also YAML.

The changes are:
- every image is local: the built program, and Debian's HAProxy, Redis and Prometheus;
- every container uses the network of the host with its own loopback address, listens there, and
  uses the DNS server of the test instead of Docker's; no port is published; the loopback network is
  the trusted proxy;
- `scale: 2` of the replicas becomes separate services, because a service has one address here;
- a drag may wait longer for a worker, because one machine runs all replicas, the clients and the
  engine;
- Grafana, which Debian does not package, is left out.
"""

import copy
import json
import sys

import yaml

REPLICA = "mlswarp"
LOOPBACK = "127.0.0.0/8"
DRAG_WAIT = "2s"


def derive(compose, given):
    services = {}
    for name, service in compose["services"].items():
        if name in given["without"]:
            continue
        for absent_here in ("build", "ports", "scale"):
            service.pop(absent_here, None)
        service["image"] = given["images"].get(name, given["images"]["services"])
        service["network_mode"] = "host"
        service["dns"] = [given["names"]]
        if name == REPLICA:
            for number, address in enumerate(given["replicas"], 1):
                replica = copy.deepcopy(service)
                replica["environment"].update(
                    MLSWARP_LISTEN=f"{address}:8080",
                    MLSWARP_METRICS_LISTEN=f"{address}:9090",
                    MLSWARP_TRUSTED_PROXIES=LOOPBACK,
                    MLSWARP_DRAG_WAIT=DRAG_WAIT,
                )
                services[f"{name}-{number}"] = replica
            continue
        address = given["addresses"][name]
        # A health check asks the container's own loopback.
        service["healthcheck"]["test"] = [
            word.replace("//127.0.0.1:", f"//{address}:") for word in service["healthcheck"]["test"]
        ]
        if name == "proxy":
            environment = service["environment"]
            environment.update(
                {k: f"{address}{v}" for k, v in environment.items() if v.startswith(":")}
            )
            environment["PROXY_DNS"] = f"{given['names']}:53"
        elif name == "store":
            service["command"] += ["--bind", address]
            service["healthcheck"]["test"][2:2] = ["-h", address]
        elif name == "prometheus":
            # The program that Prometheus' own image starts by itself.
            service["entrypoint"] = ["prometheus"]
            service["command"].append(f"--web.listen-address={address}:9090")
        services[name] = service
    # Volumes are named after the project, and taken away with it.
    volumes = {
        name: volume for name, volume in compose["volumes"].items() if name not in given["without"]
    }
    return {"services": services, "volumes": volumes}


if __name__ == "__main__":
    with open(sys.argv[1], encoding="utf-8") as file:
        print(json.dumps(derive(yaml.safe_load(file), json.load(sys.stdin)), indent=1))
