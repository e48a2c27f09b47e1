"""A ball in the world that a robot stays in whatever its joints do."""

from __future__ import annotations

import numpy as np

from guidefield.collision.bodies import bodies
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.model import JointKind
from guidefield.scene.within_ball import Ball

BEYOND = 0.05
"""How far beyond its limits a joint that slides is let be [m]: more than any start or goal is let."""

_TURNING = {JointKind.REVOLUTE, JointKind.CONTINUOUS, JointKind.SPHERICAL}
"""Kinds of joints that leave the origin of their frame where it is."""


@memoized_for_alike
def robot_reach(group: PlanningGroup, limited: bool = True) -> Ball | None:
    """The ball about all bodies of a planning group; None where a joint may go anywhere.

    It is about the first joint, or the middle of those that are. From one joint to the next it is no farther than where
    the one holds the other, and what the other slides.

    Args:
        group: The robot.
        limited: Whether the joints keep their limits.
    """
    model, about = group.model, bodies(group)
    first = [index for index in range(1, model.njoints) if model.parents[index] == 0]
    if not first:
        return None
    centre = np.mean([model.jointPlacements[index].translation for index in first], axis=0)
    slides = _slides(group, limited)
    if not np.isfinite(slides).all():
        return None
    away = np.zeros(model.njoints)
    for index in range(1, model.njoints):
        parent, there = model.parents[index], model.jointPlacements[index].translation
        apart = np.linalg.norm(there - centre) if parent == 0 else away[parent] + np.linalg.norm(there)
        away[index] = apart + slides[index]
    middle = np.where(about.joints[:, None] == 0, about.centres - centre, about.centres)
    reach = away[about.joints] + np.linalg.norm(middle, axis=1) + about.radii
    x, y, z = centre.tolist()
    return Ball(x, y, z, float(reach.max(initial=0.0)))


def _slides(group: PlanningGroup, limited: bool) -> np.ndarray:
    """How far each joint of the model takes the origin of its frame at most, shape (njoints,) [m]; may be infinite."""
    model, found = group.model, np.zeros(group.model.njoints)
    most, share = np.maximum(np.abs(group.lower), np.abs(group.upper)), np.abs(group.expand_velocity)
    each = np.multiply(share, most, out=np.zeros_like(share), where=share > 0.0)
    farthest = each.sum(axis=1) + np.abs(group.expand_offset)
    for index in range(1, model.njoints):
        joint = group.robot.joint(model.names[index])
        assert joint is not None, "a group's joints are the robot's"
        if joint.kind not in _TURNING:
            within = limited and joint.kind is JointKind.PRISMATIC
            found[index] = farthest[model.joints[index].idx_v] + BEYOND if within else np.inf
    return found
