"""The limits of joints that follow others, as limits of the joints they follow: these alone are planned for."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from guidefield.robot.model.configuration import FURTHEST
from guidefield.robot.model.model import Joint, JointKind, Mimic

LIMITED = (JointKind.REVOLUTE, JointKind.PRISMATIC)
ROUNDING = 1e-6
"""That a follower narrows a range by less is not told [rad or m]: limits are written with few digits."""


def narrowed(joints: Sequence[Joint], warnings: list[str]) -> tuple[Joint, ...]:
    """The same joints; those that others follow only go where their followers stay within their own limits.

    A follower whose limits can't be kept so has none: a plan must not be refused for what no joint can be blamed for.

    Args:
        joints: Movable joints.
        warnings: Gets a sentence for each joint whose range changes, and for each follower whose limits can't be kept.
    """
    by_name = {joint.name: joint for joint in joints}
    for follower in joints:
        if follower.mimic is None:
            continue
        driver = by_name[follower.mimic.driver]
        lower, upper = _range(follower, follower.mimic)
        if not (np.isfinite(lower) or np.isfinite(upper)):
            continue
        both = max(lower, float(driver.lower[0]), -FURTHEST), min(upper, float(driver.upper[0]), FURTHEST)
        who = f"joint {driver.name!r}, which {follower.name!r} follows,"
        if both[0] > both[1]:
            warnings.append(f"{who} has no value at which {follower.name!r} is within its limits: they are not kept")
            by_name[follower.name] = _limited(follower, -np.inf, np.inf)
        elif both != (driver.lower[0], driver.upper[0]):
            if max(both[0] - driver.lower[0], driver.upper[0] - both[1]) > ROUNDING:
                warnings.append(
                    f"{who} only goes from {both[0]:g} to {both[1]:g}, so that its follower keeps its limits"
                )
            by_name[driver.name] = _limited(driver, *both)
    return tuple(by_name[joint.name] for joint in joints)


def _range(follower: Joint, law: Mimic) -> tuple[float, float]:
    """Values of the joint followed at which the follower is within its limits."""
    if law.multiplier == 0.0 or follower.kind not in LIMITED:
        return -np.inf, np.inf
    ends = [(float(limit) - law.offset) / law.multiplier for limit in (follower.lower[0], follower.upper[0])]
    return min(ends), max(ends)


def _limited(joint: Joint, lower: float, upper: float) -> Joint:
    limits = np.array([lower + 0.0]), np.array([upper + 0.0])  # no -0.0: NumPy draws nothing from [0, -0]
    for array in limits:
        array.setflags(write=False)
    return dataclasses.replace(joint, lower=limits[0], upper=limits[1])
