"""Costs of others to a client: some stopped, some that read slowly, users who ask for far too much or for too long.

Usage: tools/attack isolation [--stopped N] [--slow N] [--greedy U] [--seconds S] [--workers W] [--judge]

A service runs with users of its own. A healthy one asks for plans of a Panda and for the list of robots: alone; beside
clients that asked for large answers and were stopped, and others that read 200 kB a second; beside greedy users, each
with ten plans asked for at any time; and beside as many who ask for plans that take 30 s. Another user asks beyond its
quota, alone and beside the greedy ones. Told are the healthy one's times and their ratios to those of the idle service,
how long it waited for a worker, how many plans a second all of them got, how long refusals took, and what wasn't
answered. Exit code 0: every query was answered, and nobody healthy was refused. With --judge the 99th percentile must
be at most twice that of the idle service too (for greedy users plus the longest plan), all plans a second at least 95 %
of what one user alone gets with as many workers, no plan may wait longer than 1 s beside long ones, and a refusal may
take 5 ms in the median; that takes a quiet machine.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from tests.journeys.links import Link
from tests.journeys.service import LONG as WALLED

from guidefield import Client, GuidefieldError, QuotaExceeded, ServerBusy
from guidefield.cli.serving import service_in_child

RATE = 200_000
"""Bytes that a slow client reads in a second."""
STEP = 0.05
"""Time between two checks of the service's work [s]."""
AT_ONCE = 10
"""Number of plans that a greedy user waits for at any time."""
PAUSE = 0.05
"""Between two questions of the healthy user [s]."""
PLAN = {
    "robot": "panda",
    "scene": "table",
    "goal": {"type": "joints", "positions": {"panda_joint1": 0.4, "panda_joint4": -1.8}},
    "guide_planes": [],
    "recording": "off",
    "allowed_planning_time": 60.0,
}
LONG = {**WALLED, "allowed_planning_time": 30.0}
"""From one side of a wall to the other: a search that takes its 30 s."""
LONG_AT_ONCE = 4
"""Number of them that a user waits for at any time."""
BEYOND = {"users": {"bounded": {"per_second": 1}}}
REFUSALS = 300
"""Number of queries beyond that quota."""
GOAL_BEGUN, GOAL_REFUSED = 1.0, 5e-3
"""Longest wait of a plan beside long ones, and longest time of a refusal [s]."""
LARGE = """
import json, sys, threading, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
ball = {"name": "s", "obstacles": [{"type": "sphere", "name": "b", "radius": 0.1}]}
payload = json.dumps({"type": "potential", "scene": ball, "points": [[0.1, 0.0, 2.0]] * 50_000})
with zenoh.open(config) as session:
    for _ in range(int(sys.argv[3])):
        session.get(f"guidefield/local/as/{sys.argv[2]}/kinematics", lambda reply: None, payload=payload, timeout=600.0)
    print("asked", flush=True)
    threading.Event().wait()
"""
"""A client that asks for large answers: some MB each."""


@dataclass
class Tally:
    """A user's answers: their times and the waits of its plans [s], numbers of refusals, and failures."""

    seconds: list[float] = field(default_factory=list)
    plans: list[float] = field(default_factory=list)
    waited: list[float] = field(default_factory=list)
    refused: int = 0
    failed: list[str] = field(default_factory=list)

    def p99(self) -> float:
        """The 99th percentile of the times [s]; of less than a hundred the longest."""
        return sorted(self.seconds)[math.ceil(0.99 * (len(self.seconds) - 1))]


def ask(client: Client, tally: Tally, until: float, pause: float, *, lists: bool) -> None:
    """Ask one thing after the other until a time, and note what comes."""
    while time.monotonic() < until:
        begun = time.monotonic()
        try:
            if lists:
                client.robots()
            reply = client.plan(PLAN)
            tally.waited.append(reply.timing.queue)
            if time.monotonic() < until:
                tally.plans.append(reply.timing.total - reply.timing.queue)
        except (ServerBusy, QuotaExceeded) as refused:
            tally.refused += 1
            time.sleep(min(0.5, refused.details.get("retry_after", 0.5)))
            continue
        except GuidefieldError as error:
            tally.failed.append(str(error))
        tally.seconds.append(time.monotonic() - begun)
        time.sleep(pause)


@contextlib.contextmanager
def stopped_clients(endpoint: str, count: int) -> Iterator[None]:
    """Clients that asked and are stopped, for as long as the block runs."""
    with contextlib.ExitStack() as opened:
        for number in range(count):
            opened.enter_context(asking_client(endpoint, f"stopped{number}")).send_signal(signal.SIGSTOP)
        yield


@contextlib.contextmanager
def slow_clients(endpoint: str, count: int) -> Iterator[None]:
    """Clients behind links of `RATE`, for as long as the block runs."""
    with contextlib.ExitStack() as opened:
        for number in range(count):
            link = Link(endpoint, RATE)
            opened.callback(link.close)
            opened.enter_context(asking_client(link.endpoint, f"slow{number}"))
        yield


@contextlib.contextmanager
def asking_client(endpoint: str, user: str) -> Iterator[subprocess.Popen[bytes]]:
    """A client that asked for large answers, for as long as the block runs."""
    command = [sys.executable, "-c", LARGE, endpoint, user, "2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            process.stdout.readline()
            yield process
        finally:
            process.kill()


def ask_as_healthy(endpoint: str, seconds: float, *, beside: bool = False) -> Tally:
    """Ask as the healthy user for a while, once nobody's work is under way unless it is to be beside that."""
    tally = Tally()
    with Client.connect(endpoint, user="healthy", wait=60.0) as client:
        while not beside and (told := client.info()).busy + told.queue:
            time.sleep(STEP)
        ask(client, tally, time.monotonic() + seconds, PAUSE, lists=True)
    return tally


def ask_as_crowd(endpoint: str, users: list[str], at_once: int, seconds: float) -> Tally:
    """Ask as users who each wait for some plans at any time; return what they get together."""
    tally, until = Tally(), time.monotonic() + seconds
    with contextlib.ExitStack() as opened, ThreadPoolExecutor(max(1, at_once * len(users))) as threads:
        for user in users:
            client = opened.enter_context(Client.connect(endpoint, user=user, wait=60.0))
            for _ in range(at_once):
                threads.submit(ask, client, tally, until, 0.0, lists=False)
    return tally


@contextlib.contextmanager
def hold_workers(endpoint: str, users: list[str], workers: int) -> Iterator[None]:
    """Users with long plans in the queue and on every worker, for as long as the block runs; they are gone then."""
    with contextlib.ExitStack() as opened, ThreadPoolExecutor(LONG_AT_ONCE * len(users)) as threads:
        clients = [opened.enter_context(Client.connect(endpoint, user=user, wait=60.0)) for user in users]
        names = [f"long{number}" for number in range(LONG_AT_ONCE)]
        for client, name in ((client, name) for name in names for client in clients):
            threads.submit(client.plan, {**LONG, "run_id": name})
        with Client.connect(endpoint, wait=60.0) as operator:
            while operator.info().busy < workers:
                time.sleep(STEP)
            yield
            for name in names:
                for user in users:
                    operator.cancel(f"{user}:{name}")


def time_refusals(endpoint: str) -> list[float]:
    """Measure the times of answers to queries beyond a quota [s]."""
    times = []
    with Client.connect(endpoint, user="bounded", wait=60.0) as client:
        while len(times) < REFUSALS:
            begun = time.monotonic()
            try:
                client.scenes()
            except QuotaExceeded:
                times.append(time.monotonic() - begun)
    return sorted(times)


def print_tally(what: str, tally: Tally, idle: Tally | None = None) -> None:
    """Print what a user got, and how that is beside what it gets of an idle service."""
    half = sorted(tally.seconds)[len(tally.seconds) // 2]
    beside = "" if idle is None else f", p99 {tally.p99() / idle.p99():.2f} times the idle one"
    print(
        f"{what:34s} {len(tally.seconds):5d} answers, median {1e3 * half:7.1f} ms, p99 {1e3 * tally.p99():7.1f} ms, "
        f"longest {1e3 * max(tally.seconds):7.1f} ms, "
        f"{tally.refused} refused, {len(tally.failed)} failed{beside}",
        flush=True,
    )
    for failure in tally.failed[:3]:
        print(f"  {failure}")


def print_refusals(what: str, times: list[float]) -> None:
    """Print how long refusals took."""
    median, p99 = times[len(times) // 2], times[int(0.99 * (len(times) - 1))]
    print(f"{what:34s} {len(times):5d} refusals, median {1e3 * median:6.2f} ms, p99 {1e3 * p99:7.2f} ms", flush=True)


def run(arguments: list[str]) -> int:
    """Measure, and say how it went."""
    parser = argparse.ArgumentParser(prog="tools/attack isolation", description=__doc__.partition("\n")[0])
    parser.add_argument("--stopped", type=int, default=20)
    parser.add_argument("--slow", type=int, default=20)
    parser.add_argument("--greedy", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=30.0, help="how long each part takes [s]")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--judge", action="store_true", help="judge the times too; the machine has to be quiet")
    options = parser.parse_args(arguments)
    with tempfile.NamedTemporaryFile("w", suffix=".json") as quotas:
        json.dump(BEYOND, quotas)
        quotas.flush()
        with service_in_child(print, workers=options.workers, options=("--quota", quotas.name)) as service:
            return measure(service.endpoint, options)


def measure(endpoint: str, options: argparse.Namespace) -> int:
    """Measure a service; the exit code."""
    seconds, users = options.seconds, range(options.greedy)
    ask_as_healthy(endpoint, min(3.0, seconds))  # warms up
    idle = ask_as_healthy(endpoint, seconds)
    print_tally("healthy, alone", idle)
    refusals = time_refusals(endpoint)
    print_refusals("beyond a quota", refusals)
    alone = ask_as_crowd(endpoint, ["alone"], options.workers, seconds)
    print_tally("one user with all workers", alone)
    with stopped_clients(endpoint, options.stopped), slow_clients(endpoint, options.slow):
        beside = ask_as_healthy(endpoint, seconds)
    print_tally(f"healthy, {options.stopped} stopped and {options.slow} slow", beside, idle)
    with ThreadPoolExecutor(1) as thread:
        crowd = thread.submit(ask_as_crowd, endpoint, [f"greedy{number}" for number in users], AT_ONCE, seconds)
        loaded = ask_as_healthy(endpoint, seconds, beside=True)
        greedy = crowd.result()
    print_tally(f"healthy, {options.greedy} greedy users", loaded, idle)
    print_tally("greedy users", greedy)
    with ThreadPoolExecutor(1) as thread:
        greedy_users = [f"greedy{number}" for number in users]
        crowd = thread.submit(ask_as_crowd, endpoint, greedy_users, AT_ONCE, min(3.0, seconds))
        print_refusals("beyond a quota, beside them", time_refusals(endpoint))
        crowd.result()
    with hold_workers(endpoint, [f"long{number}" for number in users], options.workers):
        held_up = ask_as_healthy(endpoint, seconds, beside=True)
    print_tally(f"healthy, {options.greedy} users with long plans", held_up, idle)
    longest, waited = max([*greedy.plans, *loaded.plans], default=0.0), max(held_up.waited, default=0.0)
    share = (len(greedy.plans) + len(loaded.plans)) / max(1, len(alone.plans))
    excess = (loaded.p99() - longest) / idle.p99()
    print(f"a plan waited for at most {1e3 * waited:.0f} ms beside long ones")
    print(f"plans a second: {len(alone.plans) / seconds:.1f} alone, {100 * share:.0f} % of it beside greedy users;")
    print(f"longest plan {1e3 * longest:.0f} ms; p99 beside them without it {excess:.2f} times the idle one")
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    parts = (idle, alone, beside, loaded, greedy, held_up)
    good = not any(part.failed for part in parts) and not (idle.refused or beside.refused or loaded.refused)
    if options.judge:
        good &= beside.p99() <= 2.0 * idle.p99() and excess <= 2.0 and share >= 0.95
        good &= waited <= GOAL_BEGUN and refusals[len(refusals) // 2] <= GOAL_REFUSED
    return int(not good)
