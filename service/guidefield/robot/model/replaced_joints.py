"""A Pinocchio model with some of its joints replaced by others; the indices of joints and frames stay the same."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pinocchio as pin


def with_joints(model: Any, replacements: Mapping[str, Any]) -> Any:
    """The same Pinocchio model with other joints.

    Limits are kept where a joint has as many values as before; what replaces another has no limits of positions else.

    Args:
        model: Pinocchio model.
        replacements: Pinocchio's joint model that takes the place of each joint of that name.
    """
    if not replacements:
        return model
    made = pin.Model()
    made.name = model.name
    for index in range(1, model.njoints):
        joint = replacements.get(model.names[index]) or model.joints[index].extract()
        copied = made.addJoint(model.parents[index], joint, model.jointPlacements[index], model.names[index])
        made.appendBodyToJoint(copied, model.inertias[index], pin.SE3.Identity())
        _copy_limits(model, model.joints[index], made, made.joints[copied])
    for frame in list(model.frames)[1:]:
        made.addFrame(frame, False)
    return made


def _copy_limits(source: Any, joint: Any, target: Any, copied: Any) -> None:
    at_q, to_q = slice(joint.idx_q, joint.idx_q + joint.nq), slice(copied.idx_q, copied.idx_q + copied.nq)
    at_v, to_v = slice(joint.idx_v, joint.idx_v + joint.nv), slice(copied.idx_v, copied.idx_v + copied.nv)
    for name, none in (("lowerPositionLimit", -math.inf), ("upperPositionLimit", math.inf)):
        limits = getattr(target, name)
        limits[to_q] = getattr(source, name)[at_q] if joint.nq == copied.nq else none
        setattr(target, name, limits)
    for name in ("lowerVelocityLimit", "upperVelocityLimit"):
        limits = getattr(target, name)
        limits[to_v] = getattr(source, name)[at_v] if joint.nv == copied.nv else math.inf
        setattr(target, name, limits)
