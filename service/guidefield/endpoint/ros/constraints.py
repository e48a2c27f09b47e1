"""Convert MoveIt's constraints to goals and path constraints of ours, never looser than the message allows.

A motion that reaches our goal, or keeps our path constraints, satisfies MoveIt's too. If a region has no exact
counterpart, a smaller one inside it is taken; the functions say which, and why it is inside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.endpoint.ros.collision_objects import primitive
from guidefield.endpoint.ros.refusals import FrameRefused, GoalRefused, Refused, number, placement, rotation, vector
from guidefield.endpoint.ros.snapshot import Snapshot
from guidefield.geometry.surfaces import wire_pose
from guidefield.messages.conditions import LineConstraint, OrientationCone, PathConstraint, PlaneConstraint
from guidefield.messages.scene import Box, Sphere
from guidefield.messages.values import JointSetGoal, JointsGoal, PoseGoal, Tolerance3, Vector3

EULER, ROTATION_VECTOR = 0, 1  # how an orientation's error is measured: intrinsic x, y, z angles, or a rotation vector
ANY_TURN = math.pi  # a tolerance from which on an angle is free [rad]; less would be looser than the message
MOST_REGIONS = 64  # regions of one position constraint, for each of which configurations are searched
FREE: Tolerance3 = (None, None, None)

Goal = JointsGoal | JointSetGoal | PoseGoal


@dataclass(frozen=True)
class RequestedGoal:
    """A goal of a request."""

    goal: Goal  # the goal; of several alternatives the first
    tip: str | None  # the frame that it is about; None: joints alone
    notes: tuple[str, ...] = ()  # sentences about values that were changed
    others: tuple[RequestedGoal, ...] = ()  # further alternatives, if some are poses, which our requests can't hold


def goal_of(constraints: Sequence[Any], group: Sequence[str], start: Snapshot) -> RequestedGoal:
    """Return the goal of a request: any one of its constraints, and of a position's regions.

    Raises Refused, with the name of the field, if they aren't served.
    """
    if not constraints:
        raise GoalRefused("`goal_constraints` is empty")
    goals = [
        goal
        for index, one in enumerate(constraints)
        for goal in _goals(one, group, start, f"goal_constraints[{index}]")
    ]
    notes = tuple(dict.fromkeys(note for one in goals for note in one.notes))
    positions = [one.goal.positions for one in goals if isinstance(one.goal, JointsGoal)]
    if len(goals) > 1 and len(positions) == len(goals):
        return RequestedGoal(JointSetGoal(positions), None, notes)
    return RequestedGoal(goals[0].goal, goals[0].tip, notes, tuple(goals[1:]))


def path_constraints_of(message: Any, group: Sequence[str], start: Snapshot) -> list[PathConstraint]:
    """Return path constraints of ours; raises Refused, with the name of the field, if one isn't served."""
    where = "path_constraints"
    _require_no_view(message, where)
    for index, one in enumerate(message.joint_constraints):
        at = f"{where}.joint_constraints[{index}]"
        lower, upper = _interval(one, group, start, at)
        least, most = start.robot.limits(one.joint_name)
        if lower > least or upper < most:
            raise GoalRefused(f"`{at}` isn't served: it is narrower than the joint's limits, {least:g} to {most:g}")
    found: list[PathConstraint] = []
    for index, one in enumerate(message.position_constraints):
        found += _kept_region(one, group, start, f"{where}.position_constraints[{index}]")
    for index, one in enumerate(message.orientation_constraints):
        found += _kept_orientation(one, group, start, f"{where}.orientation_constraints[{index}]")
    return found


def _goals(message: Any, group: Sequence[str], start: Snapshot, where: str) -> list[RequestedGoal]:
    _require_no_view(message, where)
    positions, turns = message.position_constraints, message.orientation_constraints
    if message.joint_constraints:
        if positions or turns:
            raise GoalRefused(f"`{where}` has joint_constraints beside others: give either")
        return [_joint_goal(message.joint_constraints, group, start, where)]
    if len(positions) > 1 or len(turns) > 1:
        many = "position_constraints" if len(positions) > 1 else "orientation_constraints"
        raise GoalRefused(f"`{where}.{many}`: one is served, got {len(getattr(message, many))}")
    if not positions and not turns:
        raise GoalRefused(f"`{where}` has no constraints")
    if positions and turns and positions[0].link_name != turns[0].link_name:
        raise GoalRefused(f"`{where}`: position and orientation must be of one link")
    return _pose_goals(positions[0] if positions else None, turns[0] if turns else None, group, start, where)


def _joint_goal(constraints: Sequence[Any], group: Sequence[str], start: Snapshot, where: str) -> RequestedGoal:
    """Return each joint's position, brought within its limits as MoveIt does; other joints stay as at the start."""
    positions, notes = {}, []
    for index, one in enumerate(constraints):
        at = f"{where}.joint_constraints[{index}]"
        lower, upper = _interval(one, group, start, at)
        least, most = start.robot.limits(one.joint_name)
        value = float(np.clip(one.position, least, most))
        if not lower <= value <= upper:
            notes.append(f"`{at}` is beyond the limits of {one.joint_name}; taken is {value:g}")
        positions[one.joint_name] = value
    return RequestedGoal(JointsGoal(dict(positions)), None, tuple(notes))


def _interval(one: Any, group: Sequence[str], start: Snapshot, at: str) -> tuple[float, float]:
    if one.joint_name not in start.robot.joints:
        raise GoalRefused(
            f"`{at}.joint_name` {one.joint_name[:64]!r} is no joint of {start.robot.name} that can be set"
        )
    if one.joint_name not in group:
        raise GoalRefused(f"`{at}.joint_name` {one.joint_name!r} isn't in the group: {', '.join(group)}")
    position, above, below = (
        number(getattr(one, name), f"{at}.{name}", GoalRefused)
        for name in ("position", "tolerance_above", "tolerance_below")
    )
    for name, tolerance in (("tolerance_above", above), ("tolerance_below", below)):
        if tolerance < 0.0:
            raise GoalRefused(f"`{at}.{name}` must not be negative, got {tolerance}")
    return position - below, position + above


def _pose_goals(position: Any, turn: Any, group: Sequence[str], start: Snapshot, where: str) -> list[RequestedGoal]:
    link = (position or turn).link_name
    _link(link, start, where)
    R_world_goal, turned = np.eye(3), FREE
    if turn is not None:
        R_world_goal, turned = _turn_goal(turn, group, start, f"{where}.orientation_constraints[0]")
    if position is None:
        at, quaternion = wire_pose(pin.SE3(R_world_goal, np.zeros(3)))
        return [RequestedGoal(PoseGoal(at, quaternion, FREE, turned), link)]
    field = f"{where}.position_constraints[0]"
    offset = vector(position.target_point_offset, f"{field}.target_point_offset")
    goals = []
    for there, shape in _volumes(position, group, start, field):
        axes = there.rotation if turn is None else R_world_goal
        half, within, lever = _half_sizes(shape), turned, np.zeros(3)
        if np.any(offset != 0.0):
            half, within = _with_lever(float(np.linalg.norm(offset)), half, turned, field)
            lever = axes @ offset
        at, quaternion = wire_pose(pin.SE3(axes, there.translation - lever))
        goals.append(RequestedGoal(PoseGoal(at, quaternion, _inside(half, axes.T @ there.rotation), within), link))
    return goals


def _with_lever(length: float, half: np.ndarray, turned: Tolerance3, at: str) -> tuple[np.ndarray, Tolerance3]:
    """Shrink a region's half sizes (3,) and a link's rotation tolerances so that a point of the link stays in it.

    The box for the link's origin is the region moved by the point's offset at the wanted rotation. If the link is
    rotated from that by an angle, the point moves by at most 2 sin(angle / 2) times its distance `length` from the
    origin; a rotation vector within the tolerances is at most as long as their norm. So the box loses this on every
    side; if that were more than half of the least half size, the tolerances shrink until it isn't.
    """
    bounds = [tolerance for tolerance in turned if tolerance is not None]
    if len(bounds) < len(turned):
        raise GoalRefused(
            f"`{at}.target_point_offset` is served beside an orientation constraint that bounds all three angles; or "
            "name an existing link"
        )
    room, angle = 0.5 * float(np.min(half)), math.hypot(*bounds)
    moved = 2.0 * length * math.sin(min(angle, math.pi) / 2.0)
    if moved > room:
        share = 2.0 * math.asin(room / (2.0 * length)) / angle
        moved, (x, y, z) = room, (share * tolerance for tolerance in bounds)
        return half - moved, (x, y, z)
    return half - moved, turned


def _inside(half: np.ndarray, turned: np.ndarray) -> Tolerance3:
    """Return half sizes along the goal's axes of a box inside a rotated one; exact if the axes agree.

    With the same axes in another order the half sizes change places. Else it is a cube, whose corners are sqrt(3) times
    its half side from the middle.
    """
    axes = np.abs(turned)
    if np.allclose(axes, np.round(axes), rtol=0.0, atol=1e-12):
        a, b, c = (np.round(axes) @ half).tolist()
        return a, b, c
    side = float(np.min(half)) / math.sqrt(3.0)
    return side, side, side


def _turn_goal(turn: Any, group: Sequence[str], start: Snapshot, at: str) -> tuple[np.ndarray, Tolerance3]:
    """Return the wanted rotation in the world, and the tolerance of the rotation vector r from it.

    A rotation vector's tolerances are taken unchanged. Euler angles are at most the angle of the whole rotation, up
    to a quarter turn: so it is a cube of rotation vectors whose longest is as long as the least tolerance. If the angle
    about z is free, the other two are at most the tilt of z, and 1 - cos of that is at most (r_x^2 + r_y^2) / 2: so it
    is a square for r_x and r_y.
    """
    wanted, tolerances = _turn(turn, group, start, at)
    if min(tolerances) >= ANY_TURN:
        return wanted, FREE
    if turn.parameterization == ROTATION_VECTOR:
        x, y, z = (None if tolerance >= ANY_TURN else tolerance for tolerance in tolerances)
        return wanted, (x, y, z)
    if tolerances[2] >= ANY_TURN:
        square = math.sqrt(2.0) * math.sin(min(*tolerances[:2], math.pi / 2) / 2.0)
        return wanted, (square, square, None)
    side = min(*tolerances, math.pi / 2) / math.sqrt(3.0)
    return wanted, (side, side, side)


def _turn(turn: Any, group: Sequence[str], start: Snapshot, at: str) -> tuple[np.ndarray, tuple[float, float, float]]:
    _link(turn.link_name, start, at)
    if turn.parameterization not in (EULER, ROTATION_VECTOR):
        raise GoalRefused(f"`{at}.parameterization` {turn.parameterization} is unknown")
    frame = _fixed_frame(turn.header.frame_id, group, start, f"{at}.header.frame_id")
    names = [f"absolute_{axis}_axis_tolerance" for axis in "xyz"]
    x, y, z = (number(getattr(turn, name), f"{at}.{name}", GoalRefused) for name in names)
    for name, tolerance in zip(names, (x, y, z), strict=True):
        if tolerance < 0.0:
            raise GoalRefused(f"`{at}.{name}` must not be negative, got {tolerance}")
    return frame.rotation @ rotation(turn.orientation, f"{at}.orientation"), (x, y, z)


def _half_sizes(shape: Any) -> np.ndarray:
    """Return half sizes (3,) of a box inside a volume: the box itself, in a sphere a cube, in a cylinder a prism."""
    if isinstance(shape, Box):
        return np.array(shape.size) / 2.0
    if isinstance(shape, Sphere):
        return np.full(3, shape.radius / math.sqrt(3.0))
    across = shape.radius / math.sqrt(2.0)
    return np.array([across, across, shape.length / 2.0])


def _volumes(one: Any, group: Sequence[str], start: Snapshot, at: str) -> list[tuple[Any, Any]]:
    """Return the alternative volumes of a PositionConstraint, each behind its place in the world, pinocchio.SE3."""
    _link(one.link_name, start, at)
    region = one.constraint_region
    if region.meshes:
        raise GoalRefused(f"`{at}.constraint_region.meshes` isn't served: give primitives")
    if not region.primitives or len(region.primitives) != len(region.primitive_poses):
        raise GoalRefused(
            f"`{at}.constraint_region` must have as many `primitive_poses` as `primitives`, and at least one, got"
            f" {len(region.primitive_poses)} and {len(region.primitives)}"
        )
    if len(region.primitives) > MOST_REGIONS:
        raise GoalRefused(
            f"`{at}.constraint_region.primitives`: at most {MOST_REGIONS} are served, got {len(region.primitives)}"
        )
    frame = _fixed_frame(one.header.frame_id, group, start, f"{at}.header.frame_id")
    found = []
    for index, (each, pose) in enumerate(zip(region.primitives, region.primitive_poses, strict=True)):
        try:
            shape = primitive(each, f"{at}.constraint_region.primitives[{index}]")
        except Refused as refused:
            raise GoalRefused(refused.message) from None
        found.append((frame * placement(pose, f"{at}.constraint_region.primitive_poses[{index}]"), shape))
    return found


def _kept_region(one: Any, group: Sequence[str], start: Snapshot, at: str) -> list[PathConstraint]:
    """Return constraints that keep a link's origin in a region.

    For a box they are planes, for a cylinder a line and a plane, exactly; for a sphere the planes of the cube inside.
    """
    if np.any(vector(one.target_point_offset, f"{at}.target_point_offset") != 0.0):
        raise GoalRefused(f"`{at}.target_point_offset` isn't served along the path: name an existing link")
    (pose, shape), *others = _volumes(one, group, start, at)
    if others:
        raise GoalRefused(f"`{at}.constraint_region`: along the path one region is served, got {1 + len(others)}")
    point = _triple(pose.translation)
    axes = [_triple(pose.rotation[:, axis]) for axis in range(3)]
    if isinstance(shape, Box | Sphere):
        sizes = _half_sizes(shape).tolist()
        return [PlaneConstraint(one.link_name, point, axis, size) for axis, size in zip(axes, sizes, strict=True)]
    return [
        LineConstraint(one.link_name, point, axes[2], shape.radius),
        PlaneConstraint(one.link_name, point, axes[2], shape.length / 2.0),
    ]


def _kept_orientation(turn: Any, group: Sequence[str], start: Snapshot, at: str) -> list[PathConstraint]:
    """Return cones for the axes of a link.

    If the angle about the link's z is free, it is the cone of this axis whose half angle is the smaller tolerance of
    the other two: within it both Euler angles are at most that. If none is free, they are two cones, of the axes z and
    x: if each deviates by at most h, the whole rotation is at most 2 asin(sqrt(2) sin(h / 2)), because the sum of
    1 - cos of both is at least 1 - cos of the rotation; and every angle, Euler's or a rotation vector's, is at most the
    rotation's.
    """
    wanted, tolerances = _turn(turn, group, start, at)
    if min(tolerances) >= ANY_TURN:
        return []
    x, z = _triple(wanted[:, 0]), _triple(wanted[:, 2])
    across, about = min(tolerances[:2]), tolerances[2]
    if about >= ANY_TURN:
        if turn.parameterization != EULER:
            raise GoalRefused(f"`{at}`: a free angle is served where `parameterization` is XYZ_EULER_ANGLES")
        _require_open(across, at)
        return [OrientationCone(turn.link_name, (0.0, 0.0, 1.0), z, min(across, math.pi / 2))]
    if max(tolerances) >= ANY_TURN:
        raise GoalRefused(f"`{at}`: of the three angles only that about the link's z is served as a free one")
    least = min(across, about, math.pi / 2)
    _require_open(least, at)
    half = 2.0 * math.asin(math.sin(least / 2.0) / math.sqrt(2.0))
    return [
        OrientationCone(turn.link_name, (0.0, 0.0, 1.0), z, half),
        OrientationCone(turn.link_name, (1.0, 0.0, 0.0), x, half),
    ]


def _require_open(tolerance: float, at: str) -> None:
    if tolerance <= 0.0:
        raise GoalRefused(f"`{at}`: the tolerances of a path constraint must be positive")


def _fixed_frame(frame: str, group: Sequence[str], start: Snapshot, field: str) -> Any:
    """Return a frame's place in the world, pinocchio.SE3; raises Refused if it moves with the group."""
    there, link = start.frame(frame, field)
    if link is not None and start.robot.moves(link, group):
        raise FrameRefused(
            f"`{field}` {frame[:64]!r} moves with the group: a constraint in a frame that moves isn't served"
        )
    return there


def _link(name: str, start: Snapshot, where: str) -> str:
    return start.robot.require_link(name, f"{where}.link_name")


def _require_no_view(message: Any, where: str) -> None:
    if message.visibility_constraints:
        raise GoalRefused(f"`{where}.visibility_constraints` isn't served")


def _triple(values: np.ndarray) -> Vector3:
    x, y, z = values.tolist()
    return x, y, z
