"""A connection made shorter, round by round: new trees in the part of the chart through which a shorter one can lead.

A round is a search of at most so many motions with samples of its own, whose path is shortened and taken if it is
shorter. Rounds are counted, not timed: the same seed gives the same path whatever the load, unless time runs out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from guidefield.planner.connect import tree_search
from guidefield.planner.connect.settings import ROUNDS
from guidefield.planner.motion.waypoints import length_of
from guidefield.planner.task.problem import Problem
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoints


@dataclass(frozen=True, eq=False)
class Shorter(ReadOnly):
    """What came of it.

    Attributes:
        path: Chart points (n, nv), free as the path that it began with, and no longer.
        rounds: How many were done.
        message: What a person is told of them.
    """

    path: ChartPoints
    rounds: int
    message: str


@dataclass(frozen=True)
class Rounds:
    """How a connection is made shorter.

    Attributes:
        number: At most how many rounds.
        resolution: Samples of a motion per length in the chart [1/rad or 1/m].
        margin: What shortcuts keep from obstacles beside the clearance asked for [m].
    """

    number: int
    resolution: float
    margin: float


def shorter(
    problem: Problem,
    path: ChartPoints,
    goals: ChartPoints,
    rounds: Rounds,
    rng: np.random.Generator,
    accepted: Callable[[ChartPoints], bool],
) -> Shorter:
    """Look for shorter paths from where a path begins to one of several goals.

    Args:
        problem: Robot, world and deadline.
        path: Chart points, shape (n, nv).
        goals: Chart points, shape (m, nv), free.
        rounds: How many, and how finely they look.
        rng: Shifts each round's samples.
        accepted: Whether a path (n, nv) that is shorter may be taken.
    """
    units = problem.group.units
    deadline, before, done = problem.deadline.share(ROUNDS.share), length_of(path, units), 0
    lanes, clearance, start = problem.lanes, problem.min_clearance, path[:1]
    while done < rounds.number and not deadline.expired():
        bound = (1.0 - ROUNDS.least) * length_of(path, units)
        within = goals[np.linalg.norm((goals - start) / units, axis=1) < bound]
        if len(within) == 0:
            break
        found = tree_search.grow(
            lanes, start, within, rounds.resolution, clearance, rng, deadline, within=bound, most_motions=ROUNDS.motions
        )
        problem.counters.iterations += found.iterations
        problem.counters.collision_checks += found.motions
        if found.path is not None:
            candidate = lanes.shortened(found.path, rounds.resolution, clearance + rounds.margin)
            if length_of(candidate, units) < bound and accepted(candidate):
                path = candidate
        done += 1
    share = 1.0 - length_of(path, units) / before
    message = f"made {share:.1%} shorter in {done} rounds"
    if deadline.expired():
        message += f" of {rounds.number}: time ended them"
    return Shorter(path, done, message)
