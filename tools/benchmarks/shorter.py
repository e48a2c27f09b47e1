"""Connections made shorter: how much shorter than the first path after so many rounds, and what the rounds take.

Usage: tools/bench shorter --problems <folder> [--every N] [--rounds N ...] [<robot> ...]

The folder is described in problems.py. Lengths are in the chart, of paths after shortcuts; times are CPU times.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from benchmarks.posed import posed
from benchmarks.problems import ROBOTS, Problems, scene_of
from guidefield.deadline import Deadline
from guidefield.planner.connect import tree_search
from guidefield.planner.connect.connect import ShorteningRounds, shorten_path
from guidefield.planner.connect.tree_search import RESOLUTION
from guidefield.planner.motion.waypoints import length_of
from guidefield.planner.task.problem import ConfigurationGoal
from guidefield.robot.model.size import MARGIN

SECONDS = 20.0
"""Budget of one problem."""


def run(arguments: list[str]) -> None:
    """Print a line for each robot and number of rounds."""
    parser = argparse.ArgumentParser(prog="tools/bench shorter", description=__doc__.partition("\n")[0])
    parser.add_argument("--problems", type=Path, required=True, help="folder of problems and robots")
    parser.add_argument("--every", type=int, default=1, help="take every n-th problem only")
    parser.add_argument("--rounds", type=int, nargs="+", default=[1, 10, 100], help="how many rounds")
    parser.add_argument("robots", nargs="*", default=list(ROBOTS))
    options = parser.parse_args(arguments)
    for robot in options.robots:
        given = Problems.load(options.problems, robot, options.every)
        for number in options.rounds:
            rows = [row for problem in given.problems if (row := _row(given, problem, number)) is not None]
            ratios, times = np.array(rows).T
            print(
                f"{robot}, {len(rows)} of {len(given.problems)} problems, {number} rounds: length mean"
                f" {ratios.mean():.3f}, median {np.median(ratios):.3f} of the first path's; ms median"
                f" {1e3 * np.median(times):.3g}, mean {1e3 * times.mean():.3g}"
            )


def _row(given: Problems, declared: dict, number: int) -> tuple[float, float] | None:
    """Share of the first path's length that is left, and seconds; None where there is no first path."""
    z_start, z_goal = given.ends(declared)
    group, rng = given.group, np.random.default_rng(0)
    q_start, goal = group.from_chart(z_start), ConfigurationGoal((group.from_chart(z_goal),))
    problem = posed(group, scene_of(declared), q_start, goal, deadline=Deadline(time.monotonic() + SECONDS))
    lanes = problem.lanes
    found = tree_search.grow(lanes, z_start[None], z_goal[None], RESOLUTION, 0.0, rng, problem.deadline)
    if found.path is None:
        return None
    path = lanes.shorten(found.path, RESOLUTION, MARGIN)
    rounds = ShorteningRounds(number, RESOLUTION, MARGIN)
    began = time.thread_time()
    better = shorten_path(problem, path, z_goal[None], rounds, rng, lambda _: True)
    return length_of(better.path, problem.group.units) / length_of(
        path, problem.group.units
    ), time.thread_time() - began
