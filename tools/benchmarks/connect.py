"""Connecting two configurations: success, planning time, the whole call, and paths that the exact meshes refuse.

Usage: tools/bench connect --problems <folder> [--every N] [--sequences N] [--peers SECONDS] [<robot> ...]

The folder is described in problems.py. *Whole call* is scene, planning and simplification, every obstacle new to the
process; *scene known* is the scene alone with obstacles that an earlier one had. The certified path is judged once more
on the exact meshes, `JUDGED_STEP` apart. Certificates come when all problems of a sequence have been planned, as the
others' times are of planning alone: *after a certificate* is what planning takes where one has just emptied the
processor's caches, once and not the best. Beside our times stand those of VAMP's rows on the same problems, scaled by
Pinocchio's forward kinematics (connect_peers.py), and with `--peers` the planners of peers.py that are installed.
All is CPU time, the best of `REPEATS`.
"""

from __future__ import annotations

import argparse
import itertools
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from benchmarks.connect_peers import beside, beside_vamp, kinematics_us, print_times
from benchmarks.problems import ROBOTS, Problems, scene_message
from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.kernels.collide.batch_collision import EXACT
from guidefield.messages.scene import Scene
from guidefield.planner.connect import tree_search
from guidefield.planner.connect.connect import ATTEMPTS, FINER
from guidefield.planner.connect.tree_search import RESOLUTION
from guidefield.planner.motion.waypoints import polyline
from guidefield.prove.certificate import certify
from guidefield.robot.model.model import MARGIN
from guidefield.scene.scene import build

REPEATS = 3
SECONDS = 20.0
"""Budget of one problem."""

LONG = 0.1
"""A call that takes longer is not repeated [s]."""

JUDGED_STEP = 0.01
"""Distance between two configurations of a path that are judged on the exact meshes, as in the peers' rows."""

PASSES = 20
"""How often a free path is looked at again to tell configurations per second."""


@dataclass(frozen=True)
class Row:
    """One problem: CPU time [us], samples drawn, length of the simplified path, what certificate and meshes said.

    Attributes:
        problem_set, index: Which one.
        scene: World and tables built, every obstacle new.
        known: The same with known obstacles.
        plan, simplify, call: Tree, shortcuts, and those with the new scene.
        after: Tree, once, where a certificate came before.
        certificate: The certificate, with new plans where it refused.
        iterations: Samples drawn.
        length: Of the simplified path in the chart.
        rate: Configurations per second inside the path's motions, the setting up of each included [1/s].
        refused: Paths that the certificate refused.
        solved: Whether one was certified.
        hits: Whether that one touches on the exact meshes.
    """

    problem_set: str
    index: int
    scene: float
    known: float
    plan: float
    simplify: float
    call: float
    after: float
    certificate: float
    iterations: int
    length: float
    rate: float
    refused: int
    solved: bool
    hits: bool


def run(arguments: list[str]) -> None:
    """Print a table for each robot."""
    parser = argparse.ArgumentParser(prog="tools/bench connect", description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--problems", type=Path, required=True, help="the folder that `guidefield docs benchmarks` describes"
    )
    parser.add_argument("--every", type=int, default=1, help="take every n-th problem only")
    parser.add_argument("--sequences", type=int, default=1, help="sequences of samples to judge by")
    parser.add_argument("robots", nargs="*", default=list(ROBOTS))
    parser.add_argument("--peers", type=float, default=0.0, metavar="SECONDS", help="plan with other planners too")
    options = parser.parse_args(arguments)
    for robot in options.robots:
        _robot(options.problems, robot, options.every, options.sequences, options.peers)


def _robot(folder: Path, robot: str, every: int, sequences: int, seconds: float) -> None:
    given = Problems.load(folder, robot, every)
    kinematics = kinematics_us(Problems.load(folder, "panda", len(given.problems)).group)
    print(f"\n{robot}: {len(given.problems)} problems; Pinocchio's forward kinematics of a Panda: {kinematics:.2f} us")
    first = given.problems[0]
    _judged(given, first, _planned(given, first, 0), 0)  # compiles, and makes the robot's tables
    of_sequence = []
    for sequence in range(sequences):
        planned = [_planned(given, problem, sequence) for problem in given.problems]
        of_sequence.append([_judged(given, *one, sequence) for one in zip(given.problems, planned, strict=True)])
    for sequence, rows in enumerate(of_sequence):
        _print(f"sequence {sequence}", rows)
    keys = [(row.problem_set, row.index) for row in of_sequence[0]]
    plans = np.median([[row.plan for row in rows] for rows in of_sequence], axis=0)
    calls = np.median([[row.call for row in rows] for rows in of_sequence], axis=0)
    beside_vamp(given, dict(zip(keys, np.column_stack([plans, calls]).tolist(), strict=True)), kinematics)
    if seconds > 0.0:
        beside(given, seconds, dict(zip(keys, calls.tolist(), strict=True)))


@dataclass(frozen=True)
class _Planned:
    """What planning a problem took, as `Row` says, and the simplified path."""

    times: dict[str, float]
    path: np.ndarray | None
    iterations: int
    rng: np.random.Generator


def _planned(given: Problems, problem: dict[str, Any], sequence: int) -> _Planned:
    z_start, z_goal = given.ends(problem)
    message = scene_message(problem)
    scene = known = plan = simplify = call = np.inf
    for repeat in range(REPEATS):
        message = _renamed(message, f"{sequence} {repeat}")
        rng = np.random.default_rng(sequence)
        began = time.thread_time()
        world = World.build(given.group, build(message))
        lanes = BatchCollision.build(world)
        ready = time.thread_time()
        found = _grown(lanes, z_start, z_goal, RESOLUTION, rng)
        grown = time.thread_time()
        path = None if found.path is None else lanes.shorten(found.path, RESOLUTION, MARGIN)
        done = time.thread_time()
        scene, plan, simplify = min(scene, ready - began), min(plan, grown - ready), min(simplify, done - grown)
        call = min(call, done - began)
        began = time.thread_time()
        world = World.build(given.group, build(message))
        lanes = BatchCollision.build(world)
        known = min(known, time.thread_time() - began)
        if call > LONG:
            break
    times = {"scene": scene, "known": known, "plan": plan, "simplify": simplify, "call": call}
    return _Planned(times, path, found.iterations, rng)


def _judged(given: Problems, problem: dict[str, Any], planned: _Planned, sequence: int) -> Row:
    z_start, z_goal = given.ends(problem)
    world = World.build(given.group, build(scene_message(problem)))
    lanes, path, rng = BatchCollision.build(world), planned.path, planned.rng
    began = time.thread_time()
    _grown(lanes, z_start, z_goal, RESOLUTION, np.random.default_rng(sequence))
    after = time.thread_time() - began
    began, refused, resolution = time.thread_time(), 0, RESOLUTION
    while path is not None and not certify(world, polyline(path)).free:
        refused += 1
        if refused == ATTEMPTS:
            path = None
            break
        resolution *= FINER
        again = _grown(lanes, z_start, z_goal, resolution, rng)
        path = None if again.path is None else lanes.shorten(again.path, resolution, MARGIN)
    certificate = time.thread_time() - began
    return Row(
        problem_set=problem["set"],
        index=problem["index"],
        **{name: 1e6 * seconds for name, seconds in planned.times.items()},
        after=1e6 * after,
        certificate=1e6 * certificate,
        iterations=planned.iterations,
        length=np.nan if path is None else float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()),
        rate=np.nan if path is None else _rate(lanes, path),
        refused=refused,
        solved=path is not None,
        hits=path is not None and _hits(world, path),
    )


def _renamed(message: Scene, mark: str) -> Scene:
    """The same scene of obstacles that nobody has seen."""
    renamed = [msgspec.structs.replace(one, name=f"{index} {mark}") for index, one in enumerate(message.obstacles)]
    return msgspec.structs.replace(message, obstacles=renamed)


def _grown(
    lanes: BatchCollision, z_start: np.ndarray, z_goal: np.ndarray, resolution: float, rng: np.random.Generator
) -> tree_search.FoundPath:
    deadline = Deadline(time.monotonic() + SECONDS)
    return tree_search.grow(lanes, z_start[None], z_goal[None], resolution, 0.0, rng, deadline)


def _rate(lanes: BatchCollision, path: np.ndarray) -> float:
    """Configurations that are judged per second in a path's motions, all free [1/s]."""
    if lanes.free_until(path, RESOLUTION) < len(path) - 1:
        return np.nan
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    count = 16.0 * np.maximum(1.0, np.ceil(lengths * RESOLUTION / 16.0 - EXACT)).sum()
    shortest = np.inf
    for _ in range(REPEATS):
        began = time.thread_time()
        for _ in range(PASSES):
            lanes.free_until(path, RESOLUTION)
        shortest = min(shortest, time.thread_time() - began)
    return float(PASSES * count / shortest)


def _hits(world: World, path: np.ndarray) -> bool:
    """Whether a path touches anything on the exact meshes."""
    for a, b in itertools.pairwise(path):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / JUDGED_STEP)))
        for share in np.arange(1, count + 1) / count:
            if world.in_collision(world.group.expand_from_chart(a + share * (b - a))):
                return True
    return False


def _print(title: str, rows: list[Row]) -> None:
    solved = [row for row in rows if row.solved]
    refused = sum(row.refused > 0 for row in rows)
    unsolved = ", ".join(f"{row.problem_set} {row.index}" for row in rows if not row.solved)
    print(f" {title}: certified {len(solved)} of {len(rows)}; first path refused by the certificate: {refused};")
    print(f"  certified paths in collision with the exact meshes: {sum(row.hits for row in rows)}")
    if unsolved:
        print(f"  not solved: {unsolved}")
    for name, field in (
        ("scene, new, us", "scene"),
        ("scene known, us", "known"),
        ("planning, us", "plan"),
        ("planning after a certificate, once, us", "after"),
        ("simplification, us", "simplify"),
        ("whole call, us", "call"),
        ("certificate, with new plans where it refused, us", "certificate"),
        ("configurations per second inside a free motion", "rate"),
        ("length", "length"),
    ):
        print_times(f"  {name}", np.array([getattr(row, field) for row in rows]))
    for name in dict.fromkeys(row.problem_set for row in rows):
        print_times(f"    {name}, planning", np.array([row.plan for row in rows if row.problem_set == name]))
