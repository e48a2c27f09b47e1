"""How many of the public problems the guided planner solves alone, with guide planes that nobody gave.

Options: --problems FOLDER [--every N] [robot ..]. The goal is a square about the tip's place at the problem's goal, no
larger than the tip's body needs, across the tip's own z axis; the planes that lead there are derived. Times are of the
processor, for planes and for crossing them.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
import pinocchio as pin

from benchmarks.posed import posed
from benchmarks.problems import Problems, scene_of
from guidefield.collision.blocking_pairs import contacts_at
from guidefield.collision.clearance import clearance_at
from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner.guide.auto_planes import derive
from guidefield.planner.guide.guide import ATTEMPTS, cross
from guidefield.planner.guide.tip_reach import tip_radius
from guidefield.planner.task.problem import LastPlaneGoal
from guidefield.scene.guide_plane import GuidePlane, build

SIDE = 1.05
"""Half side of the goal's square over the radius of the tip's body."""
KEPT = 3e-3
"""Clearance that start and goal have in the problems that are counted by themselves [m]."""


def square_about(placement: pin.SE3, half: float) -> GuidePlane:
    """The goal's plane."""
    corners = [(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)]
    vertices = [tuple(placement.act(np.array(corner)).tolist()) for corner in corners]
    return build(messages.GuidePlane(name="goal", vertices=vertices), 0)


def solved(problems: Problems, declared: dict) -> tuple[bool, bool, float, float, str]:
    """Whether the planes were crossed; whether the ends keep their distance; seconds of deriving and of crossing."""
    group = problems.group
    start, goal = (group.from_chart(z) for z in problems.ends(declared))
    problem = posed(group, scene_of(declared), start, LastPlaneGoal())
    world = problem.world
    ends = group.expand(start), group.expand(goal)
    kept = all(clearance_at(world, q).obstacle_distance >= KEPT and not contacts_at(world, q) for q in ends)
    last = square_about(problem.kinematics.frame_placement(ends[1], group.tip_id), SIDE * tip_radius(problem))
    begin = time.process_time()
    derived = derive(problem, last)
    between, q = time.process_time(), start
    why = "" if derived is not None else "no way for the tip"
    for index, plane in enumerate((*(derived or ()), last)):
        crossing = cross(problem, q, plane, index, ATTEMPTS["projected"](group))
        q = crossing.path[-1]
        if crossing.status is not Status.SUCCESS:
            if index < len(derived or ()):  # a plane that nobody asked for may be passed by
                q = crossing.path[0]
                continue
            why = crossing.message
    return not why, kept, between - begin, time.process_time() - between, why


def run(arguments: list[str]) -> None:
    """Count."""
    parser = argparse.ArgumentParser(prog="tools/bench guided", description=__doc__.partition("\n")[0])
    parser.add_argument("--problems", type=Path, required=True, help="folder of problems and robots")
    parser.add_argument("--every", type=int, default=1, help="take every n-th problem only")
    parser.add_argument("robots", nargs="*", default=["panda"])
    asked = parser.parse_args(arguments)
    for robot in asked.robots:
        problems = Problems.load(asked.problems, robot, asked.every)
        rows = defaultdict(list)
        for declared in problems.problems:
            rows[declared["set"]].append(solved(problems, declared))
        print(f"{robot:24} solved  of them with free ends   planes ms  crossing ms (medians)")
        everything = [row for found in rows.values() for row in found]
        for name, found in [*sorted(rows.items()), ("all", everything)]:
            free = [row for row in found if row[1]]
            print(
                f"{name:24} {sum(row[0] for row in found):3} of {len(found):3}"
                f"  {sum(row[0] for row in free):3} of {len(free):3}"
                f" {1e3 * np.median([row[2] for row in found]):18.1f}"
                f" {1e3 * np.median([row[3] for row in found]):12.1f}"
            )
