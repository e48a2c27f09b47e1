"""Inverse kinematics of poses that are in reach: how many are solved, how soon, and how different the solutions are.

Options: [--poses N] [--solutions K] [--problems FOLDER] [robot ..]; with a folder of the public problems, robots are
theirs. The poses are the tip's at random configurations; nothing is in the way.
Solutions at least one radian (or 0.3 m) apart in some joint, whole turns left out, are counted as families. Times are
of the processor: for one solution, and for as many as are asked, from the group's middle and random starts.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import pinocchio as pin

from benchmarks.problems import Problems
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.group.reduced_model import select
from guidefield.robot.ik.inverse_kinematics import solve
from guidefield.robot.ik.pose_search import PoseTarget
from guidefield.robot.model.model import JointKind

ROBOTS = ("panda", "ur5", "xarm7", "kinova")
FAMILY_ANGLE, FAMILY_LENGTH = 1.0, 0.3


def run(arguments: list[str]) -> None:
    """Print a row for each robot."""
    parser = argparse.ArgumentParser(prog="tools/bench ik", description=__doc__.partition("\n")[0])
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--solutions", type=int, default=8)
    parser.add_argument("--problems", type=Path)
    parser.add_argument("robots", nargs="*", default=list(ROBOTS))
    asked = parser.parse_args(arguments)
    print("robot      poses solved   first us median / p95   all us median / p95   solutions   families (mean)")
    for name in asked.robots:
        _print_row(_group(name, asked.problems), name, asked)


def _group(name: str, folder: Path | None) -> PlanningGroup:
    if folder is not None:
        return Problems.load(folder, name, 1000).group
    robot = Catalog().load(name)
    return select(robot, None, None, robot.rest, pin.SE3.Identity())


def _print_row(group: PlanningGroup, name: str, asked: argparse.Namespace) -> None:
    kinematics, rng = Kinematics(group), np.random.default_rng(0)
    start = group.chart(group.part_of(group.robot.rest))
    first, whole, counts, families, solved = [], [], [], [], 0
    for index in range(asked.poses):
        placement = kinematics.frame_placement(group.expand(group.random(rng)), group.tip_id)
        target = PoseTarget(placement, np.zeros(3), np.zeros(3))
        for count, times in ((1, first), (asked.solutions, whole)):
            began = time.process_time()
            result = solve(group, target, [start], count, rng=np.random.default_rng(index))
            times.append(1e6 * (time.process_time() - began))
        solved += bool(result.solutions)
        counts.append(len(result.solutions))
        families.append(_families(group, result.solutions))
    print(
        f"{name:10} {asked.poses:5} {solved:6} {_spread(first):>22} {_spread(whole):>21}"
        f" {np.mean(counts):11.2f} {np.mean(families):10.2f}",
        flush=True,
    )


def _spread(times: list[float]) -> str:
    return f"{np.median(times):.0f} / {np.quantile(times, 0.95):.0f}"


def _families(group: PlanningGroup, solutions: tuple[np.ndarray, ...]) -> int:
    """How many of the solutions are far from all that were counted before."""
    slides = np.concatenate([np.full(joint.nv, joint.kind is JointKind.PRISMATIC) for joint in group.joints])
    far = np.where(slides, FAMILY_LENGTH, FAMILY_ANGLE)
    counted: list[np.ndarray] = []
    for z in solutions:
        apart = [z - other for other in counted]
        apart = [np.where(slides, d, d - 2.0 * np.pi * np.round(d / (2.0 * np.pi))) for d in apart]
        if all((np.abs(d) >= far).any() for d in apart):
            counted.append(z)
    return len(counted)
