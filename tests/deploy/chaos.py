"""Eight clients drag through the proxy while replicas are killed, drained and added, and while the
store is down; a ninth uploads.

Every image is compared byte for byte with the result of a single server for the same pose. Nothing
is asserted about time; gaps are printed (timeline.py)."""

import contextlib
import json
import threading
import time

from commands import Failure, say
from drag_clients import RequestClient, Server, SocketClient, Uploader
from image import Container
from names import Names
from stack import COMPOSE, Stack
from timeline import DRAINED, KILLED, RESTARTED, SILENT, SPEAKS, Timeline, check_phases

# Seconds: before the first event, from one to the next, without the store.
CALM, PAUSE, AWAY = 4.0, 11.0, 10.0
# Maximum time in which a replica answers with the last pose.
TOLD = 10.0
DRAG_CLIENTS = (
    RequestClient("request 1", "chelsea.png", 0.00),
    RequestClient("request 2", "coffee.png", 0.02),
    RequestClient("request 3", "rocket.jpg", 0.04),
    RequestClient("request 4", "astronaut.png", 0.06),
    RequestClient("request 5", "horse-cutout.png", 0.08),
    RequestClient("request 6", "chelsea.png", 0.10),
    SocketClient("socket 1", "coffee.png", 0.05),
    SocketClient("socket 2", "astronaut.png", 0.01),
)


def check_stack(stage):
    check = stage.check
    with Names() as names, Stack(stage.engine, names, stage.services, stage.scratch) as stack:
        said = stack.compose("config", "--quiet", file=COMPOSE, check=False)
        check(
            "docker-compose takes the file as it is",
            said.returncode == 0,
            said.stderr.decode(errors="replace")[-300:],
        )
        stack.start()
        with Container(stage.engine) as lone:
            lone.wait_ready()
            for client in DRAG_CLIENTS:
                client.learn(Server("127.0.0.1", lone.port))
        say(
            "the lone server showed "
            f"{sum(len(expected) for client in DRAG_CLIENTS for expected in client.expected)} "
            "pictures"
        )
        for client in DRAG_CLIENTS:
            client.put(stack.proxy)
        check_proxy(check, stack)

        uploader, stop, timeline = Uploader(), threading.Event(), Timeline()
        clients = (*DRAG_CLIENTS, uploader)
        threads = [
            threading.Thread(target=client.drag, args=(stack.proxy, stop), name=client.name)
            for client in clients
        ]
        for thread in threads:
            thread.start()
        try:
            facts = run_events(stack, timeline)
        finally:
            stop.set()
            for thread in threads:
                thread.join(30)
        check_phases(check, timeline, clients, facts)
        look_after(check, stack, uploader)


def check_proxy(check, stack):
    """Single requests through the proxy."""
    plans, right = [], True
    for client in DRAG_CLIENTS:
        if isinstance(client, RequestClient):
            # The upload reached its replica by the id as it is written in lower case.
            path = f"/sessions/{client.session.upper()}/warp"
            status, headers, picture = stack.proxy.ask(
                "POST", path, json.dumps({"q": client.poses[0]})
            )
            plans.append(headers["Warp-Plan"])
            right = right and status == 200 and picture in client.expected[0]
    check(
        "a session written in capitals goes where its upload went",
        right and set(plans) == {"hit"},
        plans,
    )
    status, headers, body = stack.proxy.ask("GET", "/metrics")
    told = json.loads(body) if headers["Content-Type"] == "application/problem+json" else {}
    check(
        "the figures of replicas are not for everybody",
        (status, told.get("code")) == (404, "not_found"),
        status,
    )
    status, headers, body = stack.proxy.ask(
        "GET", "/sessions/none", headers={"X-Request-Id": "an-id-of-the-test"}
    )
    check(
        "a request's id goes through",
        (status, headers["X-Request-Id"]) == (404, "an-id-of-the-test"),
        f"{status} {headers['X-Request-Id']}",
    )


def run_events(stack, timeline):
    """Runs the events in sequence, and records the state of the replicas."""
    facts, (*first_two, third) = {}, stack.replicas
    timeline.begin("calm")
    time.sleep(CALM)

    # Docker restarts it automatically (compose.yaml).
    killed = max(
        first_two,
        key=lambda r: stack.figure(r, "mlswarp_requests_total", 'route="/sessions/{id}/warp"'),
    )
    timeline.begin(KILLED)
    stack.kill(killed)
    time.sleep(PAUSE)
    stack.wait_balanced(2)

    drained = max(first_two, key=lambda r: stack.figure(r, "mlswarp_sockets"))
    facts["sockets drained"] = stack.figure(drained, "mlswarp_sockets")
    timeline.begin(DRAINED)
    container = stack.container(drained)
    begun = time.monotonic()
    stack.engine("stop", container)
    facts["drained in"], facts["drained exit"] = (
        time.monotonic() - begun,
        stack.state(container)["ExitCode"],
    )
    stack.names.addresses["mlswarp"].remove(stack.replicas[drained])
    time.sleep(PAUSE - 4)
    timeline.begin("it comes back")
    stack.engine("start", container)
    stack.names.addresses["mlswarp"].append(stack.replicas[drained])
    stack.wait_balanced(2)
    time.sleep(4)

    timeline.begin("a third one is added")
    stack.compose("up", "--detach", "--no-build", "--no-recreate", third)
    stack.names.addresses["mlswarp"].append(stack.replicas[third])
    stack.wait_balanced(3)
    time.sleep(PAUSE - 3)
    frames = stack.figure(third, "mlswarp_frames_sent_total")
    facts["third"] = frames + stack.figure(
        third, "mlswarp_requests_total", 'route="/sessions/{id}/warp"'
    )

    timeline.begin(SILENT)
    stack.signal("store", "STOP")
    time.sleep(AWAY)
    stack.signal("store", "CONT")
    timeline.begin(SPEAKS)
    time.sleep(4)
    timeline.begin(RESTARTED)
    stack.compose("restart", "--timeout", "5", "store")
    time.sleep(5)
    timeline.begin("the end")
    return facts


def known(stack, client):
    """The last pose that the service knows."""
    deadline, seq = time.monotonic() + TOLD, -1
    while seq < client.answered and time.monotonic() < deadline:
        with contextlib.suppress(Failure):
            seq = stack.proxy.json("GET", f"/sessions/{client.session}", (200,))["seq"] or 0
        time.sleep(0.1)
    return seq


def look_after(check, stack, uploader):
    """Checks that every session exists and has its last pose."""
    lost = [
        client.name
        for client in DRAG_CLIENTS
        if stack.proxy.ask("GET", f"/sessions/{client.session}")[0] != 200
    ]
    check("no session that was dragged is lost", not lost, lost or f"{len(DRAG_CLIENTS)} looked at")
    behind = []
    for client in DRAG_CLIENTS:
        # A rejected pose, or one cut off by the end of the test, may be missing.
        if (
            isinstance(client, RequestClient)
            and not client.answered <= (seq := known(stack, client)) <= client.seq
        ):
            behind.append((client.name, seq, client.answered, client.seq))
    check("each knows how far it was dragged", not behind, behind)
    lost = [
        session
        for session in uploader.promised
        if stack.proxy.ask("GET", f"/sessions/{session}")[0] != 200
    ]
    check(
        "no upload that was answered is lost",
        not lost and uploader.promised,
        f"{len(uploader.promised)} looked at, {len(lost)} lost",
    )
    built = sum(
        stack.figure(r, "mlswarp_cache_builds_total", 'cache="plans"') for r in stack.replicas
    )
    say(f"plans built: {built:.0f} (of the processes that live)")
    # On a server without keys, the id is enough to use a session.
    log = stack.compose("logs", "--no-color", "proxy").stdout.decode(errors="replace")
    told = [client.name for client in DRAG_CLIENTS if client.session in log]
    lines = log.count(" POST\n")
    check(
        "the proxy's log has a line for each request and names no session",
        lines > 100 and not told,
        told or f"{lines} lines",
    )
    prometheus = Server(stack.addresses["prometheus"], 9090)
    targets = prometheus.json("GET", "/api/v1/targets", (200,))["data"]["activeTargets"]
    health = sorted(f"{t['labels']['job']} {t['health']}" for t in targets)
    check(
        "Prometheus asks every replica and the proxy",
        health == ["mlswarp up"] * 3 + ["proxy up"],
        health,
    )
    groups = prometheus.json("GET", "/api/v1/rules", (200,))["data"]["groups"]
    check("and has the alert rules", bool(groups), f"{sum(len(g['rules']) for g in groups)} rules")
