"""Goal poses that inverse kinematics finds no free configuration for, until guide planes have led the robot near."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner.ends import tip_points
from guidefield.planner.guide.guide import cross
from guidefield.planner.guide.rounds import Attempt
from guidefield.planner.guide.tip_reach import tip_radius
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.task.problem import Problem, TipGoal
from guidefield.planner.task.stages import StageFailed, Stages
from guidefield.robot.model.spaces import ChartPoint, ChartPoints
from guidefield.scene.flat import axes_across
from guidefield.scene.guide_plane import GuidePlane, build

ROOM = 1.05
"""Half side of the square about the goal over the radius of the tip's body."""


def led_goal_points(
    problem: Problem, found: PathSoFar, stages: Stages, attempts: Sequence[Attempt]
) -> tuple[PathSoFar, ChartPoints]:
    """Chart points that reach the goal's pose, looked for from where the guided planner gets to it.

    The guided planner goes on to a small square about the goal's place, across the way there: among obstacles, the
    configuration it arrives at is one that fits there, and the pose is looked for next to it.

    Args:
        problem: Robot, world and a `TipGoal`.
        found: The motion so far, through all guide planes.
        stages: Gets a stage for it.
        attempts: How the square is tried.

    Returns:
        The motion so far with the way to the goal's place, and chart points (m, nv); none of them where it failed, with
        one of `UNREACHED` and the reason, TIMED_OUT or PREEMPTED.
    """
    assert isinstance(problem.goal, TipGoal)
    group, target = problem.group, problem.goal.target
    with stages.entered("guide", "to the place of the goal's pose") as stage:
        here = found.path[-1]
        square = _square(problem, here, np.asarray(target.placement.translation))
        crossing = cross(problem, group.from_chart(here), square, len(problem.guide_planes), attempts)
        stage.outcome = (
            "reached" if crossing.status is Status.SUCCESS else crossing.status.name.lower().replace("_", " ")
        )
    along = group.chart_path(list(crossing.path), here)
    if crossing.status is Status.SUCCESS:
        found = found.extended(along)
    try:
        return found, tip_points(problem, target, (along[-1], here))
    except StageFailed as failed:
        return found.failed(failed.ending), cast(ChartPoints, np.empty((0, group.nv)))


def _square(problem: Problem, here: ChartPoint, place: np.ndarray) -> GuidePlane:
    """As small as the tip's body lets it be, about a place (3,), across the straight way of the tip there."""
    way = place - problem.kinematics.tip_position(problem.group.expand_from_chart(here))
    length = float(np.linalg.norm(way))
    across = axes_across(way / length if length > 1e-9 else np.array([0.0, 0.0, 1.0]))
    half = ROOM * max(tip_radius(problem), 1e-3)
    corners = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    vertices = [tuple(vertex) for vertex in (place + corners @ across).tolist()]
    return build(messages.GuidePlane(name="goal", vertices=vertices), 0)
