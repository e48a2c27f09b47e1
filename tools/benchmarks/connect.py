"""Connecting two configurations: success, planning time, the whole call, and paths that the exact meshes refuse.

Usage: tools/bench connect --problems <folder> [--every N] [--sequences N] [<robot> ...]

The folder is described in problems.py. Beside our times stand those of the peers' rows on the same problems, scaled by
Pinocchio's forward kinematics, which a row's machine did in `PEERS_KINEMATICS`.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.problems import ROBOTS, Problems, scene_message
from benchmarks.timing import best
from guidefield.collision.certificate import certify
from guidefield.collision.lanes import Lanes
from guidefield.collision.world import World
from guidefield.planner import lane_tree
from guidefield.planner.connect import LANE_ATTEMPTS, LANE_FINER, LANE_RESOLUTION
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
    """One problem: bare planning and the whole call [us], samples drawn, what the certificate said of each attempt."""

    problem_set: str
    index: int
    plan: float
    whole: float
    iterations: int
    refused: int
    solved: bool


def run(arguments: list[str]) -> None:
    """Print a table for each robot."""
    parser = argparse.ArgumentParser(prog="tools/bench connect", description=__doc__.partition("\n")[0])
    parser.add_argument("--problems", type=Path, required=True, help="folder of problems and robots")
    parser.add_argument("--every", type=int, default=1, help="take every n-th problem only")
    parser.add_argument("--sequences", type=int, default=1, help="sequences of samples to judge by")
    parser.add_argument("robots", nargs="*", default=list(ROBOTS))
    options = parser.parse_args(arguments)
    for robot in options.robots:
        _robot(options.problems, robot, options.every, options.sequences)


def _robot(folder: Path, robot: str, every: int, sequences: int) -> None:
    given = Problems.load(folder, robot, every)
    kinematics = _kinematics_us(given.group)
    print(f"\n{robot}: {len(given.problems)} problems, Pinocchio's forward kinematics {kinematics:.2f} us")
    for sequence in range(sequences):
        rows = [_row(given, problem, sequence) for problem in given.problems]
        _print(f"sequence {sequence}", rows)
    peers = given.peers_rows()
    if peers:
        chosen = [peers[key] for problem in given.problems if (key := (problem["set"], problem["index"])) in peers]
        times = np.array([row["plan_us"] for row in chosen if row["solved"]]) * kinematics / PEERS_KINEMATICS
        _print_times(f"  VAMP's rows, scaled, {len(times)} solved of {len(chosen)}", times)


def _row(given: Problems, problem: dict[str, Any], sequence: int) -> Row:
    z_start, z_goal = given.ends(problem)
    message = scene_message(problem)
    plan = whole = np.inf
    for _ in range(REPEATS):
        began = time.perf_counter()
        world = World.build(given.group, build(message))
        lanes = Lanes.build(world)
        ready = time.perf_counter()
        resolution, refused, rng = LANE_RESOLUTION, 0, np.random.default_rng(sequence)
        found = _grown(lanes, z_start, z_goal, resolution, rng)
        plan = min(plan, time.perf_counter() - ready)
        while found.path is not None and not certify(world, polyline(found.path)).free:
            refused += 1
            if refused == LANE_ATTEMPTS:
                break
            resolution *= LANE_FINER
            found = _grown(lanes, z_start, z_goal, resolution, rng)
        whole = min(whole, time.perf_counter() - began)
        if whole > 1.0:
            break
    solved = found.path is not None and refused < LANE_ATTEMPTS
    return Row(problem["set"], problem["index"], 1e6 * plan, 1e6 * whole, found.iterations, refused, solved)


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
    _print_times("  scene, tables, planning and certificate, us", np.array([row.whole for row in rows]))
    for name in dict.fromkeys(row.problem_set for row in rows):
        _print_times(f"    {name}, planning", np.array([row.plan for row in rows if row.problem_set == name]))


def _print_times(title: str, times: np.ndarray) -> None:
    if len(times):
        print(f"{title}: median {np.median(times):.0f}, mean {times.mean():.0f}, p95 {np.quantile(times, 0.95):.0f}")
