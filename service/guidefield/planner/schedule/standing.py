"""Times at which a robot that stands is free of what moves, by the certificate of motions in time."""

from __future__ import annotations

import math

import numpy as np

from guidefield.planner.task.problem import Problem
from guidefield.prove.certificate import certify_moving
from guidefield.prove.verdict import Verdict
from guidefield.robot.model.spaces import ChartPoint

KNOWN_TO = 0.01
"""How exactly it is found until when, and from when on, a place is free [s]."""


def find_meeting(problem: Problem, z: ChartPoint) -> tuple[float, Verdict | None]:
    """Until when a robot may stand at a chart point (nv,) from time 0 on [s]; infinite if always.

    Returns:
        The time, and the refusal of what comes after it; None if nothing comes.
    """
    end = problem.scene.end
    if end <= 0.0:
        return math.inf, None
    verdict = _stands(problem, z, 0.0, end)
    if verdict.free or verdict.free_until is None or verdict.parameter is None:
        return math.inf, None
    first, last = verdict.free_until[1] * end, verdict.parameter * end
    while last - first > KNOWN_TO and not problem.deadline.expired():
        middle = 0.5 * (first + last)
        if _stands(problem, z, first, middle).free:
            first = middle
        else:
            last = middle
    return first, verdict


def find_free_from(problem: Problem, z: ChartPoint) -> float:
    """From when on a robot may stand at a chart point (nv,) for good [s].

    It is free once all obstacles have come to rest.
    """
    last = max(problem.scene.end, 0.0)
    if last <= 0.0 or _stands(problem, z, 0.0, last).free:
        return 0.0
    first = 0.0
    while last - first > KNOWN_TO and not problem.deadline.expired():
        middle = 0.5 * (first + last)
        if _stands(problem, z, middle, problem.scene.end).free:
            last = middle
        else:
            first = middle
    return last


def stays_free(problem: Problem, z: ChartPoint, since: float) -> bool:
    """Whether a robot may stand at a chart point (nv,) from a time on [s] until all obstacles have come to rest."""
    return since >= problem.scene.end or _stands(problem, z, since, problem.scene.end).free


def _stands(problem: Problem, z: ChartPoint, begin: float, end: float) -> Verdict:
    """Return whether a robot may stand at a chart point from one time to another [s]."""
    verdict = certify_moving(
        problem.world,
        np.repeat(z[None, None], 4, axis=1),
        np.array([begin, end]),
        problem.min_clearance,
        deadline=problem.deadline,
    )
    problem.counters.collision_checks += verdict.evaluations
    return verdict
