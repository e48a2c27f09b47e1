"""Mimic joints: their laws, their values in a configuration, and limits that bind their source joints.

A mimic joint's value is ``multiplier * x + offset`` of the unwrapped value x of its source joint, at the end of its
chain. A continuous joint's configuration is the cosine and sine of its angle, in which whole turns are lost. That is
right where nothing follows it, or only continuous joints that turn by a whole multiple. A mimic joint that turns by
half as much, that slides, or that has limits is elsewhere after a turn. Then its source isn't periodic: it is loaded as
a revolute joint, whose configuration is its value.

Only source joints are planned for, and motions are tested against their limits alone: so these may only be narrowed.
The one exception are limits of a mimic joint that leave its source no room to move: they are dropped, with a warning.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.robot.model.joints import (
    LARGEST_VALUE,
    Joint,
    JointKind,
    LimitSource,
    Mimic,
    RobotConfiguration,
    from_local,
    to_local,
)
from guidefield.robot.model.model import axis_of, joint_indices, with_joints
from guidefield.robot.urdf.elements import UrdfFacts

LIMITED = (JointKind.REVOLUTE, JointKind.PRISMATIC)
ROUNDING = 1e-6
"""A limit that is narrowed by less isn't worth a warning [rad or m, per s]: files are written with few digits. Nor is
a range of no more any room to move."""
_NOT_SAID = LimitSource.DEFAULT


def mimic_laws(facts: UrdfFacts) -> dict[str, Mimic]:
    """Return the law of each mimic joint of a URDF; its source is the joint at the end of its chain."""
    found = {}
    for mimic in facts.mimics:
        source, multiplier, offset = facts.mimics[mimic]
        while source in facts.mimics:
            source, other, shift = facts.mimics[source]
            multiplier, offset = multiplier * other, multiplier * shift + offset
        found[mimic] = Mimic(source, multiplier, offset)
    return found


def find_unwrapped(facts: UrdfFacts) -> dict[str, str]:
    """Return continuous joints whose whole turns count, each with a mimic joint that is elsewhere after one.

    Such a joint is of kind revolute once it is loaded, without limits of its own.
    """
    found: dict[str, str] = {}
    for mimic, law in mimic_laws(facts).items():
        returns = law.multiplier == 0.0 or (
            facts.joints[mimic].kind == "continuous" and law.multiplier == np.round(law.multiplier)
        )
        if facts.joints[law.source].kind == "continuous" and not returns:
            found.setdefault(law.source, mimic)
    return found


def with_unwrapped(model: Any, facts: UrdfFacts) -> Any:
    """Return a URDF's Pinocchio model with the joints that `find_unwrapped` names as revolute, without limits."""
    indices = joint_indices(model)
    joints = {indices[name]: model.joints[indices[name]] for name in find_unwrapped(facts)}
    revolute = {index: pin.JointModelRevoluteUnaligned(axis_of(joint)) for index, joint in joints.items()}
    return with_joints(model, revolute)


def follow(joints: Sequence[Joint], q: RobotConfiguration) -> None:
    """Set, in place, the mimic joints in a configuration (nq,), by the source joints, which must be among `joints`."""
    mimics = [(joint, joint.mimic) for joint in joints if joint.mimic is not None]
    by_name = {joint.name: joint for joint in joints} if mimics else {}
    for joint, mimic in mimics:
        source = by_name[mimic.source]
        if source.nq == joint.nq == 1:  # the local coordinate is the value itself, as of most mimic joints
            q[joint.idx_q] = mimic.multiplier * q[source.idx_q] + mimic.offset
            continue
        values = [q[one.idx_q : one.idx_q + one.nq] for one in (source, joint)]
        z = mimic.multiplier * to_local(source, values[0], values[0]) + mimic.offset
        q[joint.idx_q : joint.idx_q + joint.nq] = from_local(joint, z, values[1])


def expansion(joints: Sequence[Joint], model: Any, space: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the affine map from local coordinates of planned joints to those of a model with their mimic joints.

    A matrix, shape (model.nv, space.nv), and an offset, shape (model.nv,); `space` is the model of planned joints
    alone.
    """
    by_name, planned = {joint.name: joint for joint in joints}, joint_indices(space)
    matrix, offset = np.zeros((model.nv, space.nv)), np.zeros(model.nv)
    for index in range(1, model.njoints):
        joint, row = by_name[model.names[index]], model.joints[index].idx_v
        law = joint.mimic or Mimic(joint.name, 1.0, 0.0)
        column = space.joints[planned[law.source]].idx_v
        matrix[row : row + joint.nv, column : column + joint.nv] = law.multiplier * np.eye(joint.nv)
        offset[row] = law.offset
    return matrix, offset


def bind_ranges(joints: Sequence[Joint], warnings: list[str]) -> tuple[Joint, ...]:
    """Narrow the ranges of source joints so that their mimic joints keep their limits; warn of changes.

    Limits of a mimic joint that leave its source joint no room to move are dropped: a wrong sign of a multiplier is
    common, and a plan must not be refused for what no joint can be blamed for.
    """
    by_name = {joint.name: joint for joint in joints}
    for joint in joints:
        if joint.mimic is None:
            continue
        source = by_name[joint.mimic.source]
        lower, upper = _range_for_source(joint, joint.mimic)
        if not (np.isfinite(lower) or np.isfinite(upper)):
            continue
        lower = max(lower, float(source.lower[0]), -LARGEST_VALUE) + 0.0
        upper = min(upper, float(source.upper[0]), LARGEST_VALUE) + 0.0
        who = f"joint {source.name!r}, which {joint.name!r} follows,"
        stuck = upper - lower <= ROUNDING < source.upper[0] - source.lower[0]
        if stuck or lower > upper:
            warnings.append(f"{who} can't move with {joint.name!r} within its limits: they are not kept")
            by_name[joint.name] = _with_limits(joint, -np.inf, np.inf)
        elif (lower, upper) != (source.lower[0], source.upper[0]):
            if max(lower - source.lower[0], source.upper[0] - upper) > ROUNDING:
                warnings.append(
                    f"{who} only goes from {lower:g} to {upper:g}, so that its mimic joint keeps its limits"
                )
            by_name[source.name] = _with_limits(source, lower, upper)
    return tuple(by_name[joint.name] for joint in joints)


def bind_rates(joints: Sequence[Joint]) -> tuple[Joint, ...]:
    """Return the same joints, with sources so slow that their mimic joints keep their own limits of rates.

    A limit that nobody stated binds nothing else. Limits of several degrees of freedom stay: nothing follows them.
    """
    by_name = {joint.name: joint for joint in joints}
    for joint in joints:
        law = joint.mimic
        if law is None or law.multiplier == 0.0 or joint.velocity_source is joint.acceleration_source is _NOT_SAID:
            continue
        source = by_name[law.source]
        for rate in ("velocity", "acceleration"):
            said_by = getattr(joint, f"{rate}_source")
            limit = float(getattr(joint, rate)[0]) * (1.0 / abs(law.multiplier))
            stated = said_by is not _NOT_SAID or rate == "acceleration"
            if stated and limit < getattr(source, rate)[0]:
                bound = {rate: _read_only(limit), f"{rate}_source": said_by, f"{rate}_owner": joint.name}
                source = dataclasses.replace(source, **bound)
        by_name[source.name] = source
    return tuple(by_name[joint.name] for joint in joints)


def describe_bound_rates(joints: Sequence[Joint]) -> list[str]:
    """Return a sentence for each joint that `bind_rates` makes slower."""
    return [
        f"joint {bound.name!r}, which {bound.velocity_owner!r} follows, moves at {bound.velocity[0]:g} at most, so that"
        " its mimic joint keeps its velocity limit"
        for stated, bound in zip(joints, bind_rates(joints), strict=True)
        if stated.velocity[0] - bound.velocity[0] > ROUNDING
    ]


def _read_only(limit: float) -> np.ndarray:
    array = np.array([limit])
    array.setflags(write=False)
    return array


def _range_for_source(joint: Joint, law: Mimic) -> tuple[float, float]:
    if law.multiplier == 0.0 or joint.kind not in LIMITED:
        return -np.inf, np.inf
    ends = [(float(limit) - law.offset) / law.multiplier for limit in (joint.lower[0], joint.upper[0])]
    return min(ends), max(ends)


def _with_limits(joint: Joint, lower: float, upper: float) -> Joint:
    limits = np.array([lower + 0.0]), np.array([upper + 0.0])  # no -0.0: NumPy draws nothing from [0, -0]
    for array in limits:
        array.setflags(write=False)
    return dataclasses.replace(joint, lower=limits[0], upper=limits[1])
