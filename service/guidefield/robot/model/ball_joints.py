"""Ball joints, which URDF has no word for: floating joints that a robot card marks lose their translation."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import pinocchio as pin

from guidefield.errors import RobotInvalid
from guidefield.robot.model.frames import joint_indices
from guidefield.robot.model.replaced_joints import with_joints


def with_ball_joints(name: str, model: Any, marked: Collection[str]) -> Any:
    """The same Pinocchio model with marked joints as spherical ones; indices of joints and frames stay the same.

    Args:
        name: The robot's name, for errors.
        model: Pinocchio model, as parsed.
        marked: Names of floating joints that only turn.

    Raises:
        RobotInvalid: if a marked joint doesn't exist or isn't floating.
    """
    indices = joint_indices(model)
    for joint in marked:
        if joint not in indices:
            raise RobotInvalid(f"robot {name!r} has no joint {joint!r}, which its card marks as a ball", joint=joint)
        if model.joints[indices[joint]].shortname() != "JointModelFreeFlyer":
            raise RobotInvalid(f"robot {name!r}: joint {joint!r} is marked as a ball but isn't floating", joint=joint)
    return with_joints(model, {indices[joint]: pin.JointModelSpherical() for joint in marked})
