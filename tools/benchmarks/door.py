"""The cost of the service's door: a plain Zenoh queryable, the service and the same answers in process, in turn.

Usage: tools/bench door [--only PARTS] [--seconds S] [--plans N] [--workers N]

All are asked over loopback, without scouting, by the same clients: processes of their own, with a session each, that
send JSON and throw the answers away. "Plain" is a queryable of forty lines with Pinocchio in its own process. A service
is as it starts by default, on a data folder of its own. The parts:

- kinematics: forward kinematics and clearance, one client, each target for S seconds, in rounds. *own* and *workers*
  are the processor time of the target's process and of its children for each query, *switches* their context switches.
- clients: answers a second with 1, 8 and 24 clients.
- plans: a Panda's plan, N times each in rounds, one after the other as in all parts, recordings off; *extra* is the
  median beyond that in process. After a pause of 0.1 s everybody's answer takes longer: a plain one five times.

Kept runs, batches and recordings are measured by `tools/bench growth` and `whole`. Last comes the table of goals. On a
machine with other work only ratios within a run count.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import distribution
from pathlib import Path
from typing import Any, Self

import numpy as np

import guidefield
from guidefield import JointsGoal, PlanRequest
from guidefield.cli.serving import LOOPBACK, free_port, service_in_child
from guidefield.messages import codec

PARTS = ("kinematics", "clients", "plans")
CLIENTS = (1, 8, 24)
ROUNDS = 5
"""Rounds in which all targets are asked in turn."""
_CLOCK_OF_PROCESS = 2
HEAD_START = 0.05
"""Between an order and the moment at which all clients begin [s]."""
DOORS = Path(__file__).resolve().parent / "doors"
SHARE = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share")))
SHELF = DOORS.parents[2] / "scenes" / "bookshelf.json"
PANDA = SHARE / "example-robot-data" / "robots" / "panda_description"
BENT = {"panda_joint1": 0.3, "panda_joint2": -0.8, "panda_joint4": -2.3, "panda_joint6": 1.6, "panda_joint7": 0.8}
FRAMES = {"type": "forward_kinematics", "robot": "panda", "frames": ["panda_hand_tcp"], "configurations": [BENT]}
CLEARANCE = {"type": "clearance", "robot": "panda", "scene": "bookshelf", "configurations": [BENT]}
QUESTIONS = {"forward kinematics": FRAMES, "clearance": CLEARANCE}
PLAN = PlanRequest("panda", "table", JointsGoal({"panda_joint1": 0.1}), guide_planes=[], recording="off")
WARM = 5
"""Answers that don't count."""
PLAIN, SERVICE, IN_PROCESS = "plain", "service", "in process"
Figures = dict[tuple[str, str], float]
"""Measured values by quantity and target."""
GOALS: tuple[tuple[str, float, Callable[[Figures], float]], ...] = (
    (
        "forward kinematics over Zenoh / plain, median",
        3.0,
        lambda f: f["forward kinematics", SERVICE] / f["forward kinematics", PLAIN],
    ),
    (
        "plain's answers a second / ours, 8 clients",
        3.0,
        lambda f: f["8 clients", PLAIN] / f["8 clients", SERVICE],
    ),
    (
        "our best answers a second / ours with 24 clients",
        1.15,
        lambda f: max(f[f"{n} clients", SERVICE] for n in CLIENTS) / f["24 clients", SERVICE],
    ),
    (
        "a plan over Zenoh less in process / plain's answer",
        8.0,
        lambda f: f["extra", SERVICE] / f["forward kinematics", PLAIN],
    ),
)
"""The goals: what, the most that it may be, and how it is made of the figures."""


@dataclass(frozen=True)
class Target:
    """A queryable: where it listens, its process, and its keys of kinematics and plans."""

    endpoint: str
    pid: int
    kinematics: str = "guidefield/local/kinematics"
    plan: str = "guidefield/local/plan"


class Askers:
    """Client processes, each with sessions of its own; a context manager."""

    def __init__(self, count: int) -> None:
        command = [sys.executable, str(DOORS / "asker.py")]
        self._processes = [
            subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(count)
        ]
        self.errors: dict[str, int] = defaultdict(int)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes:
            process.communicate()

    def ask(self, clients: int, target: Target, key: str, request: Any, **until: float) -> np.ndarray:
        """Let so many clients ask, each for some `seconds` or a `count`; the times of all answers [s]."""
        order = {
            "endpoint": target.endpoint,
            "key": key,
            "payload": codec.encode(request).decode(),
            "begin": time.monotonic() + HEAD_START,
            **until,
        }
        for process in self._processes[:clients]:
            process.stdin.write(json.dumps(order) + "\n")
            process.stdin.flush()
        times: list[float] = []
        for process in self._processes[:clients]:
            told = json.loads(process.stdout.readline())
            times += told["times"]
            for error in told["first_error"]:
                self.errors[f"{key}: {error:.200}"] += told["errors"]
        return np.array(times)


@contextlib.contextmanager
def plain_queryable() -> Iterator[Target]:
    """A plain queryable, for as long as the block runs."""
    files = [str(PANDA / "urdf" / "panda.urdf"), str(PANDA / "srdf" / "panda.srdf"), str(SHARE), str(SHELF)]
    with free_port() as port:
        endpoint = f"tcp/{LOOPBACK}:{port}"
        command = [sys.executable, str(DOORS / "plain.py"), endpoint, *files]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout.readline() == "ready\n", "it tells when it takes queries"
                yield Target(endpoint, process.pid, kinematics="plain")
            finally:
                process.kill()


@contextlib.contextmanager
def default_service(workers: int, data: Path | None = None, options: Sequence[str] = ()) -> Iterator[Target]:
    """A service on a data folder of its own unless one is given, for as long as the block runs."""
    with service_in_child(lambda _: None, workers=workers, options=options, data=data) as service:
        yield Target(service.endpoint, service.process.pid)


def measure_kinematics(askers: Askers, targets: dict[str, Target], seconds: float, figures: Figures) -> None:
    """Print the times of one client."""
    for name, request in QUESTIONS.items():
        times: dict[str, list[np.ndarray]] = defaultdict(list)
        costs: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(4))
        ask_here = partial(_answer_here, codec.encode(request))
        for _ in range(ROUNDS):
            for label, target in targets.items():
                askers.ask(1, target, target.kinematics, request, count=WARM)
                before = read_costs(target.pid)
                times[label].append(askers.ask(1, target, target.kinematics, request, seconds=seconds / ROUNDS))
                costs[label] += read_costs(target.pid) - before
            until = time.perf_counter() + seconds / ROUNDS
            while time.perf_counter() < until:
                times[IN_PROCESS].append(np.array([time_of(ask_here)]))
        print(f"\n{name + ', one client':32s}{'median':>9s}{'p99':>9s}{'own':>9s}{'workers':>9s} ms{'switches':>15s}")
        for label, rounds in times.items():
            found = np.concatenate(rounds)
            figures[name, label] = float(np.median(found))
            print(f"{label:32s}{_in_ms(np.median(found), np.quantile(found, 0.99))}{_per_query(costs, label, found)}")


def measure_clients(askers: Askers, targets: dict[str, Target], seconds: float, figures: Figures) -> None:
    """Print the answers a second of forward kinematics with some clients."""
    print(f"\n{'clients':32s}{'answers/s':>9s}{'p99':>9s}{'own':>9s}{'workers':>9s} ms{'switches':>15s}")
    for clients in CLIENTS:
        for label in (PLAIN, SERVICE):
            target = targets[label]
            askers.ask(clients, target, target.kinematics, FRAMES, count=WARM)
            before = read_costs(target.pid)
            found = askers.ask(clients, target, target.kinematics, FRAMES, seconds=seconds)
            costs = {label: read_costs(target.pid) - before}
            figures[f"{clients} clients", label] = rate = len(found) / seconds
            row = f"{f'{label}, {clients}':32s}{rate:9.0f}{_in_ms(np.quantile(found, 0.99))}"
            print(row + _per_query(costs, label, found), flush=True)


def measure_plans(askers: Askers, service: Target, plans: int, figures: Figures) -> None:
    """Print what a plan takes over Zenoh beyond the same in process."""
    times: dict[str, list[float]] = defaultdict(list)
    for _ in range(ROUNDS):
        times[SERVICE] += askers.ask(1, service, service.plan, PLAN, count=WARM + plans // ROUNDS)[WARM:].tolist()
        times[IN_PROCESS] += [time_of(lambda: guidefield.answer(PLAN)) for _ in range(WARM + plans // ROUNDS)][WARM:]
    print(f"\n{'a plan, one client':32s}{'median':>9s}{'p99':>9s}{'extra':>9s} ms")
    alone = np.median(times[IN_PROCESS])
    for label, taken in times.items():
        figures["extra", label] = extra = float(np.median(taken) - alone)
        print(f"{label:32s}{_in_ms(np.median(taken), np.quantile(taken, 0.99), extra)}", flush=True)


def print_goals(figures: Figures) -> None:
    """Print the table of goals, of what was measured."""
    print(f"\n{'goals':52s}{'now':>9s}{'goal':>9s}")
    for what, most, ratio in GOALS:
        try:
            now = ratio(figures)
        except (KeyError, ValueError, IndexError):  # not measured in this run
            print(f"{what:52s}{'-':>9s}{most:9g}")
            continue
        print(f"{what:52s}{now:9.2f}{most:9g}   {'met' if now <= most else 'missed'}")


def run(arguments: list[str]) -> None:
    """Measure the parts, and print the table of goals."""
    parser = argparse.ArgumentParser(prog="tools/bench door", description=__doc__.splitlines()[0])
    parser.add_argument("--only", default=",".join(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--seconds", type=float, default=5.0, help="for each target and number of clients")
    parser.add_argument("--plans", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args(arguments)
    parts = options.only.split(",")
    if unknown := set(parts) - set(PARTS):
        parser.error(f"there is no part {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    figures: Figures = {}
    with (
        plain_queryable() as plain,
        default_service(options.workers) as service,
        Askers(max(CLIENTS) if "clients" in parts else 1) as askers,
    ):
        targets = {PLAIN: plain, SERVICE: service}
        if "kinematics" in parts:
            measure_kinematics(askers, targets, options.seconds, figures)
        if "clients" in parts:
            measure_clients(askers, targets, options.seconds, figures)
        if "plans" in parts:
            measure_plans(askers, service, options.plans, figures)
        for error, count in askers.errors.items():
            print(f"{count} errors: {error}")
    print_goals(figures)
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


def time_of(ask: Callable[[], object]) -> float:
    """Return the time that an answer takes [s]."""
    began = time.perf_counter()
    ask()
    return time.perf_counter() - began


def read_costs(pid: int) -> np.ndarray:
    """Return the costs of a process by now.

    They are its processor time and that of all processes below it [s], then the context switches of its threads,
    voluntary or not, and those of the processes below it. What a process cost that has ended is not counted.
    """
    own, below = _cost(pid), sum((_cost(child) for child in _descendants(pid)), np.zeros(2))
    return np.array([own[0], below[0], own[1], below[1]])


def _cost(pid: int) -> np.ndarray:
    switches = 0
    for thread in Path(f"/proc/{pid}/task").glob("*/status"):
        with contextlib.suppress(OSError):  # the thread has ended
            counts = (line.split() for line in thread.read_text().splitlines() if "ctxt_switches" in line)
            switches += sum(int(count) for _, count in counts)
    try:
        return np.array([time.clock_gettime(~pid << 3 | _CLOCK_OF_PROCESS), switches])
    except OSError:  # the process has ended
        return np.array([0.0, switches])


def _descendants(pid: int) -> Iterator[int]:
    for children in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in children.read_text().split():
                yield int(child)
                yield from _descendants(int(child))


def _answer_here(request: bytes) -> bytes:
    return codec.encode(guidefield.answer(request))


def _in_ms(*seconds: float) -> str:
    return "".join(f"{1e3 * value:9.3f}" for value in seconds)


def _per_query(costs: dict[str, np.ndarray], label: str, found: np.ndarray) -> str:
    """Columns of what a query costs a target's process and its children."""
    if label not in costs:
        return ""
    own, workers, own_switches, switches = costs[label] / max(1, len(found))
    return f"{_in_ms(own, workers)}   {own_switches:6.1f} +{switches:5.1f}"
