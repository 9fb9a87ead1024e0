#!/usr/bin/env python3
"""Session affinity: a simulation of sessions on replicas whose caches hold a limited number of
plans.

    tests/bench/affinity.py                    the tables of deploy/capacity.md, in minutes
    tests/bench/affinity.py --sessions 4000    another size; --help lists all options
    tests/bench/affinity.py --check            checks the laws of every selection method, in seconds

Every method gets the same requests, generated from one seed. A replica is one core that serves
requests in order of arrival. A request costs --warm-ms if its plan is in the cache (least recently
used), otherwise --cold-ms: fetching the file, decoding it, building the plan, and the drag.
Sessions arrive and end. Their activity is Zipf-like (a few cause most of the load), in bursts of a
few seconds at 10 poses per second.

`posts` hashes every pose, as a proxy does with `POST /sessions/{id}/warp`. `sockets` selects a
replica once per visit, as for a drag socket, which stays there until the replica leaves. Bounded
load compares the open requests (or sockets) of a replica with the factor times the mean.

Methods: `ring n` has n points per replica (HAProxy: 16 times the weight; nginx: 160 times),
`maglev` is Envoy's table of 65,537 entries. With bounded load, HAProxy replaces a full replica by
the next on the ring, Envoy by another one that depends on the key only.
"""

import argparse
import bisect
import heapq
import math
import random
import sys
from collections import OrderedDict

MASK = (1 << 64) - 1


def mixed(value):
    """64 bits of which each depends on every bit of the value (the finaliser of splitmix64)."""
    value = (value + 0x9E3779B97F4A7C15) & MASK
    value = ((value ^ (value >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    value = ((value ^ (value >> 27)) * 0x94D049BB133111EB) & MASK
    return value ^ (value >> 31)


# --- selection methods: choose(key, open) returns a replica; `open` has the open requests of each -


class RoundRobin:
    def __init__(self, replicas):
        self.replicas, self.turn = list(replicas), 0

    def choose(self, _key, _open):
        self.turn += 1
        return self.replicas[self.turn % len(self.replicas)]


class Modulo:
    def __init__(self, replicas):
        self.replicas = list(replicas)

    def choose(self, key, _open):
        return self.replicas[mixed(key) % len(self.replicas)]


class Bounded:
    """Skips replicas with at least the factor times the mean load; there is always one with
    less."""

    def __init__(self, replicas, factor):
        self.replicas, self.factor = list(replicas), factor

    def choose(self, key, open_now):
        candidates = self.candidates(mixed(key))
        if self.factor is None:
            return next(candidates)
        room = math.ceil(
            self.factor * (sum(open_now[r] for r in self.replicas) + 1) / len(self.replicas)
        )
        return next(r for r in candidates if open_now[r] < room)


class Ring(Bounded):
    def __init__(self, replicas, points, factor=None):
        super().__init__(replicas, factor)
        ring = sorted(
            (mixed(replica << 20 | point), replica)
            for replica in replicas
            for point in range(points)
        )
        self.places, self.owners = [place for place, _ in ring], [owner for _, owner in ring]

    def candidates(self, place):
        first = bisect.bisect_left(self.places, place)
        for step in range(len(self.owners)):
            yield self.owners[(first + step) % len(self.owners)]


class Maglev(Bounded):
    def __init__(self, replicas, size=65_537, factor=None):
        super().__init__(replicas, factor)
        self.table = [None] * size
        walks = [[mixed(r << 20) % size, mixed(r << 20 | 1) % (size - 1) + 1, r] for r in replicas]
        taken = 0
        while taken < size:
            for walk in walks:
                while self.table[walk[0]] is not None:
                    walk[0] = (walk[0] + walk[1]) % size
                self.table[walk[0]] = walk[2]
                taken += 1
                if taken == size:
                    break

    def candidates(self, place):
        yield self.table[place % len(self.table)]
        rest, seed = sorted(self.replicas), place
        while rest:
            seed = mixed(seed)
            yield rest.pop(seed % len(rest))


WAYS = {
    "round robin": RoundRobin,
    "hash modulo n": Modulo,
    "ring 16 (HAProxy, weight 1)": lambda r: Ring(r, 16),
    "ring 160 (nginx)": lambda r: Ring(r, 160),
    "ring 1600 (HAProxy, weight 100)": lambda r: Ring(r, 1600),
    "maglev (Envoy)": Maglev,
    "ring 1600, bounded 1.25": lambda r: Ring(r, 1600, 1.25),
    "ring 1600, bounded 1.5": lambda r: Ring(r, 1600, 1.5),
    "ring 1600, bounded 2": lambda r: Ring(r, 1600, 2.0),
    "maglev, bounded 1.25": lambda r: Maglev(r, factor=1.25),
    "maglev, bounded 1.5": lambda r: Maglev(r, factor=1.5),
}


# --- requests -------------------------------------------------------------------------------------


def requests(options, hot):
    """(time, session, visit) of every pose, ordered by time. A visit is a series of bursts of a
    session, less than a minute apart."""
    chance = random.Random(options.seed)
    ends = options.seconds
    # Sessions that exist at the start, and arrivals: as many as end.
    births = [0.0] * options.sessions
    time = 0.0
    while time < ends:
        time += chance.expovariate(options.sessions / options.life)
        births.append(time)
    ranks = list(range(1, len(births) + 1))
    chance.shuffle(ranks)
    weights = [rank**-options.zipf for rank in ranks]
    mean = sum(weights) / len(weights)
    poses = []
    for birth, weight in zip(births, weights):
        session = chance.getrandbits(60)
        death = min(birth + chance.expovariate(1 / options.life), ends)
        # At most one burst in four seconds for every rank: users pause.
        pace = min(weight / mean / options.between, 0.25)
        # From the middle on, one session in fifty drags without pause.
        heated = hot and chance.random() < 0.02
        visit, last = 0, -1e9
        time = birth + chance.expovariate(pace)
        while time < death:
            if time - last > 60:
                visit += 1
            until = min(time + chance.expovariate(1 / options.burst), death)
            while time < until:
                poses.append((time, session, visit))
                time += 0.1 * chance.uniform(0.8, 1.2)
            last = time
            quick = heated and time > options.at
            time += chance.expovariate(1.0 if quick else pace)
    poses.sort()
    return poses


# --- simulation -----------------------------------------------------------------------------------


class Window:
    """Counters of a time window."""

    def __init__(self, begins, ends):
        self.begins, self.ends = begins, ends
        self.asked = self.warm = 0
        self.built, self.work, self.waits = 0.0, {}, []

    def note(self, replica, hit, cost, extra, wait):
        self.asked += 1
        self.warm += hit
        self.built += extra
        self.work[replica] = self.work.get(replica, 0.0) + cost
        self.waits.append(wait)

    def hits(self):
        return 100 * self.warm / max(self.asked, 1)

    def imbalance(self, replicas):
        work = [self.work.get(r, 0.0) for r in replicas]
        return max(work) * len(work) / max(sum(work), 1e-9)

    def rebuilt(self, replicas):
        return 100 * self.built / ((self.ends - self.begins) * len(replicas))

    def late(self, share=0.99):
        return 1000 * sorted(self.waits)[int(share * (len(self.waits) - 1))] if self.waits else 0.0


def play(way, poses, options, change):
    """Simulates all requests; `change` happens in the middle: None, "leave", "join", "slow".
    Returns the window before it and the minute after."""
    before = list(range(1, options.replicas + 1))
    after = {"leave": before[:-1], "join": [*before, options.replicas + 1]}.get(change, before)
    choose = way(before)
    chooses_after = way(after)
    caches = {r: OrderedDict() for r in [*before, *after]}
    free = dict.fromkeys(caches, 0.0)
    open_now = dict.fromkeys(caches, 0)
    speed = dict.fromkeys(caches, 1.0)
    ending, seats = [], {}
    steady, disturbed = Window(options.settle, options.at), Window(options.at, options.at + 60)
    changed = False
    # A socket closes at the end of its visit.
    last = (
        {(session, visit): time for time, session, visit in poses}
        if options.traffic == "sockets"
        else {}
    )
    for time, session, visit in poses:
        if not changed and time >= options.at:
            changed, choose = True, chooses_after
            if change == "slow":
                speed[before[0]] = 2.0
        while ending and ending[0][0] <= time:
            _, seat, replica = heapq.heappop(ending)
            if seat is None or seats.get(seat) == replica:
                open_now[replica] -= 1
                seats.pop(seat, None)
        if last:
            seat = (session, visit)
            replica = seats.get(seat)
            if replica is None or (changed and change == "leave" and replica == before[-1]):
                replica = choose.choose(session, open_now)
                seats[seat] = replica
                open_now[replica] += 1
                heapq.heappush(ending, (last[seat] + 1.0, seat, replica))
        else:
            replica = choose.choose(session, open_now)
        cache = caches[replica]
        hit = session in cache
        if hit:
            cache.move_to_end(session)
        else:
            cache[session] = True
            if len(cache) > options.plans:
                cache.popitem(last=False)
        warm = options.warm_ms / 1000 * speed[replica]
        cost = warm if hit else options.cold_ms / 1000 * speed[replica]
        begins = max(time, free[replica])
        free[replica] = begins + cost
        if not last:
            open_now[replica] += 1
            heapq.heappush(ending, (free[replica], None, replica))
        window = (
            steady
            if steady.begins <= time < steady.ends
            else disturbed
            if disturbed.begins <= time < disturbed.ends
            else None
        )
        if window:
            window.note(replica, hit, cost, cost - warm, begins - time)
        if time >= disturbed.ends:
            break
    return steady, disturbed, before, after


def table(options):
    plain, hot = requests(options, False), requests(options, True)
    steady_poses = sum(options.settle <= t < options.at for t, _, _ in plain) / (
        options.at - options.settle
    )
    print(
        f"{options.replicas} replicas of one core, {options.plans} plans each; {options.sessions} "
        f"sessions, {steady_poses:.0f} poses a second by {options.traffic}; "
        f"warm {options.warm_ms} ms, cold {options.cold_ms} ms; seed {options.seed}\n"
    )
    print(
        "| | steady: warm | busiest / mean | rebuilding, of capacity | wait, 99 in 100 | minute "
        "after one left: warm | rebuilding | wait | "
        "after one joined: warm | hot sessions: warm | busiest / mean | wait | a slow replica: "
        "busiest / mean | wait |"
    )
    print("|---|" + "---|" * 13)
    for name, way in WAYS.items():
        steady, left, before, after = play(way, plain, options, "leave")
        _, joined, _, _ = play(way, plain, options, "join")
        _, heated, _, _ = play(way, hot, options, None)
        _, slowed, _, _ = play(way, plain, options, "slow")
        cells = [
            f"{steady.hits():.1f} %",
            f"{steady.imbalance(before):.2f}",
            f"{steady.rebuilt(before):.1f} %",
            f"{steady.late():.0f} ms",
            f"{left.hits():.1f} %",
            f"{left.rebuilt(after):.1f} %",
            f"{left.late():.0f} ms",
            f"{joined.hits():.1f} %",
            f"{heated.hits():.1f} %",
            f"{heated.imbalance(before):.2f}",
            f"{heated.late():.0f} ms",
            f"{slowed.imbalance(before):.2f}",
            f"{slowed.late():.0f} ms",
        ]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


# --- laws -----------------------------------------------------------------------------------------


def check():
    """Checks the laws of every method, for every seed; raises on a violation."""
    keys = [mixed(k) for k in range(20_000)]
    none = dict.fromkeys(range(1, 30), 0)

    def moved(way, before, after):
        old, new = way(before), way(after)
        pairs = [(old.choose(k, none), new.choose(k, none)) for k in keys]
        return sum(a != b for a, b in pairs) / len(keys), pairs

    twelve, eleven = range(1, 13), range(1, 12)
    for points in (160, 1600):
        share, pairs = moved(lambda r, n=points: Ring(r, n), twelve, eleven)
        assert all(a == 12 for a, b in pairs if a != b), (
            "a ring moves only the keys of the replica that left"
        )
        assert abs(share - 1 / 12) < 0.03, share
        share, pairs = moved(lambda r, n=points: Ring(r, n), eleven, twelve)
        assert all(b == 12 for a, b in pairs if a != b), "and only to the one that joined"
    share, _ = moved(Maglev, twelve, eleven)
    assert 1 / 12 < share + 0.01 < 1 / 12 + 0.05, (
        f"Maglev moves little more than its share: {share}"
    )
    share, _ = moved(Modulo, twelve, eleven)
    assert share > 0.85, f"hash modulo n moves nearly all: {share}"

    # Bounded: no replica exceeds the factor, and an idle replica gets the sessions that hash to it.
    for way in (lambda r: Ring(r, 160, 1.25), lambda r: Maglev(r, 2039, 1.25)):
        chooser, placed = way(twelve), dict.fromkeys(twelve, 0)
        for number, key in enumerate(keys, start=1):
            placed[chooser.choose(key, placed)] += 1
            assert max(placed.values()) <= math.ceil(1.25 * number / 12)
        free = Ring(twelve, 160) if isinstance(chooser, Ring) else Maglev(twelve, 2039)
        assert all(chooser.choose(k, none) == free.choose(k, none) for k in keys[:1000])
    table_of = Maglev(twelve, 2039).table
    spread = [table_of.count(replica) for replica in twelve]
    assert max(spread) - min(spread) <= 1, "Maglev gives each replica the same number of places"

    # A small simulation: affinity must have a benefit, and the same seed must give the same
    # figures.
    options = parser().parse_args(
        [
            "--sessions",
            "200",
            "--replicas",
            "4",
            "--plans",
            "80",
            "--seconds",
            "150",
            "--settle",
            "40",
            "--at",
            "80",
        ]
    )
    poses = requests(options, False)
    assert poses == requests(options, False) and poses != requests(
        argparse.Namespace(**{**vars(options), "seed": 2}), False
    )
    ring, around = (
        play(WAYS["ring 160 (nginx)"], poses, options, "leave"),
        play(WAYS["round robin"], poses, options, "leave"),
    )
    assert ring[0].hits() > 95 > around[0].hits(), (ring[0].hits(), around[0].hits())
    calm = play(WAYS["ring 160 (nginx)"], poses, options, None)
    assert calm[0].hits() == ring[0].hits() and calm[1].hits() > ring[1].hits(), (
        "who leaves takes plans along"
    )
    options.traffic = "sockets"
    sockets = play(WAYS["ring 160 (nginx)"], poses, options, "leave")
    assert sum(w.asked for w in sockets[:2]) == sum(w.asked for w in ring[:2]) > 1000
    assert options.replicas in sockets[0].work and options.replicas not in sockets[1].work, (
        "nothing is asked of a replica that has left"
    )
    print(f"held: affinity of {len(keys)} keys over 12 replicas, {len(poses)} poses played")


def parser():
    p = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    p.add_argument("--check", action="store_true", help="the laws alone")
    p.add_argument("--traffic", choices=["posts", "sockets"], default="posts")
    p.add_argument("--replicas", type=int, default=12)
    p.add_argument("--sessions", type=int, default=2000, help="alive at one time")
    p.add_argument("--plans", type=int, default=200, help="a replica's cache, in plans")
    p.add_argument("--warm-ms", type=float, default=6.0)
    p.add_argument("--cold-ms", type=float, default=20.0)
    p.add_argument("--life", type=float, default=600.0, help="mean life of a session, s")
    p.add_argument(
        "--between",
        type=float,
        default=40.0,
        help="mean time between two bursts of a session of mean activity, s",
    )
    p.add_argument("--burst", type=float, default=2.5, help="mean length of a burst, s")
    p.add_argument("--zipf", type=float, default=0.6, help="exponent of activity over rank")
    p.add_argument("--settle", type=float, default=240.0, help="when counting begins, s")
    p.add_argument("--at", type=float, default=360.0, help="when the change happens, s")
    p.add_argument("--seconds", type=float, default=421.0)
    p.add_argument("--seed", type=int, default=1)
    return p


if __name__ == "__main__":
    chosen = parser().parse_args()
    sys.exit(check() if chosen.check else table(chosen))
