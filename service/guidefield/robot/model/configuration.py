"""Convert configurations between the wire (joint names to values) and Pinocchio (one vector), and check limits.

Lengths and order of a joint's numbers on the wire (`LENGTHS`, quaternions x, y, z, w) are the public API's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.errors import GuidefieldError, InvalidConfiguration, at_path
from guidefield.messages.requests import JointValue, Positions
from guidefield.messages.values import QUATERNION_TOLERANCE
from guidefield.robot.model.joints import (
    LARGEST_VALUE,
    IndexedConfiguration,
    Joint,
    JointKind,
    RobotConfiguration,
    to_local,
)
from guidefield.robot.model.mimic_joints import follow
from guidefield.robot.model.model import RobotModel

CLAMP_TOLERANCE = 1e-5 + 1e-11
"""A value beyond its limit by at most this [rad or m] is clamped, with a warning: 1e-5, and room for rounding.

The docs promise it. SRDF states (rests) and streams' goals keep it, motions `LIMIT_TOLERANCE` of prove/verdict.py.
"""

LENGTHS = {JointKind.PLANAR: 3, JointKind.SPHERICAL: 4, JointKind.FLOATING: 7}
"""How many numbers the wire has for a joint, where it isn't one."""


@dataclass(frozen=True)
class LimitFault:
    """A joint value that lies beyond a limit."""

    joint: str
    value: float
    lower: float
    upper: float

    @property
    def excess(self) -> float:
        """By how much [rad or m]."""
        return max(self.lower - self.value, self.value - self.upper)

    @property
    def is_slight(self) -> bool:
        """Whether the value is clamped, instead of being refused."""
        return self.excess <= CLAMP_TOLERANCE


def configuration_from_wire(
    robot: RobotModel,
    positions: Positions,
    base: RobotConfiguration | None = None,
    error: type[GuidefieldError] = InvalidConfiguration,
) -> RobotConfiguration:
    """Return the configuration of the whole robot, shape (nq,), of values by joint name [rad or m].

    Joints left out keep the value of a base, shape (nq,), or of the robot's rest configuration.

    Raises:
        InvalidConfiguration: (or `error`) for an unknown joint, a joint that follows another, a value of the wrong
            length or beyond `LARGEST_VALUE`, or a quaternion whose norm isn't 1 within 1e-6.
    """
    q = np.array(robot.rest if base is None else base, float)
    for name, value in positions.items():
        joint, path = robot.joint(name), f"$.{name}"
        if joint is None:
            available = [j.name for j in robot.joints if j.mimic is None]
            raise error(
                f"robot {robot.name!r} has no joint {name!r}; its joints are {', '.join(available)}",
                joint=name,
                available=available,
                path=path,
            )
        if joint.mimic is not None:
            raise error(
                f"joint {name!r} follows {joint.mimic.source!r} and can't be given: give {joint.mimic.source!r}",
                joint=name,
                path=path,
            )
        if (max(map(abs, value), default=0.0) if isinstance(value, list) else abs(value)) > LARGEST_VALUE:
            raise error(f"joint {name!r}: a value may be {LARGEST_VALUE:g} at most, got {value}", joint=name, path=path)
        if joint.nq == 1 and not isinstance(value, list):
            q[joint.idx_q] = value
        else:
            with at_path(path):
                q[joint.idx_q : joint.idx_q + joint.nq] = values_from_wire(joint, value, error)
    follow(robot.joints, q)
    return q


def scalar(joint: Joint, q: IndexedConfiguration) -> float:
    """Return the value of a joint with one degree of freedom [rad or m] in a configuration, shape (nq,)."""
    values = q[joint.idx_q : joint.idx_q + joint.nq]
    return float(to_local(joint, values, values)[0])


def configuration_to_wire(joints: Sequence[Joint], q: IndexedConfiguration) -> Positions:
    """Return joint names and values of a configuration, shape (nq,); mimic joints are left out."""
    return {joint.name: _to_wire(joint, q) for joint in joints if joint.mimic is None}


def limit_faults(joints: Sequence[Joint], q: IndexedConfiguration) -> list[LimitFault]:
    """Return the values of a configuration, shape (nq,), beyond their limits, in the joints' order."""
    values: list[float] = q.tolist()
    return [
        LimitFault(joint.name, values[joint.idx_q], *limits)
        for joint in joints
        if (limits := joint.limits) is not None and not limits[0] <= values[joint.idx_q] <= limits[1]
    ]


def find_given_faults(joints: Sequence[Joint], positions: Positions) -> list[LimitFault]:
    """Return given values beyond their limits, in the order given; values that don't fit their joints are skipped."""
    limits = {joint.name: joint.limits for joint in joints}
    return [
        LimitFault(name, value, *range_)
        for name, value in positions.items()
        if (range_ := limits.get(name)) is not None
        and not isinstance(value, list)
        and not range_[0] <= value <= range_[1]
    ]


def clamp(joints: Sequence[Joint], q: RobotConfiguration) -> RobotConfiguration:
    """Return a copy of a robot's configuration, (nq,), with every value of some joints brought within its limits."""
    clamped = q.copy()
    for joint in joints:
        if joint.kind in (JointKind.REVOLUTE, JointKind.PRISMATIC):
            clamped[joint.idx_q] = np.clip(q[joint.idx_q], joint.lower[0], joint.upper[0])
    return clamped


def values_from_wire(joint: Joint, value: JointValue, error: type[GuidefieldError]) -> np.ndarray:
    """Return a joint's part of a configuration, shape (nq,), of its value on the wire.

    Raises `error` for a value of the wrong length, or a quaternion whose norm isn't 1 within 1e-6.
    """
    expected = LENGTHS.get(joint.kind)
    if expected is None:
        if isinstance(value, list):
            raise error(
                f"joint {joint.name!r} is {joint.kind.value}: its value is one number, not a list of {len(value)}",
                joint=joint.name,
            )
        return np.array([np.cos(value), np.sin(value)] if joint.kind is JointKind.CONTINUOUS else [value])
    if not isinstance(value, list) or len(value) != expected:
        got = len(value) if isinstance(value, list) else 1
        raise error(
            f"joint {joint.name!r} is {joint.kind.value}: its value has {expected} numbers, not {got}", joint=joint.name
        )
    if joint.kind is JointKind.PLANAR:
        return np.array([value[0], value[1], np.cos(value[2]), np.sin(value[2])])
    numbers = np.array(value)
    norm = float(np.linalg.norm(numbers[-4:]))
    if norm == 0.0:
        raise error(
            f"joint {joint.name!r}: its quaternion is zero, which is no rotation: no rotation at all is [0, 0, 0, 1]",
            joint=joint.name,
        )
    if abs(norm - 1.0) > QUATERNION_TOLERANCE:
        raise error(f"joint {joint.name!r}: its quaternion must have norm 1, it has {norm:.9g}", joint=joint.name)
    numbers[-4:] /= norm
    return numbers


def _to_wire(joint: Joint, q: IndexedConfiguration) -> JointValue:
    values = q[joint.idx_q : joint.idx_q + joint.nq]
    if joint.nv == 1:
        return scalar(joint, q)
    if joint.kind is JointKind.PLANAR:
        return [float(values[0]), float(values[1]), float(np.arctan2(values[3], values[2]))]
    return [float(value) for value in values]
