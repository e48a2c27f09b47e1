"""The exact decision for bodies that may touch obstacles; each lane's separating axis is tried on all others.

Before GJK each lane has an axis of its own, away from the obstacle's point nearest to the middle of the body.
"""

from __future__ import annotations

from numba import boolean, int64, types

from guidefield.kernels.collide.balls import ball_centre
from guidefield.kernels.collide.gjk import bodies_apart
from guidefield.kernels.collide.gjk_scratch import write_axis
from guidefield.kernels.collide.layout import (
    BAND,
    BODIES,
    DECISION_BAND,
    OBSTACLES,
    REACH,
    SCRATCH_MEMORY,
    LaneBodies,
    LaneObstacles,
    Scratch,
    axis_place,
)
from guidefield.kernels.collide.nonconvex_narrowphase import pieces_meet
from guidefield.kernels.collide.parts import POINTED_PARTS, Parts, polytope_of
from guidefield.kernels.collide.primitive import PRIMITIVE, away_from_primitive
from guidefield.kernels.collide.separating_axes import keep_axis, kept_beyond, lowest_ball, lowest_vertex, no_axis
from guidefield.kernels.jit.signatures import lane_step
from guidefield.kernels.kinematics.poses import one_pose, turned_axis, write_identity
from guidefield.kernels.simd.vector import below, first_lane, lane, splat


@lane_step(int64(BODIES, POINTED_PARTS, int64, int64, OBSTACLES, int64, types.float64, SCRATCH_MEMORY, boolean))
def left_of_obstacle(
    bodies: LaneBodies,
    parts: Parts,
    body: int,
    obstacle: int,
    obstacles: LaneObstacles,
    mask: int,
    clearance: float,
    scratch: Scratch,
    closely: bool,
) -> int:
    """The lanes of a mask where the last axis that separated body and obstacle does not; it is fixed in the world.

    By the balls of the body's cover; `closely` also by the vertices of its hull.
    """
    axes, at = scratch.obstacle_axes, axis_place(obstacles, body, obstacle)
    if no_axis(axes, at):
        return mask
    x, y, z = axes[at], axes[at + 1], axes[at + 2]
    enough = splat(axes[at + REACH] + clearance + BAND)
    u, v, w, origin = turned_axis(scratch.poses, bodies.joints[body], splat(x), splat(y), splat(z))
    left = mask & below(lowest_ball(bodies, body, u, v, w) + origin, enough)
    part = polytope_of(parts, bodies.roots[body])
    if closely and left and part >= 0:
        left &= below(lowest_vertex(parts, part, u, v, w) + origin, enough)
    return int(left)


@lane_step(boolean(BODIES, POINTED_PARTS, int64, int64, OBSTACLES, POINTED_PARTS, int64, types.float64, SCRATCH_MEMORY))
def meets_obstacle(
    bodies: LaneBodies,
    parts: Parts,
    body: int,
    obstacle: int,
    obstacles: LaneObstacles,
    scene: Parts,
    mask: int,
    clearance: float,
    scratch: Scratch,
) -> bool:
    """Whether a body touches an obstacle in any lane of a mask.

    Each lane that is judged leaves an axis behind, which mostly separates the others too.
    """
    work, pose_a, pose_b, axes = scratch.work, scratch.pose_a, scratch.pose_b, scratch.obstacle_axes
    at, margin = axis_place(obstacles, body, obstacle), clearance + DECISION_BAND
    own, root, joint = bodies.roots[body], obstacles.roots[obstacle], bodies.joints[body]
    mask = left_of_obstacle(bodies, parts, body, obstacle, obstacles, mask, clearance, scratch, True)
    if mask == 0:
        return False
    write_identity(pose_b)
    hull = polytope_of(parts, own)
    if hull >= 0:
        kind, primitives = obstacles.kinds[obstacle], obstacles.primitives
        x, y, z = ball_centre(scratch.poses, joint, bodies.bounds, body)
        u, v, w, reach = away_from_primitive(kind, primitives, obstacle * PRIMITIVE, x, y, z)
        apart = mask & ~kept_beyond(parts, hull, scratch.poses, joint, u, v, w, reach, clearance + BAND)
        if apart:
            chosen = first_lane(apart)
            write_axis(work, lane(u, chosen), lane(v, chosen), lane(w, chosen))
            keep_axis(scene, root, work, pose_b, 1.0, axes, at, scratch.obstacle_places)
            mask &= ~apart
            if mask == 0:
                return False
    if bodies.pieces[body + 1] - bodies.pieces[body] > 1:
        return bool(pieces_meet(bodies, parts, body, obstacles, scene, obstacle, mask, clearance, scratch))
    while mask:
        one_pose(scratch.poses, joint, first_lane(mask), pose_a)
        mask &= mask - 1
        write_axis(work, axes[at], axes[at + 1], axes[at + 2])
        if not bodies_apart(parts, own, pose_a, scene, root, pose_b, margin, work):
            return True
        keep_axis(scene, root, work, pose_b, 1.0, axes, at, scratch.obstacle_places)
        mask = left_of_obstacle(bodies, parts, body, obstacle, obstacles, mask, clearance, scratch, True)
    return False
