"""Go on by a connection from the motion found so far, to a goal or to a guide plane that the field didn't reach."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin

from guidefield.errors import Status
from guidefield.planner.connect.connect import Connection, connect
from guidefield.planner.connect.constrained_tree import Keeper, connect_constrained
from guidefield.planner.ends import UNREACHED, tip_points
from guidefield.planner.guide.tip_reach import inset_of
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.task.ending import Ending
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stage, StageFailed
from guidefield.planner.task.trace import Note
from guidefield.robot.ik.pose_target import EXACT, PoseTarget
from guidefield.robot.model.spaces import ChartPoint, ChartPoints
from guidefield.scene.flat import axes_across
from guidefield.scene.guide_plane import GuidePlane

SHARE = 0.5
"""Share of the time for a connection before a lesser one is looked for: from the start instead of from where derived
guide planes led; with no more than contact avoided instead of with the clearance asked for."""


def connect_to_plane(problem: Problem, found: PathSoFar, stuck: PathSoFar, index: int, stage: Stage) -> PathSoFar:
    """Reach a guide plane, with any orientation, from where the approach to it began.

    Returns:
        The motion onto the plane. If there is no connection, the motion as far as the approach came, failed with the
        approach's status and both reasons.
    """
    try:
        reached = connect_to_goal(
            problem, found, _points_on(problem, problem.guide_planes[index], stuck.path[-1]), stage
        )
    except StageFailed as failed:
        reached = found.failed(failed.ending)
    if reached.failure is None:
        return reached
    assert stuck.failure is not None, "it didn't arrive"
    message = f"{stuck.failure.message}; the tree got no further either: {reached.failure.message}"
    stage.outcome = stage.outcome or message
    return stuck.failed(Ending(stuck.failure.status, message, stuck.failure.details))


def _points_on(problem: Problem, plane: GuidePlane, stuck: ChartPoint) -> ChartPoints:
    """Chart points (m, nv) with the tip on a plane: where the approach got stuck, else in its middle."""
    tip = problem.kinematics.tip_position(problem.group.expand_from_chart(stuck))
    place = plane.closest_point(tip, inset_of(problem, plane))
    try:
        return tip_points(problem, PoseTarget(pin.SE3(np.eye(3), place), np.zeros(3), np.full(3, np.inf)))
    except StageFailed as failed:
        if failed.ending.status not in UNREACHED:
            raise
    return tip_points(problem, _within(problem, plane))


def _within(problem: Problem, plane: GuidePlane) -> PoseTarget:
    """The tip anywhere in a square in the middle of a plane, as large as stays inside, with any orientation."""
    inset, across = inset_of(problem, plane), axes_across(plane.normal)
    centre = plane.closest_point(plane.centroid, inset)
    corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) @ across
    half = plane.inradius
    while half > EXACT and not all(plane.contains(centre + half * corner, inset) for corner in corners):
        half *= 0.5
    rotation = np.column_stack([*across, np.cross(*across)])
    return PoseTarget(pin.SE3(rotation, centre), np.array([half, half, 0.0]), np.full(3, np.inf))


def connect_to_goal(
    problem: Problem, found: PathSoFar, goals: ChartPoints, stage: Stage, *, prove: bool = True
) -> PathSoFar:
    """Go on to a goal.

    Args:
        found: The motion so far. If nothing leads on from where guide planes led that nobody gave, a connection begins
            anew at the start.
        goals: Chart points of which one is to be reached, shape (m, nv).

    Returns:
        The motion to a goal; failed where it ends if no connection is found, or time is up.
    """
    led = len(found.path) > 1 and max(found.crossings, default=-1) < problem.derived_planes
    connection = _try_connection(_in_part_of_the_time(problem) if led else problem, found, goals, prove)
    if led and connection.status is not Status.SUCCESS and not problem.deadline.expired():
        problem.tell(Note("nothing leads on from where derived guide planes led: the connection begins at the start"))
        found = found.back_at_start()
        connection = _try_connection(problem, found, goals, prove)
    stage.outcome = connection.message
    if connection.status is not Status.SUCCESS:
        return found.failed(Ending(connection.status, connection.message, {"stage": "connect"}))
    return found.extended(connection.path, proven=connection.proven, others=connection.others)


def _try_connection(problem: Problem, found: PathSoFar, goals: ChartPoints, prove: bool) -> Connection:
    """A connection from the end of the motion so far, along path constraints if there are any."""
    rng = np.random.default_rng([problem.seed, 2])
    if problem.path_constraints:
        keeper = Keeper(problem, problem.constrained_frames)
        return connect_constrained(problem, keeper, found.path[-1], goals, rng)
    return _connect_with_clearance(problem, found, goals, rng, prove)


def _connect_with_clearance(
    problem: Problem, found: PathSoFar, goals: ChartPoints, rng: np.random.Generator, prove: bool
) -> Connection:
    """With the clearance asked for if there is such a connection, else any that is free."""
    part = _in_part_of_the_time(problem) if problem.min_clearance > 0.0 else problem
    connection = connect(part, found.path[-1], goals, rng, prove=prove)
    if connection.status is not Status.SUCCESS and problem.min_clearance > 0.0 and not problem.deadline.expired():
        problem.tell(Note("no connection keeps the clearance asked for: optimising may make one of any that is free"))
        problem = dataclasses.replace(problem, min_clearance=0.0)
        connection = connect(problem, found.path[-1], goals, rng, prove=prove)
    return connection


def _in_part_of_the_time(problem: Problem) -> Problem:
    """The problem with a share of the time that is left: another way is tried after."""
    return dataclasses.replace(problem, deadline=problem.deadline.share(SHARE))
