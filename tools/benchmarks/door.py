"""The cost of the service's door: a plain Zenoh queryable, the service and the same answers in process, in turn.

Usage: tools/bench door [--only PARTS] [--seconds S] [--recorded S] [--plans N] [--kept N,N] [--batch N] [--workers N]

All are asked over loopback, without scouting, by the same clients: processes of their own, with a session each, that
send JSON and throw the answers away. "Plain" is a queryable of forty lines with Pinocchio in its own process. A service
is as it starts by default, on a data folder of its own; others are on folders with kept runs. The parts:

- kinematics: forward kinematics and clearance, one client, each target for S seconds, in rounds. *own* and *workers*
  are the processor time of the target's process and of its children for each query, *switches* their context switches.
- clients: answers a second with 1, 8 and 24 clients.
- plans: a Panda's plan, N times each in rounds, one after the other as in all parts, recordings off; *extra* is the
  median beyond that in process. After a pause of 0.1 s everybody's answer takes longer: a plain one five times.
- page: a page of 100 runs, of as many as are kept.
- recorded: plans a second of two clients for S seconds, recordings off, then as by default.
- batch: `guidefield batch` of N plans without recordings, then the same command again.

Last comes the table of goals. On a machine with other work only ratios within a run count.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.metadata import distribution
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np

import guidefield
from benchmarks.doors.costs import read_costs
from benchmarks.doors.kept_runs import PLAN, WARM, fill, time_of
from guidefield import Client, JointsGoal
from guidefield.cli.serving import LOOPBACK, free_port, service_in_child
from guidefield.messages import codec

PARTS = ("kinematics", "clients", "plans", "page", "recorded", "batch")
CLIENTS = (1, 8, 24)
ROUNDS = 5
"""Rounds in which all targets are asked in turn."""
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
RECORDED = msgspec.structs.replace(PLAN, recording="full")
PLAIN, SERVICE, IN_PROCESS = "plain", "service", "in process"
BATCH_TURNS = 40
"""Configurations of the first joint that the plans of a batch go to, one after the other."""
_MEASURED = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss)
"""
"""Runs a command; prints its processor time [s] and the memory of the largest of its processes [KiB]."""
Figures = dict[tuple[str, str], float]
"""What was measured: the quantity and the target."""
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
    (
        "the same with kept runs / with none",
        1.1,
        lambda f: max(f["extra", name] for _, name in f if name.startswith("kept")) / f["extra", SERVICE],
    ),
    (
        "a page of 100 runs of the most that are kept, ms",
        10.0,
        lambda f: 1e3 * [value for (what, _), value in f.items() if what == "page"][-1],
    ),
    (
        "plans a second without / with recordings, two clients",
        1.25,
        lambda f: f["plans", "without recordings"] / f["plans", "with recordings"],
    ),
    (
        "a finished batch asked again / answering it",
        0.1,
        lambda f: f["batch", "again"] / f["batch", "answered"],
    ),
)
"""The goals: what, the most that it may be, and how it is made of the figures."""


@dataclass(frozen=True)
class Target:
    """What is asked: where it listens, its process, and its keys of kinematics and plans."""

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
            assert process.stdin is not None
            process.stdin.write(json.dumps(order) + "\n")
            process.stdin.flush()
        times: list[float] = []
        for process in self._processes[:clients]:
            assert process.stdout is not None
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
                assert process.stdout is not None
                assert process.stdout.readline() == "ready\n", "it tells when it takes queries"
                yield Target(endpoint, process.pid, kinematics="plain")
            finally:
                process.kill()


@contextlib.contextmanager
def default_service(kept: int, workers: int) -> Iterator[Target]:
    """A service with so many kept runs in a data folder of its own, for as long as the block runs."""
    with tempfile.TemporaryDirectory(prefix="guidefield-") as data:
        if kept:
            fill(kept, Path(data))
        keep = ("--keep-runs", str(kept + 10_000)) if kept else ()
        with service_in_child(lambda _: None, workers=workers, options=keep, data=Path(data)) as service:
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


def measure_plans(askers: Askers, targets: dict[str, Target], plans: int, figures: Figures) -> None:
    """Print what a plan takes over Zenoh beyond the same in process."""
    services = {label: target for label, target in targets.items() if label != PLAIN}
    times: dict[str, list[float]] = defaultdict(list)
    for _ in range(ROUNDS):
        for label, target in services.items():
            found = askers.ask(1, target, target.plan, PLAN, count=WARM + plans // ROUNDS)
            times[label] += found[WARM:].tolist()
        here = [time_of(lambda: guidefield.answer(PLAN)) for _ in range(WARM + plans // ROUNDS)]
        times[IN_PROCESS] += here[WARM:]
    print(f"\n{'a plan, one client':32s}{'median':>9s}{'p99':>9s}{'extra':>9s} ms")
    alone = np.median(times[IN_PROCESS])
    for label, taken in times.items():
        figures["extra", label] = extra = float(np.median(taken) - alone)
        print(f"{label:32s}{_in_ms(np.median(taken), np.quantile(taken, 0.99), extra)}", flush=True)


def measure_pages(targets: dict[str, Target], kept: list[int], figures: Figures) -> None:
    """Print what a page of 100 runs takes."""
    print(f"\n{'a page of 100 runs':32s}{'median':>9s}{'best':>9s} ms")
    for count in kept:
        with Client.connect(targets[_kept(count)].endpoint, wait=60.0) as client:
            taken = [time_of(lambda: client.runs(limit=100)) for _ in range(30)]
        figures["page", _kept(count)] = float(np.median(taken))
        print(f"{_kept(count):32s}{_in_ms(np.median(taken), min(taken))}", flush=True)


def measure_recorded(askers: Askers, target: Target, seconds: float, figures: Figures) -> None:
    """Print the plans a second of two clients, recordings off and then as by default."""
    print(f"\n{'plans of two clients':32s}{'plans/s':>9s}{'median':>9s}{'p99':>9s}{'longest':>9s} ms")
    for label, request in (("without recordings", PLAN), ("with recordings", RECORDED)):
        askers.ask(2, target, target.plan, request, count=WARM)
        found = askers.ask(2, target, target.plan, request, seconds=seconds)
        figures["plans", label] = rate = len(found) / seconds
        print(f"{label:32s}{rate:9.1f}{_in_ms(np.median(found), np.quantile(found, 0.99), max(found))}", flush=True)


def measure_batch(plans: int, workers: int, figures: Figures) -> None:
    """Print what a batch takes, and what the same command takes again once it is finished."""
    print(f"\n{f'a batch of {plans} plans':32s}{'seconds':>9s}{'of CPU':>9s} s{'memory':>9s} MB")
    with tempfile.TemporaryDirectory(prefix="guidefield-") as folder:
        requests = Path(folder) / "requests.jsonl"
        turned = (0.1 + 0.01 * (number % BATCH_TURNS) for number in range(plans))
        goals = (msgspec.structs.replace(PLAN, goal=JointsGoal({"panda_joint1": turn})) for turn in turned)
        requests.write_bytes(b"\n".join(map(codec.encode, goals)))
        command = [sys.executable, "-m", "guidefield", "batch", str(requests), "-o", f"{folder}/results"]
        command += ["--workers", str(workers), "--no-recordings"]
        for label in ("answered", "again"):
            began = time.perf_counter()
            measured = subprocess.run([sys.executable, "-c", _MEASURED, *command], capture_output=True, check=True)
            figures["batch", label] = elapsed = time.perf_counter() - began
            work, memory = map(float, measured.stdout.split())
            print(f"{label:32s}{elapsed:9.2f}{work:9.2f}  {memory / 1024:9.0f}", flush=True)


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
    parser.add_argument("--recorded", type=float, default=60.0, help="seconds of plans, without and with recordings")
    parser.add_argument("--plans", type=int, default=100)
    parser.add_argument("--kept", default="1000", help="kept runs of more services, such as 1000,100000; none: ''")
    parser.add_argument("--batch", type=int, default=2000, help="plans of the batch")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args(arguments)
    parts, kept = options.only.split(","), [int(count) for count in options.kept.split(",") if count]
    if unknown := set(parts) - set(PARTS):
        parser.error(f"there is no part {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    figures: Figures = {}
    if set(parts) - {"batch"}:
        with contextlib.ExitStack() as opened:
            targets = {
                PLAIN: opened.enter_context(plain_queryable()),
                SERVICE: opened.enter_context(default_service(0, options.workers)),
                **{_kept(count): opened.enter_context(default_service(count, options.workers)) for count in kept},
            }
            askers = opened.enter_context(Askers(max(CLIENTS) if "clients" in parts else 2))
            if "kinematics" in parts:
                measure_kinematics(askers, targets, options.seconds, figures)
            if "clients" in parts:
                measure_clients(askers, targets, options.seconds, figures)
            if "plans" in parts:
                measure_plans(askers, targets, options.plans, figures)
            if "page" in parts:
                measure_pages(targets, kept, figures)
            if "recorded" in parts:
                measure_recorded(askers, targets[SERVICE], options.recorded, figures)
            for error, count in askers.errors.items():
                print(f"{count} errors: {error}")
    if "batch" in parts:
        measure_batch(options.batch, options.workers, figures)
    print_goals(figures)
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


def _answer_here(request: bytes) -> bytes:
    return codec.encode(guidefield.answer(request))


def _kept(count: int) -> str:
    return f"kept {count}"


def _in_ms(*seconds: float) -> str:
    return "".join(f"{1e3 * value:9.3f}" for value in seconds)


def _per_query(costs: dict[str, np.ndarray], label: str, found: np.ndarray) -> str:
    """Columns of what a query costs a target's process and its children."""
    if label not in costs:
        return ""
    own, workers, own_switches, switches = costs[label] / max(1, len(found))
    return f"{_in_ms(own, workers)}   {own_switches:6.1f} +{switches:5.1f}"
