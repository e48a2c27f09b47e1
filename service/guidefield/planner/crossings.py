"""Cross guide planes in order by the guided planner; where it gets stuck, `auto` goes on by a connection."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner.ends import find_tip_points
from guidefield.planner.guide.guide import cross_plane
from guidefield.planner.guide.rounds import Attempt
from guidefield.planner.guide.tip_reach import tip_radius
from guidefield.planner.held_paths import connect_to_plane
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.task.problem import Problem, TipGoal
from guidefield.planner.task.stages import Ending, Stage, StageFailed, Stages
from guidefield.robot.model.spaces import ChartPoint, ChartPoints
from guidefield.scene.guide_plane import GuidePlane, axes_across, build


def cross_planes(
    problem: Problem, found: PathSoFar, stages: Stages, attempts: Sequence[Attempt], *, connects: bool
) -> PathSoFar:
    """Bring the tip onto the guide planes of a problem, in order, from where a motion ends.

    A derived one may be passed by, with those that follow it. It fails before a plane that isn't reached; a connection
    may go on where the field gets stuck.
    """
    passed_by = False
    for index, plane in enumerate(problem.guide_planes):
        if passed_by and index < problem.derived_planes:
            continue
        if problem.path_constraints:  # which the field's steps would leave
            with stages.entered("connect", f"to guide plane {plane.name}", index) as stage:
                along = connect_to_plane(problem, found, found, index, stage)
        else:
            with stages.entered("guide", f"to guide plane {plane.name}", index) as stage:
                along = _approach(problem, found, plane, index, attempts, stage)
        failure = along.failure
        if failure is None:
            found = along
        elif not connects or failure.status in (Status.TIMED_OUT, Status.PREEMPTED):
            return along
        elif index < problem.derived_planes:  # nobody asked for it: go on without it and those that would follow
            passed_by = True
            continue
        elif problem.path_constraints:
            return along
        else:
            with stages.entered("connect", f"to guide plane {plane.name}, where the field got stuck", index) as stage:
                found = connect_to_plane(problem, found, along, index, stage)
            if found.failure is not None:
                return found
        found = found.with_plane_reached(index)
    return found


def _approach(
    problem: Problem, found: PathSoFar, plane: GuidePlane, index: int, attempts: Sequence[Attempt], stage: Stage
) -> PathSoFar:
    crossing = cross_plane(problem, problem.group.from_chart(found.path[-1]), plane, index, attempts)
    reached = crossing.status is Status.SUCCESS
    stage.outcome = "reached" if reached else crossing.status.name.lower().replace("_", " ")
    along_planes = found.extend(problem.group.chart_path(list(crossing.path), found.path[-1]))
    return (
        along_planes
        if reached
        else along_planes.with_failure(Ending(crossing.status, crossing.message, crossing.details))
    )


SQUARE = 1.05  # half side of the square about the goal, over the radius of the tip's body that has to fit through


def find_goals_behind_planes(
    problem: Problem, found: PathSoFar, stages: Stages, attempts: Sequence[Attempt]
) -> tuple[PathSoFar, ChartPoints]:
    """Chart points (m, nv) that reach the goal's pose, searched for from where the guided planner gets, and the motion.

    The guided planner goes on to a small square about the goal's place, across the way there: among obstacles, the
    configuration it arrives at is one that fits there, and the pose is searched for next to it. There are none where it
    failed, with one of `UNREACHED` and the reason, TIMED_OUT or PREEMPTED.
    """
    assert isinstance(problem.goal, TipGoal)
    group, target = problem.group, problem.goal.target
    with stages.entered("guide", "to the place of the goal's pose") as stage:
        here = found.path[-1]
        square = _make_square(problem, here, np.asarray(target.placement.translation))
        along = _approach(problem, found, square, len(problem.guide_planes), attempts, stage)
    found = found if along.failure is not None else along
    try:
        return found, find_tip_points(problem, target, (along.path[-1], here))
    except StageFailed as failed:
        return found.with_failure(failed.ending), cast(ChartPoints, np.empty((0, group.nv)))


def _make_square(problem: Problem, here: ChartPoint, place: np.ndarray) -> GuidePlane:
    """A square as small as the tip's body allows, about a place (3,), across the straight way of the tip there."""
    way = place - problem.kinematics.tip_position(problem.group.expand_from_chart(here))
    length = float(np.linalg.norm(way))
    across = axes_across(way / length if length > 1e-9 else np.array([0.0, 0.0, 1.0]))
    half = SQUARE * max(tip_radius(problem), 1e-3)
    corners = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    vertices = [tuple(vertex) for vertex in (place + corners @ across).tolist()]
    return build(messages.GuidePlane(name="goal", vertices=vertices), 0)
