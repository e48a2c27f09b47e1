"""MoveIt's constraints as goals and path constraints of ours.

What is asked for here is never looser than what the message allows: whatever reaches the goal, or keeps the path
constraints, satisfies MoveIt's too. Where a region has no exact counterpart the largest one inside it is taken whose
proof is short; the functions say which.
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
from guidefield.geometry.placements import wire_pose
from guidefield.messages.conditions import LineConstraint, OrientationCone, PathConstraint, PlaneConstraint
from guidefield.messages.goals import JointSetGoal, JointsGoal, PoseGoal, Tolerance3
from guidefield.messages.scene import Box, Sphere
from guidefield.messages.values import Vector3

EULER, ROTATION_VECTOR = 0, 1  # how an orientation's error is measured: intrinsic x, y, z angles, or a rotation vector
ANY_TURN = math.pi  # a tolerance of so much leaves an angle free [rad]
MOST_REGIONS = 64  # of one position constraint: for each of them configurations are looked for
FREE: Tolerance3 = (None, None, None)

Goal = JointsGoal | JointSetGoal | PoseGoal


@dataclass(frozen=True)
class AskedGoal:
    """A goal, the frame that it is about (None: joints alone), and what to tell of it."""

    goal: Goal  # the goal; where there are several, the first of them
    tip: str | None  # the frame
    notes: tuple[str, ...] = ()  # what was read otherwise than it stands there
    # the other ones where any of several will do and some are poses, which our requests don't have
    others: tuple[AskedGoal, ...] = ()


def goal_of(constraints: Sequence[Any], group: Sequence[str], start: Snapshot) -> AskedGoal:
    """The goal of a request: any one of its constraints, and of a position's regions.

    Raises Refused if they aren't served; names the field.
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
        return AskedGoal(JointSetGoal(positions), None, notes)
    return AskedGoal(goals[0].goal, goals[0].tip, notes, tuple(goals[1:]))


def path_constraints_of(message: Any, group: Sequence[str], start: Snapshot) -> list[PathConstraint]:
    """What frames have to keep all along; raises Refused if it isn't served; names the field."""
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


def _goals(message: Any, group: Sequence[str], start: Snapshot, where: str) -> list[AskedGoal]:
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


def _joint_goal(constraints: Sequence[Any], group: Sequence[str], start: Snapshot, where: str) -> AskedGoal:
    """Each joint's position, brought within its limits as MoveIt does; other joints stay as at the start."""
    positions, notes = {}, []
    for index, one in enumerate(constraints):
        at = f"{where}.joint_constraints[{index}]"
        lower, upper = _interval(one, group, start, at)
        least, most = start.robot.limits(one.joint_name)
        value = float(np.clip(one.position, least, most))
        if not lower <= value <= upper:
            notes.append(f"`{at}` is beyond the limits of {one.joint_name}; taken is {value:g}")
        positions[one.joint_name] = value
    return AskedGoal(JointsGoal(dict(positions)), None, tuple(notes))


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


def _pose_goals(position: Any, turn: Any, group: Sequence[str], start: Snapshot, where: str) -> list[AskedGoal]:
    link = (position or turn).link_name
    _link(link, start, where)
    R_world_goal, turned = np.eye(3), FREE
    if turn is not None:
        R_world_goal, turned = _turn_goal(turn, group, start, f"{where}.orientation_constraints[0]")
    if position is None:
        at, quaternion = wire_pose(pin.SE3(R_world_goal, np.zeros(3)))
        return [AskedGoal(PoseGoal(at, quaternion, FREE, turned), link)]
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
        goals.append(AskedGoal(PoseGoal(at, quaternion, _inside(half, axes.T @ there.rotation), within), link))
    return goals


def _with_lever(length: float, half: np.ndarray, turned: Tolerance3, at: str) -> tuple[np.ndarray, Tolerance3]:
    """Half sizes of a box for a link's origin, and tolerances of its rotation, so that a point of it stays in a region.

    The origin's box is the region moved by the point's offset at the wanted rotation. Where the link is turned by an
    angle from that, the point moves by at most 2 sin(angle / 2) times its distance from the origin; a rotation vector
    within the tolerances is at most as long as both together. So the box loses this on every side, and where that
    would be more than half of the least half size, the tolerances shrink until it is as much.
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
    """Half sizes along the goal's axes of a box inside one that is turned so to them; exact where the axes agree.

    With the same axes in another order the half sizes change places. Else a cube: its corners are at most sqrt(3) times
    its half side from the middle.
    """
    axes = np.abs(turned)
    if np.allclose(axes, np.round(axes), rtol=0.0, atol=1e-12):
        a, b, c = (np.round(axes) @ half).tolist()
        return a, b, c
    side = float(np.min(half)) / math.sqrt(3.0)
    return side, side, side


def _turn_goal(turn: Any, group: Sequence[str], start: Snapshot, at: str) -> tuple[np.ndarray, Tolerance3]:
    """The wanted rotation in the world, and the tolerance of the rotation vector r from it.

    A rotation vector's tolerances are taken unchanged. Euler angles are at most the angle of the whole rotation, up
    to a quarter turn: so a cube of rotation vectors whose longest is as long as the least tolerance. Where the angle
    about z is free, the other two are at most the tilt of z, and 1 - cos of that is at most (r_x^2 + r_y^2) / 2: so a
    square for r_x and r_y.
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
    frame = _fixed(turn.header.frame_id, group, start, f"{at}.header.frame_id")
    names = [f"absolute_{axis}_axis_tolerance" for axis in "xyz"]
    x, y, z = (number(getattr(turn, name), f"{at}.{name}", GoalRefused) for name in names)
    for name, tolerance in zip(names, (x, y, z), strict=True):
        if tolerance < 0.0:
            raise GoalRefused(f"`{at}.{name}` must not be negative, got {tolerance}")
    return frame.rotation @ rotation(turn.orientation, f"{at}.orientation"), (x, y, z)


def _half_sizes(shape: Any) -> np.ndarray:
    """The half sizes (3,) of the largest box known inside a volume: a box's own, of a ball a cube's, a prism's else."""
    if isinstance(shape, Box):
        return np.array(shape.size) / 2.0
    if isinstance(shape, Sphere):
        return np.full(3, shape.radius / math.sqrt(3.0))
    across = shape.radius / math.sqrt(2.0)
    return np.array([across, across, shape.length / 2.0])


def _volumes(one: Any, group: Sequence[str], start: Snapshot, at: str) -> list[tuple[Any, Any]]:
    """The volumes of a PositionConstraint, of which any one will do, and where each is in the world."""
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
    frame = _fixed(one.header.frame_id, group, start, f"{at}.header.frame_id")
    found = []
    for index, (each, pose) in enumerate(zip(region.primitives, region.primitive_poses, strict=True)):
        try:
            shape = primitive(each, f"{at}.constraint_region.primitives[{index}]")
        except Refused as refused:
            raise GoalRefused(refused.message) from None
        found.append((frame * placement(pose, f"{at}.constraint_region.primitive_poses[{index}]"), shape))
    return found


def _kept_region(one: Any, group: Sequence[str], start: Snapshot, at: str) -> list[PathConstraint]:
    """A region that a link's origin stays in.

    Planes for a box, a line and a plane for a cylinder, exactly; for a ball the planes of the cube inside.
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
    """Cones for the axes of a link.

    With one angle free, about the link's z, the cone of this axis whose half angle is the lesser tolerance of the other
    two: within it both Euler angles are at most that. With none free two cones, of the axes z and x: where each
    strays by at most h, the whole rotation is at most 2 asin(sqrt(2) sin(h / 2)), for the sum of 1 - cos of both is at
    least 1 - cos of the rotation; and every angle, Euler's or a rotation vector's, is at most the rotation's.
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


def _fixed(frame: str, group: Sequence[str], start: Snapshot, field: str) -> Any:
    """Where a frame is in the world, pinocchio.SE3, if it stands still while the group moves."""
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
