"""Bound where a robot may be by a ball in the world: whatever its joints do, or while they are within a box.

Scenes are cropped to the first (`scene/crop.py`), the certificate bounds by the second how fast moving half-spaces pass
(`prove/tables.py`): a ball may be larger, never too small.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from guidefield.collision.bodies import bodies
from guidefield.collision.world import World
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.model import JointKind
from guidefield.robot.model.spaces import ChartPoint
from guidefield.scene.crop import Ball

SLIDE_MARGIN = 0.05  # sliding joints may be so far beyond their limits [m]: farther than any start or goal

_TURNING_KINDS = {JointKind.REVOLUTE, JointKind.CONTINUOUS, JointKind.SPHERICAL}
"""Kinds of joints that leave the origin of their frame where it is."""


@memoized_for_alike
def reach_ball(group: PlanningGroup, limited: bool = True) -> Ball | None:
    """Return the ball about all bodies of a group, within joint limits or not; None if a joint may go anywhere.

    Its centre is the first joint, or the mean of several. The distance from one joint to the next is at most that of
    its placement and of its slide.
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
    """Return the largest slide of each joint of the model, shape (njoints,) [m]; it may be infinite."""
    model, found = group.model, np.zeros(group.model.njoints)
    most, share = np.maximum(np.abs(group.lower), np.abs(group.upper)), np.abs(group.expand_velocity)
    each = np.multiply(share, most, out=np.zeros_like(share), where=share > 0.0)
    farthest = each.sum(axis=1) + np.abs(group.expand_offset)
    for index in range(1, model.njoints):
        joint = group.robot.joint(model.names[index])
        assert joint is not None, "a group's joints are the robot's"
        if joint.kind not in _TURNING_KINDS:
            within = limited and joint.kind is JointKind.PRISMATIC
            found[index] = farthest[model.joints[index].idx_v] + SLIDE_MARGIN if within else np.inf
    return found


def robot_ball(world: World, low: ChartPoint, high: ChartPoint) -> tuple[np.ndarray, float]:
    """Return a ball about the bodies that are tested against obstacles, anywhere between chart corners (nv,).

    Centre (3,) and radius [m, world]. The robot is placed anew.
    """
    group, about, moving = world.group, world.bodies, world.pairs.moving
    q = group.expand_from_chart(0.5 * (low + high))
    jacobian = pin.computeJointJacobians(world.model, world.data, q).reshape(6, -1)
    centres = about.centres_in_world(world.joint_placements[None])
    _, reach = world.motion_bound.at(jacobian[None], centres, 0.5 * (high - low)[None])
    own = centres[0, moving]
    centre = own.mean(axis=0)
    away = np.linalg.norm(own - centre, axis=1) + about.radii[moving] + reach[0, moving]
    return centre, float(away.max())
