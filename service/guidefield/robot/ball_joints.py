"""Ball joints, which URDF has no word for: floating joints that a robot card marks lose their translation."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import pinocchio as pin

from guidefield.errors import RobotInvalid


def with_ball_joints(name: str, model: Any, marked: Collection[str]) -> Any:
    """The same Pinocchio model with marked joints as spherical ones; indices of joints and frames stay the same.

    Args:
        name: The robot's name, for errors.
        model: Pinocchio model, as parsed.
        marked: Names of floating joints that only turn.

    Raises:
        RobotInvalid: if a marked joint doesn't exist or isn't floating.
    """
    for joint in marked:
        if not model.existJointName(joint):
            raise RobotInvalid(f"robot {name!r} has no joint {joint!r}, which its card marks as a ball", joint=joint)
        if model.joints[model.getJointId(joint)].shortname() != "JointModelFreeFlyer":
            raise RobotInvalid(f"robot {name!r}: joint {joint!r} is marked as a ball but isn't floating", joint=joint)
    if not marked:
        return model
    balled = pin.Model()
    balled.name = model.name
    for index in range(1, model.njoints):
        kind = pin.JointModelSpherical() if model.names[index] in marked else model.joints[index].extract()
        copied = balled.addJoint(model.parents[index], kind, model.jointPlacements[index], model.names[index])
        balled.appendBodyToJoint(copied, model.inertias[index], pin.SE3.Identity())
        _copy_limits(model, model.joints[index], balled, balled.joints[copied])
    for frame in list(model.frames)[1:]:
        balled.addFrame(frame, False)
    return balled


def _copy_limits(source: Any, joint: Any, target: Any, copied: Any) -> None:
    """Limits of a joint that stays what it is; a ball joint has none."""
    if joint.nq != copied.nq:
        return
    at_q, to_q = slice(joint.idx_q, joint.idx_q + joint.nq), slice(copied.idx_q, copied.idx_q + copied.nq)
    at_v, to_v = slice(joint.idx_v, joint.idx_v + joint.nv), slice(copied.idx_v, copied.idx_v + copied.nv)
    for limits in ("lowerPositionLimit", "upperPositionLimit"):
        values = getattr(target, limits)
        values[to_q] = getattr(source, limits)[at_q]
        setattr(target, limits, values)
    velocity = target.velocityLimit
    velocity[to_v] = source.velocityLimit[at_v]
    target.velocityLimit = velocity
