"""How long it takes until anything is planned: kernels compiled from nothing, and from import to a first plan.

Usage: tools/bench start [--robot NAME] [--warm-only]

Each row is a process of its own, in a cache folder of its own, one after the other: with nothing in it (which compiles
what the first plan needs), again with all that is known of the robot, then every kernel of the project as the first
start compiles them, in several processes, and last in one: those of lanes, which connections need, and all others. The
plan takes a robot of the catalog in a packaged scene from its rest to a free configuration on the lane kernels. CPU
time and time on the clock; the latter means something on an idle machine only. With --warm-only the user's own cache is
used.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile

GOAL_KERNELS, GOAL_LANES, GOAL_WARM = 90.0, 30.0, 2.0
"""All kernels from an empty cache, those of lanes, and from import to the first plan with full ones [s]."""

_FIRST_PLAN = """
import json, sys, time
began = time.perf_counter()
import numpy as np
import pinocchio as pin
from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.world import World
from guidefield.planner.connect import tree_search
from guidefield.deadline import Deadline
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.group.reduced_model import select
from guidefield.scene import library
from guidefield.scene.scene import build
imported = time.process_time()
robot = Catalog().load(sys.argv[1])
group = select(robot, None, None, robot.rest, pin.SE3.Identity())
loaded = time.process_time()
lanes = BatchCollision.build(World.build(group, build(library.read("bookshelf"))))
tables = time.process_time()
rng = np.random.default_rng(0)
drawn = np.array([group.chart(group.random(rng)) for _ in range(200)])
goal = drawn[~lanes.touching(drawn)][0]
start = group.chart(group.part_of(robot.rest))
found = tree_search.grow(lanes, start[None], goal[None], 32.0, 0.0, rng, Deadline())
planned = time.process_time()
steps = {"import": imported, "robot": loaded - imported, "tables": tables - loaded, "plan": planned - tables}
print(json.dumps(steps | {"all": planned, "clock": time.perf_counter() - began, "found": found.path is not None}))
"""

_FIRST_START = """
import json, resource, time
from guidefield.first_start import compile_kernels
began = time.perf_counter()
told = []
compile_kernels(told.append)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
told = {"all": used.ru_utime + used.ru_stime, "clock": time.perf_counter() - began, "lines of progress": len(told)}
print(json.dumps(told))
"""

_KERNELS = """
import importlib, json, pathlib, sys, time
began, times = time.perf_counter(), {}
import guidefield.kernels as room
for source in sorted(pathlib.Path(room.__file__).parent.glob(sys.argv[1])):
    before = time.process_time()
    importlib.import_module(f"guidefield.kernels.{source.stem}")
    times[source.stem] = time.process_time() - before
longest = sorted(times, key=times.get)[:-7:-1]
told = {name: times[name] for name in longest}
print(json.dumps({"all": time.process_time(), "clock": time.perf_counter() - began} | told))
"""


def run(arguments: list[str]) -> None:
    """Print a row for each process."""
    parser = argparse.ArgumentParser(prog="tools/bench start", description=__doc__.partition("\n")[0])
    parser.add_argument("--robot", default="panda", help="of the catalog")
    parser.add_argument("--warm-only", action="store_true", help="only the first plan, with the user's own caches")
    options = parser.parse_args(arguments)
    if options.warm_only:
        _row("known robot, compiled", _FIRST_PLAN, options.robot)
        print(f"goal: {GOAL_WARM:g} s")
        return
    with tempfile.TemporaryDirectory() as folder:
        _row("first plan, nothing known", _FIRST_PLAN, options.robot, folder)
        _row("known robot, compiled", _FIRST_PLAN, options.robot, folder)
    with tempfile.TemporaryDirectory() as folder:
        _row("all kernels, as the first start compiles them", _FIRST_START, "", folder)
    with tempfile.TemporaryDirectory() as folder:
        _row("kernels of lanes in one process, the longest", _KERNELS, "lane*.py", folder)
        _row("all others", _KERNELS, "*.py", folder)
        _row("all kernels, compiled", _KERNELS, "*.py", folder)
    goals = f"{GOAL_KERNELS:g} s for all kernels, {GOAL_LANES:g} s for those of lanes"
    print(f"goals: {goals}, {GOAL_WARM:g} s to a first plan when all is known")


def _row(title: str, script: str, argument: str, folder: str | None = None) -> None:
    """Run a script in a process, with its caches in a folder, and print what it tells [s]."""
    own = {} if folder is None else {"XDG_CACHE_HOME": folder, "NUMBA_CACHE_DIR": ""}
    ended = subprocess.run(
        [sys.executable, "-c", script, argument], env=os.environ | own, capture_output=True, text=True, check=False
    )
    if ended.returncode != 0:
        print(f"{title}: {ended.stderr.strip().splitlines()[-1]}")
        return
    told = json.loads(ended.stdout.splitlines()[-1])
    print(
        f"{title}: "
        + ", ".join(f"{name} {value if value is True else round(value, 2)}" for name, value in told.items())
    )
