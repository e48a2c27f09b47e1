"""The exact decision for bodies that may touch obstacles; each lane's separating axis is tried on all others."""

from __future__ import annotations

from numba import boolean, int64, types

from guidefield.kernels.lane_axes import (
    keep_axis,
    lowest_ball,
    lowest_vertex,
    one_pose,
    polytope_of,
    turned_axis,
)
from guidefield.kernels.lane_tables import (
    AXIS_AND_REACH,
    BAND,
    BODIES,
    DECISION_BAND,
    OBSTACLES,
    SCRATCH_MEMORY,
    LaneBodies,
    LaneObstacles,
    Scratch,
)
from guidefield.kernels.lanes import (
    below,
    first_lane,
    lane_step,
    splat,
)
from guidefield.kernels.separation import (
    AXIS,
    POINTED_PARTS,
    Parts,
    bodies_apart,
)


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
    axes, at = scratch.obstacle_axes, AXIS_AND_REACH * (body * obstacles.size + obstacle)
    x, y, z = axes[at], axes[at + 1], axes[at + 2]
    if x == 0.0 and y == 0.0 and z == 0.0:
        return mask
    enough = splat(axes[at + 3] + clearance + BAND)
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
    at, margin = AXIS_AND_REACH * (body * obstacles.size + obstacle), clearance + DECISION_BAND
    root = obstacles.roots[obstacle]
    for entry in range(12):
        pose_b[entry] = 1.0 if entry in (0, 5, 10) else 0.0
    while True:
        mask = left_of_obstacle(bodies, parts, body, obstacle, obstacles, mask, clearance, scratch, True)
        if mask == 0:
            return False
        one_pose(scratch.poses, bodies.joints[body], first_lane(mask), pose_a)
        mask &= mask - 1
        for k in range(3):
            work[AXIS + k] = axes[at + k]
        if not bodies_apart(parts, bodies.roots[body], pose_a, scene, root, pose_b, margin, work):
            return True
        keep_axis(scene, root, work, pose_b, 1.0, axes, at)
