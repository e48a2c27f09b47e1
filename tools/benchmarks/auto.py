"""How many of the public problems `auto` solves when their goal is a small plane at the hand's place at the goal.

Usage: tools/bench auto --problems <folder> [--every N] [--seconds S] [--side MM] [<robot> ...]

The square lies across the tip's own z axis at the goal configuration, no larger than the guided planner needs for the
tip's body unless a side is given; planes that lead there are derived, and every plan is certified. Beside those solved
stands how many of them the guided planner came through alone, and how many went on as a connection from where it was
stuck. Times are of the processor; the deadline of a problem is on the clock.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.guided import SIDE, square_about
from benchmarks.posed import posed
from benchmarks.problems import ROBOTS, Problems, scene_of
from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.planner.guide.auto_planes import derive
from guidefield.planner.guide.tip_reach import tip_radius
from guidefield.planner.plan import Plan, plan
from guidefield.planner.task.problem import LastPlaneGoal


def run(arguments: list[str]) -> None:
    """Print a table for each robot."""
    parser = argparse.ArgumentParser(prog="tools/bench auto", description=__doc__.partition("\n")[0])
    parser.add_argument("--problems", type=Path, required=True, help="folder of problems and robots")
    parser.add_argument("--every", type=int, default=1, help="take every n-th problem only")
    parser.add_argument("--seconds", type=float, default=10.0, help="deadline of a problem")
    parser.add_argument("--side", type=float, help="side of the square [mm]")
    parser.add_argument("robots", nargs="*", default=list(ROBOTS))
    asked = parser.parse_args(arguments)
    for robot in asked.robots:
        given = Problems.load(asked.problems, robot, asked.every)
        rows = [(declared["set"], *_planned(given, declared, asked)) for declared in given.problems]
        _print(robot, rows)


def _planned(given: Problems, declared: dict[str, Any], asked: argparse.Namespace) -> tuple[Plan, float]:
    """What came of a problem, and the time it took [s]."""
    group, deadline = given.group, Deadline(time.monotonic() + asked.seconds)
    start, goal = (group.from_chart(z) for z in given.ends(declared))
    problem = posed(group, scene_of(declared), start, LastPlaneGoal(), deadline=deadline)
    half = SIDE * tip_radius(problem) if asked.side is None else 5e-4 * asked.side
    last = square_about(problem.kinematics.frame_placement(group.expand(goal), group.tip_id), half)
    began = time.process_time()
    derived = derive(problem, last) or ()
    problem = dataclasses.replace(problem, guide_planes=(*derived, last), derived_planes=len(derived))
    return plan(problem), time.process_time() - began


def _print(robot: str, rows: list[tuple[str, Plan, float]]) -> None:
    """One line for each set of problems, then why the others failed."""
    print(f"\n{robot:24} solved        guided alone   then connected   ms median / p95 of the solved")
    for name in [*dict.fromkeys(row[0] for row in rows), "all"]:
        found = [row for row in rows if name in (row[0], "all")]
        solved = [row for row in found if row[1].status is Status.SUCCESS]
        connected = sum(any(stage.name == "connect" for stage in row[1].stages) for row in solved)
        times = 1e3 * np.array([row[2] for row in solved] or [np.nan])
        print(
            f"{name:24} {len(solved):4} of {len(found):4} {len(solved) - connected:12} {connected:16}"
            f" {np.median(times):14.0f} / {np.quantile(times, 0.95):.0f}"
        )
    for why, count in Counter(row[1].message for row in rows if row[1].status is not Status.SUCCESS).most_common(5):
        print(f"  {count}: {why}")
