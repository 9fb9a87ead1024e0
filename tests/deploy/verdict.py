"""Evaluates and prints the records of the clients for each event."""

import time
from collections import Counter
from dataclasses import dataclass

from commands import say

GOING_AWAY = 1012
KILLED, DRAINED = "a replica is killed", "a replica is drained"
SILENT, SPEAKS, ANEW = "the store is silent", "it speaks again", "the store starts anew"
WITHOUT_STORE = (SILENT, SPEAKS, ANEW)


@dataclass
class Chapter:
    """The records of each client between two events."""

    name: str
    begun: float
    ended: float
    parts: dict

    def all(self, what):
        """The details of all entries of this kind."""
        return [entry.detail for part in self.parts.values() for entry in part if entry.what == what]

    def gap(self, client):
        """The longest time without a frame, in ms."""
        moments = [self.begun, *(entry.at for entry in self.parts[client] if entry.what == "frame"), self.ended]
        return max(b - a for a, b in zip(moments, moments[1:], strict=False)) * 1000


class Story:
    """The events and their times."""

    def __init__(self):
        self.events = []

    def begin(self, name):
        self.events.append((name, time.monotonic()))
        say(f"now: {name}")

    def chapters(self, diaries):
        for (name, begun), (_, ended) in zip(self.events, self.events[1:], strict=False):
            parts = {client: [e for e in diary if begun <= e.at < ended] for client, diary in diaries.items()}
            yield Chapter(name, begun, ended, parts)


def judge(check, story, clients, facts):
    diaries = {client.name: client.diary for client in clients}
    kinds = Counter(entry.what for diary in diaries.values() for entry in diary)
    check("every picture is the right one", not kinds["wrong"], f"{kinds['frame']} right, {kinds['wrong']} wrong")
    for chapter in story.chapters(diaries):
        tell(chapter)
        judge_chapter(check, chapter, facts)
    check("the third replica has its share", facts["third"] > 0, f"{facts['third']:.0f} requests and frames")


def tell(chapter):
    hands = [client for client in chapter.parts if client != "uploads"]
    gaps = ", ".join(f"{client} {chapter.gap(client):.0f}" for client in hands)
    say(f"{chapter.name}: {len(chapter.all('frame'))} frames, longest gaps {gaps} ms")
    plans = Counter(filter(None, chapter.all("frame")))
    refused = Counter(f"{status} {said}" for status, _, said in chapter.all("refused"))
    say(f"{chapter.name}: {plans['built']} built, {plans['hit'] / max(plans.total(), 1):.2%} hit; {len(chapter.all('upload'))} uploads")
    broken = f"{len(chapter.all('cut'))} cut short, sockets closed with {chapter.all('closed') or 'nothing'}"
    say(f"{chapter.name}: refused {dict(refused) or 'nothing'}, {broken}")


def judge_chapter(check, chapter, facts):
    name, refused, closed = chapter.name, chapter.all("refused"), chapter.all("closed")
    silent = [client for client, part in chapter.parts.items() if client != "uploads" and not any(e.what == "frame" for e in part)]
    check(f"{name}: every hand goes on", not silent, silent)
    # A response that a killed replica has begun cannot be completed by another one: the client already has the status. It repeats the request.
    if name != KILLED:
        check(f"{name}: no answer breaks off", not chapter.all("cut"), chapter.all("cut")[:3])
    if name in WITHOUT_STORE:
        unlike = [answer for answer in refused if answer[0] != 503 or not answer[1]]
        check(f"{name}: what is refused is 503 with Retry-After", not unlike, unlike[:3])
    else:
        check(f"{name}: nobody is refused", not refused, refused[:3])
    if name == DRAINED:
        there = facts["sockets drained"]
        check("its sockets were closed with 1012", there >= 1 and closed == [GOING_AWAY] * int(there), f"{closed} of {there:.0f}")
        check("it ended with 0", facts["drained exit"] == 0, f"exit {facts['drained exit']} after {facts['drained in']:.1f} s")
    elif name != KILLED:
        check(f"{name}: no socket is closed", not closed, closed)
