"""The limits of joints that follow others, as limits of the joints they follow: these alone are planned for."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from guidefield.errors import RobotInvalid
from guidefield.robot.model import Joint, JointKind

LIMITED = (JointKind.REVOLUTE, JointKind.PRISMATIC)
ROUNDING = 1e-6
"""A range that a follower narrows by less is left as it is [rad or m]: limits are written with few digits."""


def narrowed(name: str, joints: Sequence[Joint], warnings: list[str]) -> tuple[Joint, ...]:
    """The same joints; those that others follow only go where their followers stay within their own limits.

    A follower whose limits can't be kept so has none: a plan must not be refused for what no joint can be blamed for.

    Args:
        name: The robot's name, for errors.
        joints: Movable joints.
        warnings: Gets a sentence for each joint whose range changes, and for each follower whose limits can't be kept.

    Raises:
        RobotInvalid: if a joint follows one that doesn't move.
    """
    by_name = {joint.name: joint for joint in joints}
    for follower in joints:
        if follower.mimic is None:
            continue
        driver, multiplier, offset = _end(name, follower, by_name)
        lower, upper = _range(follower, multiplier, offset)
        if not (np.isfinite(lower) or np.isfinite(upper)):
            continue
        both = max(lower, float(driver.lower[0])), min(upper, float(driver.upper[0]))
        who = f"joint {driver.name!r}, which {follower.name!r} follows,"
        if driver.kind not in LIMITED:
            warnings.append(f"{who} turns without limits: those of {follower.name!r} are not kept")
            by_name[follower.name] = _limited(follower, -np.inf, np.inf)
        elif both[0] > both[1]:
            warnings.append(f"{who} has no value at which {follower.name!r} is within its limits: they are not kept")
            by_name[follower.name] = _limited(follower, -np.inf, np.inf)
        elif both[0] > driver.lower[0] + ROUNDING or both[1] < driver.upper[0] - ROUNDING:
            warnings.append(f"{who} only goes from {both[0]:g} to {both[1]:g}, so that its follower keeps its limits")
            by_name[driver.name] = _limited(driver, *both)
    return tuple(by_name[joint.name] for joint in joints)


def _end(name: str, follower: Joint, by_name: dict[str, Joint]) -> tuple[Joint, float, float]:
    """The joint at the end of a chain of mimics, and multiplier and offset of the whole chain."""
    joint, multiplier, offset = follower, 1.0, 0.0
    while joint.mimic is not None:
        if joint.mimic.driver not in by_name:
            followed = joint.mimic.driver
            raise RobotInvalid(f"robot {name!r}: joint {joint.name!r} mimics {followed!r}, which doesn't move")
        offset += multiplier * joint.mimic.offset
        multiplier *= joint.mimic.multiplier
        joint = by_name[joint.mimic.driver]
    return joint, multiplier, offset


def _range(follower: Joint, multiplier: float, offset: float) -> tuple[float, float]:
    """Values of the joint followed at which the follower is within its limits."""
    if multiplier == 0.0 or follower.kind not in LIMITED:
        return -np.inf, np.inf
    ends = (float(follower.lower[0]) - offset) / multiplier, (float(follower.upper[0]) - offset) / multiplier
    return min(ends), max(ends)


def _limited(joint: Joint, lower: float, upper: float) -> Joint:
    limits = np.array([lower + 0.0]), np.array([upper + 0.0])  # no -0.0: NumPy draws nothing from [0, -0]
    for array in limits:
        array.setflags(write=False)
    return dataclasses.replace(joint, lower=limits[0], upper=limits[1])
