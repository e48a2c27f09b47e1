"""Growth of costs with everything that a user can have many of: at n, 4 n and 16 n.

Usage: tools/bench growth [SUBJECT ..] [--sizes 10,100,1000] [--small]

Subjects: boxes, polygons, triangles, points, movers, crossed (boxes at rest, with one that comes across the way),
configurations, waypoints, goals, steps, links (of the thesis' chains), joints, held (objects), results (of a batch),
cycles (of a stream, 50 a second), clients, scenes and robots (stored), runs (kept). Boxes are small, all but ten of
them more than a metre away from where the robot is; movers are the same boxes, each of which slides to and fro.

The first ones are measured in a process of their own for each size: *first* is the processor time of the first answer
or of writing, *then* of the next one or of reading again (of a stream four times that of its last quarter), *memory*
what the process grew at most. Of a service *first* is the processor time of its process and its workers for storing
all, or for 50 answers to each client; *then* for a list of all, or for as many answers again; *memory* is what its
process has in the end, when the clients have gone. Of kept runs *first* is the processor time of the service, without
its worker, for a plan, and *then* the time of the slowest of three pages of 100 runs: the newest, some from the middle,
and those that failed, one in ten.

The exponent is that of the power of the size that the growth of the time follows over the last three sizes: 1 is
linear, and 0 is written where hardly anything grows. Worse than linear is marked, beyond what caches and a busy machine
do, and so is memory that grows where nothing is kept. Links grow by 2 n and 4 n. With --small sizes are a quarter.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.door import FRAMES, PLAN, WARM, Askers, Target, default_service, read_costs, time_of
from guidefield import Box, Client, Scene, answer
from guidefield.kernels.jit.cache import cache_folder
from guidefield.messages import codec
from guidefield.messages.identities import PLAIN
from guidefield.stores.run_rows import NewRun
from guidefield.stores.runs import Retention, RunDatabase
from guidefield.system import resident

TOOLS = Path(__file__).resolve().parents[1]
SIZES: dict[str, int] = {
    "boxes": 500,
    "polygons": 256,
    "triangles": 5_000,
    "points": 5_000,
    "movers": 16,
    "crossed": 625,
    "configurations": 500,
    "waypoints": 200,
    "goals": 256,
    "steps": 8,
    "links": 12,
    "joints": 6,
    "held": 4,
    "results": 6_250,
    "cycles": 750,
    "clients": 4,
    "scenes": 40,
    "robots": 12,
    "runs": 1_000,
}
"""n of each subject."""
RATIOS = {"links": 2}
"""Factors from one size to the next, where they aren't 4."""
FLAT = ("results", "cycles")
"""Subjects whose memory mustn't grow: nothing is kept of them in memory."""
WORSE, GROWS = 1.25, 1.1
"""Exponents from which on time is marked, and ratios of memory at 16 n to that at n."""
NOISE, LEAST = 1.3, 10e-3
"""Ratio of the time at 16 n to that at n, and their difference [s], below which hardly anything grows."""
SMALLEST = 16.0
"""Memory below this is that of allocators [MB]."""
REPEATS = 30
"""Plans and pages of kept runs."""
ANSWERS = 50
"""Answers to each client."""

Row = tuple[float, float, float]
"""Processor times [s] and memory [MB]."""


def measure_in_process(subject: str, size: int) -> Row:
    """Measure a size in a process of its own, which finds no geometry on disk."""
    with tempfile.TemporaryDirectory(prefix="guidefield-") as cache:
        alone = {"XDG_CACHE_HOME": cache, "NUMBA_CACHE_DIR": str(cache_folder().parents[1])}
        alone["PYTHONPATH"] = f"{TOOLS}{os.pathsep}{TOOLS.parent}"
        command = [sys.executable, "-m", "benchmarks.growth_process", subject, str(size)]
        done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, **alone}, check=False)
    if done.returncode:
        raise RuntimeError(f"{subject} {size}: {done.stderr[-2000:]}")
    found = json.loads(done.stdout.splitlines()[-1])
    return found["first"], found["then"], found["memory"]


def measure_clients(size: int) -> Row:
    """Measure so many clients that ask as fast as they can."""
    with default_service(2) as service:
        with Askers(size) as askers:
            askers.ask(size, service, service.kinematics, FRAMES, count=WARM)
            first, then = (
                _processor_time(service, lambda: askers.ask(size, service, service.kinematics, FRAMES, count=ANSWERS))
                for _ in range(2)
            )
            for error, count in askers.errors.items():
                print(f"{count} errors with {size} clients: {error}")
        return first, then, _memory(service)


def measure_scenes(size: int) -> Row:
    """Measure storing so many scenes, and a list of them."""
    with _client() as (service, client):
        scenes = [Scene(f"s{k}", obstacles=[Box(name="b", size=(0.1, 0.1, 0.1))]) for k in range(size)]
        first = _processor_time(service, lambda: [client.store_scene(scene) for scene in scenes])
        return first, _processor_time(service, client.scenes), _memory(service)


def measure_robots(size: int) -> Row:
    """Measure storing so many robots, and a list of them."""
    with _client() as (service, client):
        urdf = "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='continuous'><parent link='a'/>"
        urdf += "<child link='b'/><axis xyz='0 0 1'/></joint></robot>"
        first = _processor_time(service, lambda: [client.store_robot(f"r{k}", urdf) for k in range(size)])
        return first, _processor_time(service, client.robots), _memory(service)


def measure_runs(size: int) -> Row:
    """Measure a service with so many kept runs, one in ten of which failed."""
    with tempfile.TemporaryDirectory(prefix="guidefield-") as data:
        _keep_runs(size, Path(data))
        keep = ("--keep-runs", str(size + 1000))
        with default_service(2, Path(data), keep) as service, Client.connect(service.endpoint, wait=60.0) as client:
            pages = (
                partial(client.runs, limit=100),
                partial(client.runs, limit=100, after=str(size // 2 + 1)),
                partial(client.runs, limit=100, status="PLANNING_FAILED"),
            )
            costs = []
            for _ in range(WARM + REPEATS):
                before = read_costs(service.pid)[0]
                client.plan(PLAN)
                costs.append(read_costs(service.pid)[0] - before)
            slowest = max(min(time_of(page) for _ in range(REPEATS)) for page in pages)
            return float(np.median(costs[WARM:])), slowest, _memory(service)


def _keep_runs(count: int, data: Path) -> None:
    reply = answer(PLAN)
    # lists don't depend on rows of the reply, and 100,000 whole ones take 5 GB
    reply = msgspec.structs.replace(reply, path=reply.path[:20], trajectory=None)
    status = msgspec.structs.replace(reply.status, code=-1, name="PLANNING_FAILED")
    failed = codec.encode(msgspec.structs.replace(reply, status=status))
    replies, database = [*[codec.encode(reply)] * 9, failed], RunDatabase(data, Retention(runs=count + 1))
    runs = database.of(PLAIN)
    for number in range(count):
        runs.finish(NewRun(PLAIN, f"kept{number}", "plan", codec.encode(PLAN)), replies[number % 10])
    database.close()


SERVED: dict[str, Callable[[int], Row]] = {
    "clients": measure_clients,
    "scenes": measure_scenes,
    "robots": measure_robots,
    "runs": measure_runs,
}


def exponent(sizes: Sequence[int], times: Sequence[float]) -> float:
    """Return the power of the size that the growth over the last three sizes follows; 0 if nothing grows."""
    small, middle, large = times[-3:]
    if large < max(NOISE * small, small + LEAST):
        return 0.0
    return math.log(max(1.0, (large - middle) / max(middle - small, 1e-9))) / math.log(sizes[-1] / sizes[-2])


def print_growth(subject: str, sizes: Sequence[int], rows: Sequence[Row]) -> None:
    """Print a line for each size, and what is worse than linear."""
    print(f"\n{subject:>14s}{'first, ms':>12s}{'then, ms':>12s}{'memory, MB':>12s}")
    for size, (first, then, memory) in zip(sizes, rows, strict=True):
        print(f"{size:14d}{1e3 * first:12.1f}{1e3 * then:12.1f}{memory:12.1f}")
    if len(sizes) < 3:
        return
    first, then, memories = zip(*rows, strict=True)
    powers = exponent(sizes, first), exponent(sizes, then)
    marks = [f"{name} worse than linear" for name, p in zip(("first", "then"), powers, strict=True) if p > WORSE]
    if subject in FLAT and memories[-1] > max(SMALLEST, GROWS * memories[0]):
        marks.append("memory grows")
    print(f"{'exponent':>14s}{powers[0]:12.2f}{powers[1]:12.2f}   {', '.join(marks) or 'fine'}", flush=True)


def run(arguments: list[str]) -> None:
    """Measure the subjects."""
    parser = argparse.ArgumentParser(prog="tools/bench growth", description=__doc__.splitlines()[0])
    parser.add_argument("subjects", nargs="*", help=f"of {', '.join(SIZES)}")
    parser.add_argument("--sizes", type=_sizes, help="other ones, such as 10,100,1000")
    parser.add_argument("--small", action="store_true", help="a quarter of each size")
    options = parser.parse_args(arguments)
    subjects = options.subjects or [*SIZES]
    if unknown := set(subjects) - set(SIZES):
        parser.error(f"there is no subject {', '.join(sorted(unknown))}; there are {', '.join(SIZES)}")
    for subject in subjects:
        ratio = RATIOS.get(subject, 4)
        n = max(1, SIZES[subject] // ratio) if options.small else SIZES[subject]
        sizes = options.sizes or [n, ratio * n, ratio**2 * n]
        measure = SERVED.get(subject, partial(measure_in_process, subject))
        rows = [measure(size) for size in sizes]
        print_growth(subject, sizes, rows)
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


def _sizes(text: str) -> list[int]:
    """Numbers between commas."""
    return [int(size) for size in text.split(",")]


@contextlib.contextmanager
def _client() -> Iterator[tuple[Target, Client]]:
    with default_service(1) as service, Client.connect(service.endpoint, wait=60.0) as client:
        client.robot("panda")
        client.robots()
        yield service, client


def _processor_time(service: Target, work: Callable[[], object]) -> float:
    """Measure the processor time of a service while something is done [s]."""
    before = read_costs(service.pid)
    work()
    return float((read_costs(service.pid) - before)[:2].sum())


def _memory(service: Target) -> float:
    """Resident memory of a service's own process [MB]."""
    return resident(service.pid) / 1e6
