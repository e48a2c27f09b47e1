"""Connecting two configurations: success, planning time, the whole call, and paths that the exact meshes refuse.

Usage: tools/bench connect <folder> [--robots panda,ur5,fetch,baxter] [--every N] [--sequences N]

The folder is described in problems.py. *Whole call* is scene, planning and simplification, every obstacle new to the
process. Certificates come when all problems of a sequence have been planned, as the others' times are of planning
alone; the certified path is judged once more on the exact meshes, `JUDGED_STEP` apart. Beside our times stand those of
VAMP's rows on the same problems, scaled by Pinocchio's forward kinematics. All is CPU time, the best of `REPEATS`.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin

from benchmarks.problems import Problems, print_times, problems_parser, scene_message
from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.messages.scene import Scene
from guidefield.planner import tree_search
from guidefield.planner.connect import ATTEMPTS, FINER
from guidefield.planner.tree_search import RESOLUTION
from guidefield.prove.certificate import certify
from guidefield.prove.curve import polyline
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.model import MARGIN
from guidefield.scene.scene import build

REPEATS = 3
SECONDS = 20.0
"""Budget of one problem."""

LONG = 0.1
"""A call that takes longer is not repeated [s]."""

JUDGED_STEP = 0.01
"""Distance between two configurations of a path that are judged on the exact meshes, as in the peers' rows."""

PEERS_KINEMATICS = 0.30
"""Time of one forward kinematics of a Panda where VAMP's rows were measured [us]."""


@dataclass
class Row:
    """One problem.

    Attributes:
        problem: As it is declared.
        rng: The generator of samples, as planning left it.
        path: The simplified path; None if there is none.
        scene, plan, simplify, call: CPU times of world and tables, tree, shortcuts, and all of these [us].
        certificate: CPU time of the certificate, with new plans after it refused [us].
        refused: Number of paths that the certificate refused.
        hits: Whether the certified path touches on the exact meshes.
    """

    problem: dict[str, Any]
    rng: np.random.Generator
    path: np.ndarray | None = None
    scene: float = np.inf
    plan: float = np.inf
    simplify: float = np.inf
    call: float = np.inf
    certificate: float = np.inf
    refused: int = 0
    hits: bool = False

    @property
    def name(self) -> tuple[str, int]:
        """Set and index of the problem."""
        return self.problem["set"], self.problem["index"]

    @property
    def length(self) -> float:
        """Length of the path in local coordinates."""
        return np.nan if self.path is None else float(np.linalg.norm(np.diff(self.path, axis=0), axis=1).sum())


def run(arguments: list[str]) -> None:
    """Print a table for each robot."""
    parser = problems_parser("connect", __doc__)
    parser.add_argument("--sequences", type=int, default=1, help="sequences of samples to judge by")
    options = parser.parse_args(arguments)
    for robot in options.robots.split(","):
        given = Problems.load(options.folder, robot, options.every)
        kinematics = _kinematics_us(Problems.load(options.folder, "panda", len(given.problems)).group)
        print(
            f"\n{robot}: {len(given.problems)} problems; Pinocchio's forward kinematics of a Panda: {kinematics:.2f} us"
        )
        _certify(given, _plan(given, given.problems[0], 0))  # compiles, and makes the robot's tables
        sequences = []
        for sequence in range(options.sequences):
            rows = [_plan(given, problem, sequence) for problem in given.problems]
            for row in rows:
                _certify(given, row)
            _print(f"sequence {sequence}", rows)
            sequences.append(rows)
        _print_beside_vamp(given, sequences, kinematics / PEERS_KINEMATICS)


def _plan(given: Problems, problem: dict[str, Any], sequence: int) -> Row:
    start, goal = given.ends(problem)
    row = Row(problem, np.random.default_rng(sequence))
    for repeat in range(REPEATS):
        message = _renamed(scene_message(problem), f"{sequence} {repeat}")
        row.rng = np.random.default_rng(sequence)
        began = time.thread_time()
        batch = BatchCollision.build(World.build(given.group, build(message)))
        ready = time.thread_time()
        found = _grow(batch, start, goal, RESOLUTION, row.rng)
        grown = time.thread_time()
        row.path = None if found is None else batch.shorten(found, RESOLUTION, MARGIN)
        done = time.thread_time()
        times = {"scene": ready - began, "plan": grown - ready, "simplify": done - grown, "call": done - began}
        for name, seconds in times.items():
            setattr(row, name, min(getattr(row, name), 1e6 * seconds))
        if row.call > 1e6 * LONG:
            break
    return row


def _certify(given: Problems, row: Row) -> None:
    """Certify a row's path, planning again more finely after each refusal, and judge it on the exact meshes."""
    start, goal = given.ends(row.problem)
    world = World.build(given.group, build(scene_message(row.problem)))
    batch, resolution = BatchCollision.build(world), RESOLUTION
    began = time.thread_time()
    while row.path is not None and not certify(world, polyline(row.path)).free:
        row.refused += 1
        row.path = None
        if row.refused < ATTEMPTS:
            resolution *= FINER
            again = _grow(batch, start, goal, resolution, row.rng)
            row.path = None if again is None else batch.shorten(again, resolution, MARGIN)
    row.certificate = 1e6 * (time.thread_time() - began)
    row.hits = row.path is not None and _hits(world, row.path)


def _renamed(message: Scene, mark: str) -> Scene:
    """The same scene of obstacles that nobody has seen."""
    renamed = [msgspec.structs.replace(one, name=f"{index} {mark}") for index, one in enumerate(message.obstacles)]
    return msgspec.structs.replace(message, obstacles=renamed)


def _grow(
    batch: BatchCollision, start: np.ndarray, goal: np.ndarray, resolution: float, rng: np.random.Generator
) -> np.ndarray | None:
    deadline = Deadline(time.monotonic() + SECONDS)
    return tree_search.grow(batch, start[None], goal[None], resolution, 0.0, rng, deadline).path


def _hits(world: World, path: np.ndarray) -> bool:
    """Return whether a path touches anything on the exact meshes."""
    for a, b in itertools.pairwise(path):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / JUDGED_STEP)))
        for share in np.arange(1, count + 1) / count:
            if world.in_collision(world.group.expand_from_local(a + share * (b - a))):
                return True
    return False


def _kinematics_us(group: PlanningGroup) -> float:
    """Measure Pinocchio's forward kinematics, the best of many times a hundred [us]."""
    data, q, shortest = group.model.createData(), pin.neutral(group.model), np.inf
    for _ in range(3000):
        began = time.perf_counter()
        for _ in range(100):
            pin.forwardKinematics(group.model, data, q)
        shortest = min(shortest, time.perf_counter() - began)
    return 1e4 * shortest


def _print(title: str, rows: list[Row]) -> None:
    unsolved = ", ".join("{} {}".format(*row.name) for row in rows if row.path is None)
    print(f" {title}: certified {sum(row.path is not None for row in rows)} of {len(rows)};", end="")
    print(f" first path refused by the certificate: {sum(row.refused > 0 for row in rows)};")
    print(f"  certified paths in collision with the exact meshes: {sum(row.hits for row in rows)}")
    if unsolved:
        print(f"  not solved: {unsolved}")
    for name, field in (
        ("scene, new, us", "scene"),
        ("planning, us", "plan"),
        ("simplification, us", "simplify"),
        ("whole call, us", "call"),
        ("certificate, with new plans where it refused, us", "certificate"),
        ("length", "length"),
    ):
        print_times(f"  {name}", [getattr(row, field) for row in rows])
    for problem_set in dict.fromkeys(row.problem["set"] for row in rows):
        print_times(f"    {problem_set}, planning", [row.plan for row in rows if row.problem["set"] == problem_set])


def _print_beside_vamp(given: Problems, sequences: list[list[Row]], scale: float) -> None:
    """Print VAMP's rows on the same problems, their times scaled, and ours as multiples of them."""
    vamp, names = given.peers_rows(), [row.name for row in sequences[0]]
    chosen = [k for k, name in enumerate(names) if name in vamp and vamp[name]["solved"]]
    if not chosen:
        return
    theirs = [vamp[names[k]] for k in chosen]
    print(f" VAMP's rows, scaled by {scale:.2f}: solved {len(chosen)} of {sum(name in vamp for name in names)}")
    judged = [row["clearance"] for row in theirs if row.get("clearance") is not None]
    print(f"  paths in collision with the exact meshes: {sum(one <= 0.0 for one in judged)} of {len(judged)} judged")
    print_times("  length", [row["cost"] for row in theirs])
    for name, field, parts in (
        ("planning", "plan", ("plan_us",)),
        ("whole call with the scene", "call", ("env_us", "wall_us")),
    ):
        times = scale * np.array([sum(row[part] for part in parts) for row in theirs])
        ours = np.median([[getattr(rows[k], field) for k in chosen] for rows in sequences], axis=0)
        low, middle, high = np.quantile(ours / times, [0.1, 0.5, 0.9])
        print_times(f"  {name}, us", times)
        print_times(f"  {name}, guidefield, us", ours)
        print(
            f"  our {name} problem by problem, as a multiple: median {middle:.3g}, a tenth each below {low:.3g} and"
            f" above {high:.3g}; no longer on {100.0 * np.mean(ours <= times):.0f} %"
        )
