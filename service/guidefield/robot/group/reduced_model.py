"""From a request's words to a planning group: which joints are planned, where the robot stands, what stands still."""

from __future__ import annotations

import dataclasses
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.errors import InvalidGroup
from guidefield.read_only import read_only
from guidefield.robot.group.alike import Alike
from guidefield.robot.group.group import PlanningGroup, reference_of
from guidefield.robot.model.followers import expansion
from guidefield.robot.model.frames import frame_index
from guidefield.robot.model.groups import joints_to
from guidefield.robot.model.model import Joint, RobotModel
from guidefield.robot.model.spaces import RobotConfiguration

_RENAMED = "link of joint "
"""Before the names of links that share theirs with a joint, while a model is reduced."""


def select(
    robot: RobotModel,
    group: str | Sequence[str] | None,
    tip: str | None,
    q_reference: RobotConfiguration,
    placement: Any,
) -> PlanningGroup:
    """Reduce a robot to the joints that are planned for.

    Args:
        robot: The robot.
        group: Joint names, the name of a group, or None for every joint between the root and the tip.
        tip: Frame that goals are about; None for the robot's own.
        q_reference: Configuration of the whole robot, shape (robot.model.nq,); joints outside the group keep it.
        placement: Placement of the robot's root in the world, pinocchio.SE3.

    Raises:
        InvalidGroup: if the group or a joint is unknown, or a joint can't be planned for.
        UnknownFrame: if the robot has no such tip.
    """
    tip = robot.tip if tip is None else tip
    robot.frame_id(tip)
    planned = _planned_joints(robot, group, tip)
    followers = {joint.name for joint in robot.joints if joint.mimic and joint.mimic.driver in planned}
    free = [joint for joint in robot.joints if joint.name in planned]
    # what moves has no part in how the models look, but for those that follow: `space` keeps them where they are
    standing = np.array(q_reference, float)
    for joint in free:
        standing[joint.idx_q : joint.idx_q + joint.nq] = 0.0
    known = _KNOWN.setdefault(robot, {})
    key = (planned, tip, standing.tobytes(), placement.homogeneous.tobytes())
    reduced = known.pop(key, None) or _reduce(robot, planned, followers, tip, q_reference, placement)
    known[key] = reduced
    while len(known) > MOST_KNOWN:
        del known[next(iter(known))]
    q_reference = np.array(q_reference, float)
    q_origin = q_reference[reduced["places"]]
    read_only(q_reference, q_origin)
    return PlanningGroup(robot=robot, tip=tip, q_reference=q_reference, q_origin=q_origin, **reduced)


MOST_KNOWN = 16
"""Groups of a robot whose models are kept, those asked for last: a sequence of ten steps goes back and forth between
as many."""

_KNOWN: weakref.WeakKeyDictionary[RobotModel, dict[tuple[Any, ...], dict[str, Any]]] = weakref.WeakKeyDictionary()


def _reduce(
    robot: RobotModel,
    planned: tuple[str, ...],
    followers: set[str],
    tip: str,
    q_reference: RobotConfiguration,
    placement: Any,
) -> dict[str, Any]:
    """What groups have in common that are alike, as `PlanningGroup` names it; but not the robot itself."""
    model, geometry = _placed(robot, placement)
    locked = [j.index for j in robot.joints if j.name not in planned and j.name not in followers]
    model, geometry = _reduced(model, geometry, locked, q_reference)
    space = model
    if followers:
        indices = [model.getJointId(name) for name in followers]
        space, _ = _reduced(model.copy(), geometry.copy(), indices, reference_of(model, robot, q_reference))
    joints = _regrouped(robot, space)
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
        "tip_id": _tip_index(model, tip),
        "alike": Alike(),
        **arrays,
    }


def _tip_index(model: Any, tip: str) -> int:
    index = frame_index(model, tip)
    assert index is not None, "the robot has the frame, so its reduced model has it"
    return index


def _planned_joints(robot: RobotModel, group: str | Sequence[str] | None, tip: str) -> tuple[str, ...]:
    """Names of the planned joints, in Pinocchio's order."""
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
        names = tuple(name for name in joints_to(robot.model, tip) if (j := robot.joint(name)) and j.mimic is None)
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
                f"joint {name!r} mimics {joint.mimic.driver!r} and can't be planned for by itself", joint=name
            )
    if not names:
        raise InvalidGroup(f"no joint moves {tip!r}: there is nothing to plan for", tip=tip)
    return tuple(joint.name for joint in robot.joints if joint.name in names)


def _placed(robot: RobotModel, placement: Any) -> tuple[Any, Any]:
    """Copies of the robot's models with its root at a placement in the world."""
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


def _reduced(model: Any, geometry: Any, locked: list[int], q_reference: np.ndarray) -> tuple[Any, Any]:
    """The models with some joints fixed.

    Pinocchio finds frames of joints, fixed ones too, by name alone: links that share one are called otherwise
    meanwhile.
    """
    if not locked:
        return model, geometry
    fixed = (frame.name for frame in model.frames if frame.type == pin.FrameType.FIXED_JOINT)
    joints = {*model.names, *fixed}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.name in joints:
            frame.name = f"{_RENAMED}{frame.name}"
    reduced: tuple[Any, Any] = pin.buildReducedModel(model, geometry, locked, q_reference)
    for frame in reduced[0].frames:
        frame.name = frame.name.removeprefix(_RENAMED)
    return reduced


def _regrouped(robot: RobotModel, space: Any) -> tuple[Joint, ...]:
    """The robot's joints with the indices that they have in the space of planned joints."""
    regrouped = []
    for index in range(1, space.njoints):
        joint, whole = space.joints[index], robot.joint(space.names[index])
        assert whole is not None, "a reduced model has the robot's joints"
        regrouped.append(dataclasses.replace(whole, index=index, idx_q=joint.idx_q, idx_v=joint.idx_v))
    return tuple(regrouped)
