"""Connecting two configurations: success, planning time, the whole call, and paths that the exact meshes refuse.

Usage: tools/bench connect --problems <folder> [--every N] [--sequences N] [--peers SECONDS] [<robot> ...]

The folder is described in problems.py. Beside our times stand those of the peers' rows on the same problems, scaled by
Pinocchio's forward kinematics, which a row's machine did in `PEERS_KINEMATICS`.
With `--peers`, the planners of peers.py that are installed plan the same problems in the same run. All is CPU time.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks import peers
from benchmarks.problems import ROBOTS, Problems, scene_message
from benchmarks.timing import best
from guidefield.collision.certificate import certify
from guidefield.collision.lanes import Lanes
from guidefield.collision.world import World
from guidefield.planner import lane_tree
from guidefield.planner.connect import LANE_ATTEMPTS, LANE_FINER, LANE_MARGIN, LANE_RESOLUTION
from guidefield.planner.plan import polyline
from guidefield.planner.problem import Budget
from guidefield.robot.group import PlanningGroup
from guidefield.scene.scene import build

PEERS_KINEMATICS = 0.30
"""What one forward kinematics of a Panda took where the peers' rows were measured [us]."""

REPEATS = 3
SECONDS = 20.0
"""Budget of one problem."""


@dataclass(frozen=True)
class Row:
    """One problem: CPU time [us], samples drawn, length of the simplified path, what the certificate said.

    `call` is what a user waits for without the certificate: scene built, planned, simplified. `refused` counts the
    paths that the certificate refused.
    """

    problem_set: str
    index: int
    plan: float
    simplify: float
    call: float
    certificate: float
    iterations: int
    length: float
    refused: int
    solved: bool


def run(arguments: list[str]) -> None:
    """Print a table for each robot."""
    parser = argparse.ArgumentParser(prog="tools/bench connect", description=__doc__.partition("\n")[0])
    parser.add_argument("--problems", type=Path, required=True, help="folder of problems and robots")
    parser.add_argument("--every", type=int, default=1, help="take every n-th problem only")
    parser.add_argument("--sequences", type=int, default=1, help="sequences of samples to judge by")
    parser.add_argument("robots", nargs="*", default=list(ROBOTS))
    parser.add_argument("--peers", type=float, default=0.0, metavar="SECONDS", help="plan with other planners too")
    options = parser.parse_args(arguments)
    for robot in options.robots:
        _robot(options.problems, robot, options.every, options.sequences, options.peers)


def _robot(folder: Path, robot: str, every: int, sequences: int, seconds: float) -> None:
    given = Problems.load(folder, robot, every)
    kinematics = _kinematics_us(given.group)
    print(f"\n{robot}: {len(given.problems)} problems, Pinocchio's forward kinematics {kinematics:.2f} us")
    for sequence in range(sequences):
        rows = [_row(given, problem, sequence) for problem in given.problems]
        _print(f"sequence {sequence}", rows)
    rows_of_vamp = given.peers_rows()
    if rows_of_vamp:
        keys = [(problem["set"], problem["index"]) for problem in given.problems]
        chosen = [rows_of_vamp[key] for key in keys if key in rows_of_vamp]
        times = np.array([row["plan_us"] for row in chosen if row["solved"]]) * kinematics / PEERS_KINEMATICS
        _print_times(f"  VAMP's rows, scaled, {len(times)} solved of {len(chosen)}", times)
    if seconds > 0.0:
        _beside(given, seconds)


def _row(given: Problems, problem: dict[str, Any], sequence: int) -> Row:
    z_start, z_goal = given.ends(problem)
    message = scene_message(problem)
    plan = simplify = call = np.inf
    for _ in range(REPEATS):
        rng = np.random.default_rng(sequence)
        began = time.thread_time()
        world = World.build(given.group, build(message))
        lanes = Lanes.build(world)
        ready = time.thread_time()
        found = _grown(lanes, z_start, z_goal, LANE_RESOLUTION, rng)
        grown = time.thread_time()
        path = None if found.path is None else lanes.shortened(found.path, LANE_RESOLUTION, LANE_MARGIN)
        done = time.thread_time()
        plan, simplify, call = min(plan, grown - ready), min(simplify, done - grown), min(call, done - began)
        if call > 0.1:
            break
    began, refused, resolution = time.thread_time(), 0, LANE_RESOLUTION
    while path is not None and not certify(world, polyline(path)).free:
        refused += 1
        if refused == LANE_ATTEMPTS:
            break
        resolution *= LANE_FINER
        again = _grown(lanes, z_start, z_goal, resolution, rng)
        path = None if again.path is None else lanes.shortened(again.path, resolution, LANE_MARGIN)
    certificate = time.thread_time() - began
    length = 0.0 if path is None else float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    return Row(
        problem_set=problem["set"],
        index=problem["index"],
        plan=1e6 * plan,
        simplify=1e6 * simplify,
        call=1e6 * call,
        certificate=1e6 * certificate,
        iterations=found.iterations,
        length=length,
        refused=refused,
        solved=path is not None and refused < LANE_ATTEMPTS,
    )


def _beside(given: Problems, seconds: float) -> None:
    """Plan the same problems with the planners that are installed."""
    robot, packages = given.folder / "robots" / given.robot / given.robot, given.folder / "robots"
    for name, solve in peers.installed().items():
        answers, hits = [], 0
        for problem in given.problems:
            world = World.build(given.group, build(scene_message(problem)))
            task = peers.Task(robot, packages, world, problem["obstacles"], *given.ends(problem), seconds, 0)
            answers.append(solve(task))
            if answers[-1].path is not None:
                hits += not certify(world, polyline(answers[-1].path)).free
        solved = [answer for answer in answers if answer.path is not None]
        print(f" {name}: solved {len(solved)} of {len(answers)} in {seconds:g} s each; paths not free: {hits}")
        for fault in sorted({answer.fault for answer in answers if answer.fault}):
            print(f"  could not begin: {fault}")
        for step in ("scene", "plan", "simplify"):
            _print_times(f"  {step}, us", np.array([getattr(answer, step) for answer in solved]))
        lengths = [np.linalg.norm(np.diff(answer.path, axis=0), axis=1).sum() for answer in solved]
        _print_times("  length", np.array(lengths))


def _grown(
    lanes: Lanes, z_start: np.ndarray, z_goal: np.ndarray, resolution: float, rng: np.random.Generator
) -> lane_tree.Found:
    budget = Budget(time.monotonic() + SECONDS)
    return lane_tree.grow(lanes, z_start[None], z_goal[None], resolution, 0.0, rng, budget)


def _kinematics_us(group: PlanningGroup) -> float:
    data, q = group.model.createData(), pin.neutral(group.model)

    def many() -> None:
        for _ in range(100):
            pin.forwardKinematics(group.model, data, q)

    return 1e4 * best(many, 0.2)


def _print(title: str, rows: list[Row]) -> None:
    solved = [row for row in rows if row.solved]
    refused = sum(row.refused > 0 for row in rows)
    unsolved = ", ".join(f"{row.problem_set} {row.index}" for row in rows if not row.solved)
    print(f" {title}: certified {len(solved)} of {len(rows)}; first path refused by the certificate: {refused}")
    if unsolved:
        print(f"  not solved: {unsolved}")
    _print_times("  planning, us", np.array([row.plan for row in rows]))
    _print_times("  simplification, us", np.array([row.simplify for row in rows]))
    _print_times("  scene, planning and simplification, us", np.array([row.call for row in rows]))
    _print_times("  certificate, with new plans where it refused, us", np.array([row.certificate for row in rows]))
    _print_times("  length", np.array([row.length for row in solved]))
    for name in dict.fromkeys(row.problem_set for row in rows):
        _print_times(f"    {name}, planning", np.array([row.plan for row in rows if row.problem_set == name]))


def _print_times(title: str, times: np.ndarray) -> None:
    if len(times):
        print(f"{title}: median {np.median(times):.4g}, mean {times.mean():.4g}, p95 {np.quantile(times, 0.95):.4g}")
