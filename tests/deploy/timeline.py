"""Evaluates and prints the records of the clients for each event."""

import time
from collections import Counter
from dataclasses import dataclass

from commands import say

GOING_AWAY = 1012
KILLED, DRAINED = "a replica is killed", "a replica is drained"
SILENT, SPEAKS, RESTARTED = "the store is silent", "it speaks again", "the store has restarted"
WITHOUT_STORE = (SILENT, SPEAKS, RESTARTED)


@dataclass
class Phase:
    """The records of each client between two events."""

    name: str
    begun: float
    ended: float
    parts: dict

    def all(self, what):
        """The details of all entries of this kind."""
        return [
            entry.detail for part in self.parts.values() for entry in part if entry.what == what
        ]

    def gap(self, client):
        """The longest time without a frame, in ms."""
        moments = [
            self.begun,
            *(entry.at for entry in self.parts[client] if entry.what == "frame"),
            self.ended,
        ]
        return max(b - a for a, b in zip(moments, moments[1:], strict=False)) * 1000


class Timeline:
    """The events and their times."""

    def __init__(self):
        self.events = []

    def begin(self, name):
        self.events.append((name, time.monotonic()))
        say(f"now: {name}")

    def phases(self, records):
        for (name, begun), (_, ended) in zip(self.events, self.events[1:], strict=False):
            parts = {
                client: [e for e in record if begun <= e.at < ended]
                for client, record in records.items()
            }
            yield Phase(name, begun, ended, parts)


def check_phases(check, timeline, clients, facts):
    records = {client.name: client.record for client in clients}
    kinds = Counter(entry.what for record in records.values() for entry in record)
    check(
        "every picture is the right one",
        not kinds["wrong"],
        f"{kinds['frame']} right, {kinds['wrong']} wrong",
    )
    for phase in timeline.phases(records):
        report(phase)
        check_phase(check, phase, facts)
    check(
        "the third replica has its share",
        facts["third"] > 0,
        f"{facts['third']:.0f} requests and frames",
    )


def report(phase):
    clients = [client for client in phase.parts if client != "uploads"]
    gaps = ", ".join(f"{client} {phase.gap(client):.0f}" for client in clients)
    say(f"{phase.name}: {len(phase.all('frame'))} frames, longest gaps {gaps} ms")
    plans = Counter(filter(None, phase.all("frame")))
    refused = Counter(f"{status} {said}" for status, _, said in phase.all("refused"))
    say(
        f"{phase.name}: {plans['built']} built, {plans['hit'] / max(plans.total(), 1):.2%} hit; "
        f"{len(phase.all('upload'))} uploads"
    )
    broken = (
        f"{len(phase.all('cut'))} cut short, sockets closed with {phase.all('closed') or 'nothing'}"
    )
    say(f"{phase.name}: refused {dict(refused) or 'nothing'}, {broken}")


def check_phase(check, phase, facts):
    name, refused, closed = phase.name, phase.all("refused"), phase.all("closed")
    silent = [
        client
        for client, part in phase.parts.items()
        if client != "uploads" and not any(e.what == "frame" for e in part)
    ]
    check(f"{name}: every client receives frames", not silent, silent)
    # A response that a killed replica has begun cannot be completed by another one: the client
    # already has the status. It repeats the request.
    if name != KILLED:
        check(f"{name}: no answer breaks off", not phase.all("cut"), phase.all("cut")[:3])
    if name in WITHOUT_STORE:
        unlike = [answer for answer in refused if answer[0] != 503 or not answer[1]]
        check(f"{name}: what is refused is 503 with Retry-After", not unlike, unlike[:3])
    else:
        check(f"{name}: nobody is refused", not refused, refused[:3])
    if name == DRAINED:
        there = facts["sockets drained"]
        check(
            "its sockets were closed with 1012",
            there >= 1 and closed == [GOING_AWAY] * int(there),
            f"{closed} of {there:.0f}",
        )
        check(
            "it ended with 0",
            facts["drained exit"] == 0,
            f"exit {facts['drained exit']} after {facts['drained in']:.1f} s",
        )
    elif name != KILLED:
        check(f"{name}: no socket is closed", not closed, closed)
