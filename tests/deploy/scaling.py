"""Requests a second of one and of two replicas with one thread each behind HAProxy, as far as two
cores can tell: the proxy and the load take their share of them, so processor seconds a request
stand beside it. Printed, not asserted."""

import json
import re
import uuid
from contextlib import ExitStack

from commands import Failure, run, say, where
from drag_clients import PICTURES, Server, multipart
from names import Names
from processes import haproxy, redis, replica

# Sessions per replica, connections of the load, seconds per measurement.
SESSIONS, CONNECTIONS, SECONDS = 8, 8, 5
MOST_SESSIONS = 200
REST = [[380, 130], [250, 400], [0, 0], [512, 0], [0, 512], [512, 512]]
OUTPUTS = {
    "as drags are": "{}",
    "small and compressed best, so that nearly all of "
    "the time is the replica's": '{"compression": "best", "width": 256}',
}

LOAD = """
local paths, at = {%s}, 0
local q = '[[%%d, 130], [380, 130], [250, 400], [0, 0], [512, 0], [0, 512], [512, 512]]'
function request()
    at = at + 1
    local body = '{"q": ' .. string.format(q, 100 + at %% 40) .. ', "output": %s}'
    local headers = {['Content-Type'] = 'application/json'}
    return wrk.format('POST', paths[at %% #paths + 1], headers, body)
end
"""


def check_scaling(stage):
    rates = {}
    with Names() as names:
        addresses = [names.address(n) for n in (11, 12)]
        for count in (1, 2):
            measure(stage, names, addresses[:count], rates)
    for what in OUTPUTS:
        say(
            f"scaling, {what}: {rates[what, 1]:.0f} and {rates[what, 2]:.0f} requests a second, "
            f"ratio {rates[what, 2] / rates[what, 1]:.2f}"
        )


def measure(stage, names, addresses, rates):
    names.addresses["mlswarp"] = addresses
    with ExitStack() as running:
        # A shared store: requests that bounded load moves to the second replica need the session
        # there.
        shared, store = redis(stage)
        running.enter_context(shared)
        environment = {
            "MLSWARP_WORKERS": "1",
            "MLSWARP_DRAG_WAIT": "30s",
            "MLSWARP_TRUSTED_PROXIES": "127.0.0.0/8",
            "MLSWARP_STORE": store,
        }
        replicas = [
            running.enter_context(replica(f"scaling-{a}", stage, a, **environment))
            for a in addresses
        ]
        proxy = running.enter_context(haproxy(stage, names, names.address(3), len(addresses)))
        paths = upload(Server(names.address(3), 8080), [Server(a, 8080) for a in addresses])
        for what, output in OUTPUTS.items():
            script = stage.scratch / "load.lua"
            script.write_text(LOAD % (", ".join(f"'{path}/warp'" for path in paths), output))
            before = [p.processor_seconds() for p in (*replicas, proxy)]
            said = run(
                where("wrk"),
                "-t1",
                f"-c{CONNECTIONS}",
                f"-d{SECONDS}s",
                "-s",
                script,
                f"http://{names.address(3)}:8080",
            ).stdout.decode()
            used = [p.processor_seconds() - b for p, b in zip((*replicas, proxy), before)]
            requests = int(re.search(r"(\d+) requests in", said)[1])
            bad = re.search(r"Non-2xx.*", said)
            stage.check(
                f"scaling, {len(addresses)} replica(s), {what}: no answer was an error",
                bad is None and requests > 0,
                bad and bad[0],
            )
            rates[what, len(addresses)] = float(re.search(r"Requests/sec:\s+([\d.]+)", said)[1])
            each = " + ".join(
                f"{u / max(requests, 1) * 1000:.2f}" for u in (sum(used[:-1]), used[-1])
            )
            say(
                f"scaling, {len(addresses)} replica(s), {what}: {requests} requests, processor ms "
                f"each: replica + proxy {each}"
            )


def upload(front, replicas):
    """Paths of equally many warm sessions on each replica."""
    paths, made, picture = [[] for _ in replicas], 0, (PICTURES / "astronaut.png").read_bytes()
    while any(len(own) < SESSIONS for own in paths):
        if made == MOST_SESSIONS:
            raise Failure("the proxy did not bring sessions to every replica")
        made += 1
        # Different handles, because equal ones would share a plan.
        path, rest = f"/sessions/{uuid.uuid4()}", [[100 + made, 120], *REST]
        front.json("PUT", path, (201,), *multipart(picture, {"p": rest}))
        # Its own replica is warm since the upload.
        plans = [
            server.ask("POST", f"{path}/warp", json.dumps({"q": rest}))[1]["Warp-Plan"]
            for server in replicas
        ]
        home = plans.index("hit")
        if len(paths[home]) < SESSIONS:
            paths[home].append(path)
    # Alternating, so that both replicas always have work.
    return [path for each in zip(*paths) for path in each]
