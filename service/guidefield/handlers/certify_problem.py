"""From a certify request to a `GivenProblem`, its curve and conditions; what is ill-posed is refused here, by name.

The curve that is built here is the one that is certified: docs/certify.md says which goes through given rows.
"""

from __future__ import annotations

import dataclasses
from typing import cast

import numpy as np

from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.errors import InvalidConfiguration, InvalidGroup, MalformedRequest
from guidefield.geometry.surfaces import se3
from guidefield.handlers.attached import holding
from guidefield.handlers.configurations import (
    Columns,
    first_positions,
    local_points,
    local_rates,
    require_same_joints,
    rows_in,
    velocity_names_of,
)
from guidefield.handlers.requested_group import (
    bounds_efforts,
    cartesian_limits_of,
    constraints_of,
    effort_limit_of,
    execution_of,
    jerk_limits,
    limit_group,
    start_of,
    warn_of_missing_masses,
)
from guidefield.messages.requests import CertifyRequest, GivenTrajectory
from guidefield.planner.judgement import GivenProblem
from guidefield.planner.motion.drawn_motion import DrawnMotion, draw
from guidefield.planner.motion.submitted_motion import (
    CurveKind,
    QuinticMotion,
    StraightMotion,
    SubmittedMotion,
    spline_rates,
)
from guidefield.planner.motion.trajectory import piece_accelerations
from guidefield.planner.task.problem import ControllerModel, Interpolation
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import configuration_from_wire
from guidefield.robot.model.joints import (
    POSITION_SUFFIXES,
    VELOCITY_SUFFIXES,
    JointKind,
    LocalPoints,
    LocalRates,
    RobotConfiguration,
)
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene

MIN_TIME_STEP = 1e-9  # smallest step between two times [s]: rates are differences divided by it
READ_VELOCITIES = (Interpolation.CUBIC, Interpolation.QUINTIC)  # interpolations that need velocities of rows
ACCELERATION_TOLERANCE = 1e-6  # deviation of given accelerations, relative and absolute, without a warning


def certify_problem(
    request: CertifyRequest, robot: RobotModel, scene: Scene, deadline: Deadline
) -> tuple[GivenProblem, tuple[str, ...]]:
    """Build the problem of a request's motion and conditions; return it with warnings about harmless peculiarities.

    Raises InvalidGroup, InvalidConfiguration, UnknownFrame, UnknownObject, SceneInvalid, MalformedRequest if the
    question is ill-posed.
    """
    _require_served(request, scene)
    robot = holding(robot, request.attached_objects, scene, deadline)
    rows = _positions(request)
    columns = _columns(request, robot)
    columns.require_width(_name_of_rows(request), rows)
    group, warnings = _planning_group(request, columns, rows, robot)
    _require_in_group(columns, group)
    given, odd = _build_motion(request, request.trajectory, "trajectory", columns, rows, group)
    planned = given if request.planned is None else _planned_motion(request, request.planned, given, columns, group)
    if bounds_efforts(request) and (given.times is None or (given.velocities is None and not given.is_point)):
        raise MalformedRequest(
            "limits of effort need accelerations, and straight pieces have none: give a `trajectory` with `velocities`,"
            " or samples of a spline",
            path="$.limits",
        )
    execution = execution_of(request, group)
    drawn = None if execution is None else _draw(planned, execution)
    problem = GivenProblem(
        group=group,
        scene=scene,
        world=World.build(group, scene, request.allowed_collisions),
        min_clearance=request.min_clearance,
        allowed_collisions=frozenset(request.allowed_collisions),
        path_constraints=constraints_of(request, group),
        cartesian_limits=cartesian_limits_of(request, group),
        effort_limit=effort_limit_of(request, group),
        leave_start_contact=request.leave_start_contact,
        jerk_limits=jerk_limits(group, request),
        deadline=deadline,
        motion=given if drawn is None else drawn.motion,
        planned=None if planned is given and drawn is None else planned,
        execution=execution,
        drawn=drawn,
    )
    return problem, (*robot.warnings, *scene.warnings, *warnings, *warn_of_missing_masses(request), *odd)


def planning_group(request: CertifyRequest, robot: RobotModel) -> PlanningGroup:
    """Return the group whose motion a request gives, from the first row alone.

    Raises InvalidGroup, InvalidConfiguration, UnknownFrame as `certify_problem`.
    """
    columns, rows = _columns(request, robot), _positions(request, 1)
    columns.require_width(_name_of_rows(request), rows)
    return _planning_group(request, columns, rows, robot)[0]


def _planning_group(
    request: CertifyRequest, columns: Columns, rows: np.ndarray, robot: RobotModel
) -> tuple[PlanningGroup, list[str]]:
    q_whole, warnings = _first_configuration(request, columns, rows, robot)
    place = se3(request.robot_placement.position, request.robot_placement.quaternion_xyzw)
    return limit_group(select(robot, _group(request, columns, robot), request.tip, q_whole, place), request), warnings


def _require_served(request: CertifyRequest, scene: Scene) -> None:
    if scene.moves and request.trajectory is None:
        moving = [one.name for one in scene.obstacles if one.motion is not None]
        raise MalformedRequest(
            f"obstacles move ({', '.join(moving)}), and a `path` has no times: give a `trajectory`", obstacles=moving
        )


def _first_configuration(
    request: CertifyRequest, columns: Columns, rows: np.ndarray, robot: RobotModel
) -> tuple[RobotConfiguration, list[str]]:
    """The configuration of the whole robot, shape (nq,), in the first of the rows (n, k), and warnings."""
    standing = {name: value for name, value in request.start.items() if name not in columns.of}
    q, warnings = start_of(standing, robot)
    return configuration_from_wire(robot, first_positions(columns, rows, robot), base=q), warnings


def _name_of_rows(request: CertifyRequest) -> str:
    return "path" if request.trajectory is None else "trajectory.positions"


def _positions(request: CertifyRequest, most: int | None = None) -> np.ndarray:
    rows = request.path if request.trajectory is None else request.trajectory.positions
    assert rows is not None, "there is a path or a trajectory"
    return rows_in(rows[:most])


def _columns(request: CertifyRequest, robot: RobotModel) -> Columns:
    names = request.position_names
    if names is None:
        names = select(robot, request.group, request.tip, robot.rest, se3((0, 0, 0), (0, 0, 0, 1))).position_names
    return Columns.named("position_names", names, robot, POSITION_SUFFIXES)


def _group(request: CertifyRequest, columns: Columns, robot: RobotModel) -> str | list[str] | None:
    """The joints that move: those of the request, else those that have columns."""
    if request.group is not None or request.position_names is None:
        return request.group
    free = {joint.name for joint in robot.joints if joint.mimic is None}
    named = [name for name in columns.of if name in free]
    if not named:
        raise InvalidGroup("`position_names` has only joints that follow others: there is nothing that moves")
    return named


def _require_in_group(columns: Columns, group: PlanningGroup) -> None:
    moving = {joint.name for joint in group.joints}
    for joint in group.robot.joints:
        source = joint.name if joint.mimic is None else joint.mimic.source
        if joint.name in columns.of and joint.mimic is None and source not in moving:
            raise InvalidConfiguration(
                f"`position_names` has joint {joint.name!r}, which the group doesn't move; it moves"
                f" {', '.join(sorted(moving))}",
                joint=joint.name,
                available=sorted(moving),
            )


def _build_motion(
    request: CertifyRequest,
    given: GivenTrajectory | None,
    field: str,
    columns: Columns,
    rows: np.ndarray,
    group: PlanningGroup,
) -> tuple[SubmittedMotion, list[str]]:
    points, warnings = local_points(columns, rows, group, "path" if given is None else f"{field}.positions")
    if given is None:
        kept = np.flatnonzero(np.r_[True, (np.diff(points, axis=0) != 0.0).any(axis=1)])
        return SubmittedMotion(CurveKind.LINEAR, points[kept], _with_end(kept, len(points))), warnings
    times = _times(request, given)
    rates = _rates(request, given.velocities, f"{field}.velocities", columns, group, points)
    kept, odd = _select_rows(times, points, rates, field)
    warnings += odd
    given_points = points
    times, points, end = times[kept], points[kept], _with_end(kept, len(points))
    if rates is not None:
        motion = SubmittedMotion(CurveKind.HERMITE, points, end, times, rates[kept])
        accelerations = _accelerations(request, given, field, columns, group, given_points)
        if accelerations is not None and (motion.is_point or request.execution is not None):
            motion = dataclasses.replace(
                motion, accelerations=accelerations if motion.is_point else accelerations[kept]
            )
        return motion, warnings + ([] if accelerations is None else _other_accelerations(motion, accelerations[kept]))
    if request.interpolation == "linear":
        return SubmittedMotion(CurveKind.LINEAR, points, end, times), warnings
    return SubmittedMotion(CurveKind.SPLINE, points, end, times, spline_rates(times, points)), warnings


def _planned_motion(
    request: CertifyRequest, planned: GivenTrajectory, given: SubmittedMotion, columns: Columns, group: PlanningGroup
) -> SubmittedMotion:
    """Return the motion that was to be executed, by whole turns next to the one that is certified.

    Raises:
        InvalidConfiguration: if a joint has several coordinates, or a row has other columns than the certified motion.
    """
    if not group.is_euclidean:
        several = [joint.name for joint in group.joints if joint.nv > 1]
        raise InvalidConfiguration(
            f"`planned` is served for joints of one coordinate; {', '.join(several)} has several", joints=several
        )
    rows = rows_in(planned.positions)
    columns.require_width("planned.positions", rows)
    motion, _ = _build_motion(request, planned, "planned", columns, rows, group)
    turning = np.array([joint.kind is JointKind.CONTINUOUS for joint in group.joints])
    turns = np.where(turning, np.round((given.start - motion.start) / (2.0 * np.pi)), 0.0)
    return dataclasses.replace(motion, positions=cast(LocalPoints, motion.positions + 2.0 * np.pi * turns))


def _draw(planned: SubmittedMotion, execution: ControllerModel) -> DrawnMotion:
    given = planned.scheduled
    assert not isinstance(given, QuinticMotion), "rows that are given are cubic or straight"
    if execution.interpolation in READ_VELOCITIES and isinstance(given, StraightMotion):
        raise MalformedRequest(
            f"`execution.interpolation` {execution.interpolation.value!r} needs velocities, and the trajectory's"
            " `interpolation` 'linear' has none: leave it out",
            path="$.execution.interpolation",
        )
    return draw(given, planned.rows, execution, accelerations=planned.accelerations)


def _accelerations(
    request: CertifyRequest,
    given: GivenTrajectory,
    field: str,
    columns: Columns,
    group: PlanningGroup,
    points: LocalPoints,
) -> LocalRates | None:
    """Given accelerations at local coordinates (n, nv); None without, or where they aren't these coordinates'."""
    if not group.is_euclidean:
        return None
    return _rates(request, given.accelerations, f"{field}.accelerations", columns, group, points)


def _rates(
    request: CertifyRequest,
    given: list[list[float]] | None,
    field: str,
    columns: Columns,
    group: PlanningGroup,
    points: LocalPoints,
) -> LocalRates | None:
    """Rates at local coordinates (n, nv), from given velocities or accelerations; None without."""
    if given is None:
        return None
    names = request.velocity_names or velocity_names_of(columns, group.robot)
    named = Columns.named("velocity_names", names, group.robot, VELOCITY_SUFFIXES)
    require_same_joints(columns, named)
    rows = rows_in(given)
    named.require_width(field, rows)
    return local_rates(named, rows, group, points, field)


def _with_end(kept: np.ndarray, count: int) -> np.ndarray:
    """Rows of the request by knot: those kept, but for the end the last of its rows, which may repeat the end."""
    rows: np.ndarray = np.append(kept[:-1], count - 1)
    return rows


def _times(request: CertifyRequest, given: GivenTrajectory) -> np.ndarray:
    if given.times is not None:
        return np.array(given.times, float)
    assert request.time_step is not None, "a trajectory has times or a step"
    return request.time_step * np.arange(len(given.positions))


def _select_rows(
    times: np.ndarray, points: np.ndarray, rates: np.ndarray | None, field: str
) -> tuple[np.ndarray, list[str]]:
    """Choose one row of each time; warn about the others.

    Raises MalformedRequest if times don't increase, or two rows of one time differ.
    """
    steps = np.diff(times)
    same = (steps == 0.0) & (np.diff(points, axis=0) == 0.0).all(axis=1)
    if rates is not None:
        same &= (np.diff(rates, axis=0) == 0.0).all(axis=1)
    if len(wrong := np.flatnonzero(~same & ~(steps >= MIN_TIME_STEP))):
        row = int(wrong[0])
        how = "is the same, and the rows differ" if steps[row] == 0.0 else f"is less than {MIN_TIME_STEP:g} s later"
        raise MalformedRequest(
            f"`{field}.times` must increase: times[{row + 1}] = {times[row + 1]:.9g} after times[{row}] ="
            f" {times[row]:.9g} {how}",
            row=row + 1,
        )
    kept = np.flatnonzero(np.r_[True, ~same])
    if len(kept) == len(times):
        return kept, []
    return kept, [f"rows that repeat the one before, its time too, were left out: {len(times) - len(kept)}"]


def _other_accelerations(motion: SubmittedMotion, accelerations: np.ndarray) -> list[str]:
    """Warn where given accelerations (n, nv) are not those of the curve."""
    if motion.is_point or motion.times is None or motion.velocities is None:
        return []
    begins, ends = piece_accelerations(motion.times, motion.positions, motion.velocities)
    near = [
        np.abs(accelerations - mine) <= ACCELERATION_TOLERANCE * (1.0 + np.abs(mine))
        for mine in (np.vstack([begins, ends[-1:]]), np.vstack([begins[:1], ends]))
    ]
    if len(other := np.flatnonzero(~(near[0] | near[1]).all(axis=1))):
        row = int(motion.rows[other[0]])
        return [
            "`trajectory.accelerations` are not those of the cubic curve that is judged, first in row"
            f" {row}: a controller that follows them executes another one"
        ]
    return []
