"""Turn limits of mimic joints into limits of their source joints, which alone are planned for.

Limits may only be narrowed: motions are tested against those of the source joints alone. The one exception are limits
of a mimic joint that leave its source no room to move: they are dropped, with a warning.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from guidefield.robot.model.configuration import FURTHEST
from guidefield.robot.model.model import Joint, JointKind, LimitSource, Mimic

LIMITED = (JointKind.REVOLUTE, JointKind.PRISMATIC)
ROUNDING = 1e-6
"""A limit that is narrowed by less isn't worth a warning [rad or m, per s]: files are written with few digits. Nor is
a range of no more any room to move."""
_NOBODY = LimitSource.DEFAULT


def bind_ranges(joints: Sequence[Joint], warnings: list[str]) -> tuple[Joint, ...]:
    """Return the same joints, where those that others follow keep their followers within their limits; warn of changes.

    A follower whose limits would leave no room to move has none: a wrong sign of a multiplier is common, and a plan
    must not be refused for what no joint can be blamed for.
    """
    by_name = {joint.name: joint for joint in joints}
    for follower in joints:
        if follower.mimic is None:
            continue
        driver = by_name[follower.mimic.driver]
        lower, upper = _range(follower, follower.mimic)
        if not (np.isfinite(lower) or np.isfinite(upper)):
            continue
        both = max(lower, float(driver.lower[0]), -FURTHEST) + 0.0, min(upper, float(driver.upper[0]), FURTHEST) + 0.0
        who = f"joint {driver.name!r}, which {follower.name!r} follows,"
        stuck = both[1] - both[0] <= ROUNDING < driver.upper[0] - driver.lower[0]
        if stuck or both[0] > both[1]:
            warnings.append(f"{who} can't move with {follower.name!r} within its limits: they are not kept")
            by_name[follower.name] = _limit(follower, -np.inf, np.inf)
        elif both != (driver.lower[0], driver.upper[0]):
            if max(both[0] - driver.lower[0], driver.upper[0] - both[1]) > ROUNDING:
                warnings.append(
                    f"{who} only goes from {both[0]:g} to {both[1]:g}, so that its follower keeps its limits"
                )
            by_name[driver.name] = _limit(driver, *both)
    return tuple(by_name[joint.name] for joint in joints)


def bind_rates(joints: Sequence[Joint]) -> tuple[Joint, ...]:
    """Return the same joints, with sources so slow that their mimic joints keep their own limits of rates.

    A limit that nobody stated binds nothing else. Limits of several degrees of freedom stay: nothing follows them.
    """
    by_name = {joint.name: joint for joint in joints}
    for follower in joints:
        law = follower.mimic
        if law is None or law.multiplier == 0.0 or follower.velocity_source is follower.acceleration_source is _NOBODY:
            continue
        source = by_name[law.driver]
        for rate in ("velocity", "acceleration"):
            said_by = getattr(follower, f"{rate}_source")
            limit = float(getattr(follower, rate)[0]) * (1.0 / abs(law.multiplier))
            stated = said_by is not _NOBODY or rate == "acceleration"
            if stated and limit < getattr(source, rate)[0]:
                bound = {rate: _read_only(limit), f"{rate}_source": said_by, f"{rate}_owner": follower.name}
                source = dataclasses.replace(source, **bound)
        by_name[source.name] = source
    return tuple(by_name[joint.name] for joint in joints)


def describe_bound_rates(joints: Sequence[Joint]) -> list[str]:
    """Return a sentence for each joint that `bind_rates` makes slower."""
    return [
        f"joint {bound.name!r}, which {bound.velocity_owner!r} follows, moves at {bound.velocity[0]:g} at most, so that"
        " its follower keeps its velocity limit"
        for stated, bound in zip(joints, bind_rates(joints), strict=True)
        if stated.velocity[0] - bound.velocity[0] > ROUNDING
    ]


def _read_only(limit: float) -> np.ndarray:
    array = np.array([limit])
    array.setflags(write=False)
    return array


def _range(follower: Joint, law: Mimic) -> tuple[float, float]:
    if law.multiplier == 0.0 or follower.kind not in LIMITED:
        return -np.inf, np.inf
    ends = [(float(limit) - law.offset) / law.multiplier for limit in (follower.lower[0], follower.upper[0])]
    return min(ends), max(ends)


def _limit(joint: Joint, lower: float, upper: float) -> Joint:
    limits = np.array([lower + 0.0]), np.array([upper + 0.0])  # no -0.0: NumPy draws nothing from [0, -0]
    for array in limits:
        array.setflags(write=False)
    return dataclasses.replace(joint, lower=limits[0], upper=limits[1])
