"""A ball in the world that what moves of a robot stays in, while its joints are within a box."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.robot.model.spaces import ChartPoint


def robot_ball(world: World, low: ChartPoint, high: ChartPoint) -> tuple[np.ndarray, float]:
    """A ball about the bodies that meet obstacles, at any configuration within a box of the group's chart.

    Args:
        world: The robot; it is placed anew.
        low: The box's lower corner, shape (nv,) [rad or m].
        high: Its upper corner, shape (nv,).

    Returns:
        Centre, shape (3,) [m, world], and radius [m].
    """
    group, bodies, moving = world.group, world.bodies, world.pairs.moving
    q = group.expand_from_chart(0.5 * (low + high))
    jacobian = pin.computeJointJacobians(world.model, world.data, q).reshape(6, -1)
    centres = bodies.centres_in_world(world.joint_placements[None])
    _, reach = world.motion_bound.at(jacobian[None], centres, 0.5 * (high - low)[None])
    own = centres[0, moving]
    centre = own.mean(axis=0)
    away = np.linalg.norm(own - centre, axis=1) + bodies.radii[moving] + reach[0, moving]
    return centre, float(away.max())
