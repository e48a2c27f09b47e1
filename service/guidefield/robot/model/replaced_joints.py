"""Pinocchio models with joints replaced or locked, by their indices alone; ball joints that a card marks."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.errors import RobotInvalid
from guidefield.robot.model.model import joint_indices


def with_joints(model: Any, replacements: Mapping[int, Any]) -> Any:
    """Return the same Pinocchio model with joints replaced by index; the indices of joints and frames stay the same.

    Limits are kept where a joint has as many values as before; what replaces another has no limits of positions else.
    """
    if not replacements:
        return model
    made, _ = _rebuild(model, replacements, (), pin.neutral(model))
    return made


def lock_joints(model: Any, geometry: Any, locked: Collection[int], q: np.ndarray) -> tuple[Any, Any]:
    """Return the models with some joints, by index, fixed at a configuration, shape (model.nq,).

    Frames keep their indices and names; joints keep their order. `pinocchio.buildReducedModel` does the same, but finds
    frames by name.
    """
    if not locked:
        return model, geometry
    made, places = _rebuild(model, {}, locked, q)
    reduced = geometry.copy()
    for shape in reduced.geometryObjects:
        carrier, offset = places[shape.parentJoint]
        shape.parentJoint, shape.placement = carrier, offset * shape.placement
    return made, reduced


def _rebuild(
    model: Any, replacements: Mapping[int, Any], locked: Collection[int], q: np.ndarray
) -> tuple[Any, list[tuple[int, Any]]]:
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    made = pin.Model()
    made.name = model.name
    kept: list[tuple[Any, Any]] = []
    places: list[tuple[int, Any]] = [(0, pin.SE3.Identity())]
    for index in range(1, model.njoints):
        carrier, offset = places[model.parents[index]]
        if index in locked:
            places.append((carrier, offset * data.liMi[index]))
        else:
            joint = replacements.get(index) or model.joints[index].extract()
            carrier = made.addJoint(carrier, joint, offset * model.jointPlacements[index], model.names[index])
            kept.append((model.joints[index], made.joints[carrier]))
            places.append((carrier, pin.SE3.Identity()))
        made.appendBodyToJoint(places[index][0], model.inertias[index], places[index][1])
    for number, frame in enumerate(list(model.frames)[1:]):
        carrier, offset = places[frame.parentJoint]
        # under a name of its own, as Pinocchio merges frames that share name and type
        copied = pin.Frame(f"frame {number}", carrier, frame.parentFrame, offset * frame.placement, frame.type)
        made.frames[made.addFrame(copied, False)].name = frame.name
    _copy_limits(model, made, kept)
    return made, places


def _copy_limits(source: Any, target: Any, kept: Sequence[tuple[Any, Any]]) -> None:
    for name, none in (("lowerPositionLimit", -math.inf), ("upperPositionLimit", math.inf)):
        limits = getattr(source, name)
        parts = [
            limits[joint.idx_q : joint.idx_q + joint.nq] if joint.nq == copied.nq else np.full(copied.nq, none)
            for joint, copied in kept
        ]
        setattr(target, name, np.concatenate([np.empty(0), *parts]))
    for name in ("lowerVelocityLimit", "upperVelocityLimit", "lowerEffortLimit", "upperEffortLimit"):
        limits, none = getattr(source, name), -math.inf if name == "lowerEffortLimit" else math.inf
        parts = [
            limits[joint.idx_v : joint.idx_v + joint.nv] if joint.nv == copied.nv else np.full(copied.nv, none)
            for joint, copied in kept
        ]
        setattr(target, name, np.concatenate([np.empty(0), *parts]))


def with_ball_joints(name: str, model: Any, marked: Collection[str]) -> Any:
    """Replace marked floating joints, which only turn, by spherical ones in a Pinocchio model; indices stay the same.

    RobotInvalid if a marked joint doesn't exist or isn't floating.
    """
    indices = joint_indices(model)
    for joint in marked:
        if joint not in indices:
            raise RobotInvalid(f"robot {name!r} has no joint {joint!r}, which its card marks as a ball", joint=joint)
        if model.joints[indices[joint]].shortname() != "JointModelFreeFlyer":
            raise RobotInvalid(f"robot {name!r}: joint {joint!r} is marked as a ball but isn't floating", joint=joint)
    return with_joints(model, {indices[joint]: pin.JointModelSpherical() for joint in marked})
