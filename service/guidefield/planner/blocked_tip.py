"""What blocks a pose of the tip however it is reached: bodies that move with the tip stand in an obstacle there.

Where the tip is at a pose, so are the bodies that are fixed to it, whatever the other joints do. Within the tolerances
of a target a point of such a body is at most so far from where it is at one configuration that reaches it: twice the
tolerance of the position, and twice that of the orientation times the point's distance from the tip. Convex bodies that
are deeper in each other than that touch at every configuration that reaches the target: else a plane would part them at
one, and along its normal they would be apart after a way no longer than that.
"""

from __future__ import annotations

import numpy as np

from guidefield.collision.blocking_pairs import BlockingPairs
from guidefield.collision.contact import depth_of
from guidefield.collision.world import World
from guidefield.robot.ik.pose_target import EXACT, PoseTarget
from guidefield.robot.model.spaces import ModelConfiguration

SURE = 1e-3
"""Only what is deeper than this is taken for a proof: Coal's depths are found by steps [m]."""


def blocked_tip(world: World, target: PoseTarget, q: ModelConfiguration) -> BlockingPairs | None:
    """The pairs that touch however a target is reached; None where no such pair is found.

    Args:
        world: Robot and obstacles; nothing moves.
        target: What is to be reached.
        q: A configuration of the group's model that reaches it, shape (model.nq,).
    """
    aside, turned = (
        2.0 * float(np.linalg.norm(np.maximum(each, EXACT)))
        for each in (target.position_tolerance, target.orientation_tolerance)
    )
    if not np.isfinite(aside + turned):
        return None
    group, about = world.group, world.bodies
    tip = group.model.frames[group.tip_id]
    depths: dict[tuple[str, str], float] = {}
    for pair in world.near(q):
        body, other = world.pairs.of(pair)
        if other < world.pairs.links or about.joints[body] != tip.parentJoint or not world.touches(pair):
            continue
        reach = float(np.linalg.norm(about.centres[body] - tip.placement.translation) + about.radii[body])
        depth = depth_of(world, pair)
        if depth is not None and depth > SURE + aside + turned * reach:
            depths.setdefault(world.pair_names(pair), depth)
    if not depths:
        return None
    ordered = sorted(depths, key=lambda pair: -depths[pair])
    return BlockingPairs(1, dict.fromkeys(ordered, 1), depths[ordered[0]])
