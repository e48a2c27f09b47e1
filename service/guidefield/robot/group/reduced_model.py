"""Select a request's planning group: the joints that are planned, where the robot stands, and joints that stand still.

Which joints are planned where a request names none is what users rely on. Alike groups share their models, so `_reduce`
must not depend on where a group starts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from guidefield.errors import InvalidGroup, at_path
from guidefield.memo import MISSING, Answers
from guidefield.read_only import read_only
from guidefield.robot.group.group import Alike, PlanningGroup, reference_of, with_bound_rates
from guidefield.robot.model.joints import Joint, RobotConfiguration
from guidefield.robot.model.mimic_joints import expansion
from guidefield.robot.model.model import RobotModel, joint_indices, joints_to, lock_joints


def select(
    robot: RobotModel,
    group: str | Sequence[str] | None,
    tip: str | None,
    q_reference: RobotConfiguration,
    placement: Any,
) -> PlanningGroup:
    """Reduce a robot to the joints that are planned for.

    Args:
        group: Joint names, the name of a group, or None for every joint between the root and the tip; if none of these
            moves by itself, for the joints that they follow, or for every joint that moves.
        tip: Frame that goals are about; None for the robot's own.
        q_reference: Configuration of the whole robot, shape (robot.model.nq,); joints outside the group keep it.
        placement: Placement of the robot's root in the world, pinocchio.SE3.

    Raises:
        InvalidGroup: if the group or a joint is unknown, or a joint can't be planned for.
        UnknownFrame: if the robot has no such tip.
    """
    tip = robot.tip if tip is None else tip
    with at_path("$.tip"):
        robot.frame_id(tip)
    with at_path("$.group"):
        planned = _find_planned_joints(robot, group, tip)
    mimics = {joint.name for joint in robot.joints if joint.mimic and joint.mimic.source in planned}
    free = [joint for joint in robot.joints if joint.name in planned]
    # what moves has no part in how the models look, but for those that follow: `space` keeps them where they are
    standing = np.array(q_reference, float)
    for joint in free:
        standing[joint.idx_q : joint.idx_q + joint.nq] = 0.0
    key = (planned, tip, standing.tobytes(), placement.homogeneous.tobytes())
    reduced = _REDUCED.of(robot, key)
    if reduced is MISSING:
        reduced = _REDUCED.keep(robot, key, _reduce(robot, planned, mimics, tip, q_reference, placement))
    q_reference = np.array(q_reference, float)
    q_origin = q_reference[reduced["places"]]
    read_only(q_reference, q_origin)
    return PlanningGroup(robot=robot, tip=tip, q_reference=q_reference, q_origin=q_origin, **reduced)


_REDUCED = Answers[dict[str, Any]]()
"""Results of `_reduce` by robot: a sequence of steps goes back and forth between its groups."""


def _reduce(
    robot: RobotModel,
    planned: tuple[str, ...],
    mimics: set[str],
    tip: str,
    q_reference: RobotConfiguration,
    placement: Any,
) -> dict[str, Any]:
    """Make the fields of `PlanningGroup` that alike groups share, but for the robot itself."""
    model, geometry = _place_models(robot, placement)
    locked = [j.index for j in robot.joints if j.name not in planned and j.name not in mimics]
    model, geometry = lock_joints(model, geometry, locked, q_reference)
    space = model
    if mimics:
        indices = [index for name, index in joint_indices(model).items() if name in mimics]
        space, _ = lock_joints(model, geometry, indices, reference_of(model, robot, q_reference))
    joints = with_bound_rates(_regroup(robot, space), robot.joints)
    matrix, offset = expansion(robot.joints, model, space)
    arrays = {
        "lower": np.concatenate([j.lower for j in joints]),
        "upper": np.concatenate([j.upper for j in joints]),
        "velocity_limits": np.concatenate([j.velocity for j in joints]),
        "acceleration_limits": np.concatenate([j.acceleration for j in joints]),
        "expand_velocity": matrix,
        "expand_offset": offset,
        "places": reference_of(space, robot, np.arange(robot.model.nq)).astype(np.int64),
    }
    read_only(*arrays.values())
    return {
        "model": model,
        "geometry": geometry,
        "space": space,
        "joints": joints,
        "tip_id": robot.frame_id(tip),
        "alike": Alike(),
        **arrays,
    }


def _find_planned_joints(robot: RobotModel, group: str | Sequence[str] | None, tip: str) -> tuple[str, ...]:
    if isinstance(group, str):
        if group not in robot.groups:
            available = sorted(robot.groups)
            raise InvalidGroup(
                f"robot {robot.name!r} has no group {group!r}; it has {', '.join(available) or 'none'}",
                group=group,
                available=available,
            )
        names = robot.groups[group]
    elif group is not None:
        names = tuple(group)
    elif tip == robot.tip and "default" in robot.groups:
        names = robot.groups["default"]
    else:
        names = _default_joints(robot, tip)
    for name in names:
        joint = robot.joint(name)
        if joint is None:
            available = [j.name for j in robot.joints]
            raise InvalidGroup(
                f"robot {robot.name!r} has no movable joint {name!r}; it has {', '.join(available)}",
                joint=name,
                available=available,
            )
        if joint.mimic is not None:
            raise InvalidGroup(
                f"joint {name!r} mimics {joint.mimic.source!r} and can't be planned for by itself", joint=name
            )
    if not names:
        movable = [joint.name for joint in robot.joints if joint.mimic is None and _can_move(joint)]
        hint = f"; `group` may name some of {', '.join(movable)}" if movable else ", as no joint of the robot can move"
        reasons = _reasons_for_rest(robot, tip)
        why = f" ({'; '.join(reasons)})" if reasons else ""
        raise InvalidGroup(
            f"no joint moves {tip!r}{why}: there is nothing to plan for{hint}", tip=tip, available=movable
        )
    return tuple(joint.name for joint in robot.joints if joint.name in names)


def _default_joints(robot: RobotModel, tip: str) -> tuple[str, ...]:
    """Return the joints that are planned for where a request names none: those between the root and the tip.

    If none of them can move by itself, they are the source joints of those that are mimic joints. If nothing moves the
    robot's own tip, they are all joints that can move.
    """
    above = [joint for name in joints_to(robot.model, tip) if (joint := robot.joint(name)) is not None]
    own = [joint for joint in above if joint.is_driven]
    sources = [robot.joint(joint.mimic.source) for joint in above if joint.mimic is not None]
    everywhere = [joint for joint in robot.joints if joint.is_driven and _can_move(joint)] if tip == robot.tip else []
    for candidates in (own, sources, everywhere):
        if any(joint is not None and _can_move(joint) for joint in candidates):
            return tuple(joint.name for joint in candidates if joint is not None)
    return tuple(joint.name for joint in own)


def _reasons_for_rest(robot: RobotModel, tip: str) -> list[str]:
    """Reasons why the joints before a tip, none of which is planned for by itself, don't move it."""
    reasons = []
    for name in joints_to(robot.model, tip):
        joint = robot.joint(name)
        if joint is not None and joint.mimic is not None:
            source = robot.joint(joint.mimic.source)
            locked = source is not None and not _can_move(source)
            reasons.append(f"{name!r} mimics {joint.mimic.source!r}{', whose limits are the same' if locked else ''}")
        elif joint is not None and joint.passive:
            reasons.append(f"{name!r} is passive in the SRDF")
    return reasons


def _can_move(joint: Joint) -> bool:
    return not np.array_equal(joint.lower, joint.upper)


def _place_models(robot: RobotModel, placement: Any) -> tuple[Any, Any]:
    model, geometry = robot.model.copy(), robot.geometry.copy()
    for index in range(1, model.njoints):
        if model.parents[index] == 0:
            model.jointPlacements[index] = placement * model.jointPlacements[index]
    for frame in list(model.frames)[1:]:
        if frame.parentJoint == 0:
            frame.placement = placement * frame.placement
    for shape in geometry.geometryObjects:
        if shape.parentJoint == 0:
            shape.placement = placement * shape.placement
    return model, geometry


def _regroup(robot: RobotModel, space: Any) -> tuple[Joint, ...]:
    regrouped = []
    for index in range(1, space.njoints):
        joint, whole = space.joints[index], robot.joint(space.names[index])
        assert whole is not None, "a reduced model has the robot's joints"
        regrouped.append(dataclasses.replace(whole, index=index, idx_q=joint.idx_q, idx_v=joint.idx_v))
    return tuple(regrouped)
