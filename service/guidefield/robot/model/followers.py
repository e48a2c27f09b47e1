"""Joints that follow others: whom they follow in the end, what that asks of the joint followed, where they are.

A follower's value is ``multiplier * x + offset`` of the unwrapped value x of the joint at the end of its chain. A
continuous joint's configuration is the cosine and sine of its angle, in which whole turns are lost. That is right where
nothing follows it, or only continuous joints that turn by a whole multiple. A follower that turns by half as much, that
slides, or that has limits is elsewhere after a turn. Then the joint followed isn't periodic: it is loaded as a revolute
joint, whose configuration is its value.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.robot.model import chart
from guidefield.robot.model.model import Joint, Mimic, axis_of, joint_indices
from guidefield.robot.model.replaced_joints import with_joints
from guidefield.robot.model.spaces import RobotConfiguration
from guidefield.robot.urdf.facts import UrdfFacts


def laws(facts: UrdfFacts) -> dict[str, Mimic]:
    """The law by which each follower of a URDF moves; the driver is the joint at the end of its chain."""
    found = {}
    for follower in facts.mimics:
        driver, multiplier, offset = facts.mimics[follower]
        while driver in facts.mimics:
            driver, other, shift = facts.mimics[driver]
            multiplier, offset = multiplier * other, multiplier * shift + offset
        found[follower] = Mimic(driver, multiplier, offset)
    return found


def unwrapped(facts: UrdfFacts) -> dict[str, str]:
    """Return continuous joints whose whole turns count, each with a follower that is elsewhere after one.

    Such a joint is of kind revolute once it is loaded, without limits of its own.
    """
    found: dict[str, str] = {}
    for follower, law in laws(facts).items():
        returns = law.multiplier == 0.0 or (
            facts.joints[follower].kind == "continuous" and law.multiplier == np.round(law.multiplier)
        )
        if facts.joints[law.driver].kind == "continuous" and not returns:
            found.setdefault(law.driver, follower)
    return found


def with_unwrapped(model: Any, facts: UrdfFacts) -> Any:
    """The Pinocchio model of a URDF with the joints that `unwrapped` names as revolute ones, without limits."""
    indices = joint_indices(model)
    joints = {indices[name]: model.joints[indices[name]] for name in unwrapped(facts)}
    revolute = {index: pin.JointModelRevoluteUnaligned(axis_of(joint)) for index, joint in joints.items()}
    return with_joints(model, revolute)


def follow(joints: Sequence[Joint], q: RobotConfiguration) -> None:
    """Set, in place, the joints that follow others in a configuration (nq,) of joints with those that they follow."""
    followers = [(joint, joint.mimic) for joint in joints if joint.mimic is not None]
    by_name = {joint.name: joint for joint in joints} if followers else {}
    for joint, mimic in followers:
        driver = by_name[mimic.driver]
        if driver.nq == joint.nq == 1:  # the chart is the value itself, which most followers have
            q[joint.idx_q] = mimic.multiplier * q[driver.idx_q] + mimic.offset
            continue
        values = [q[one.idx_q : one.idx_q + one.nq] for one in (driver, joint)]
        z = mimic.multiplier * chart.to_chart(driver, values[0], values[0]) + mimic.offset
        q[joint.idx_q : joint.idx_q + joint.nq] = chart.from_chart(joint, z, values[1])


def expansion(joints: Sequence[Joint], model: Any, space: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the affine map from the chart of planned joints to that of a model with their followers.

    A matrix, shape (model.nv, space.nv), and an offset, shape (model.nv,); `space` is the model of planned joints
    alone.
    """
    by_name, planned = {joint.name: joint for joint in joints}, joint_indices(space)
    matrix, offset = np.zeros((model.nv, space.nv)), np.zeros(model.nv)
    for index in range(1, model.njoints):
        joint, row = by_name[model.names[index]], model.joints[index].idx_v
        law = joint.mimic or Mimic(joint.name, 1.0, 0.0)
        column = space.joints[planned[law.driver]].idx_v
        matrix[row : row + joint.nv, column : column + joint.nv] = law.multiplier * np.eye(joint.nv)
        offset[row] = law.offset
    return matrix, offset
