"""The exact decision for bodies that may touch a cloud: the few balls near a body, by GJK; an axis tells for many."""

from __future__ import annotations

import math

from numba import boolean, float64, int64, types

from guidefield.kernels.collide.balls import ball_radius, lowest_of_ball, placed_ball
from guidefield.kernels.collide.gjk import bodies_apart, reach_along
from guidefield.kernels.collide.gjk_scratch import AXIS, X, Y, Z, axis_in, axis_length, divide_axis, write_axis
from guidefield.kernels.collide.layout import (
    BAND,
    BODIES,
    DECISION_BAND,
    OBSTACLES,
    SCRATCH_MEMORY,
    LaneBodies,
    LaneObstacles,
    Scratch,
    axis_place,
)
from guidefield.kernels.collide.parts import POINTED_PARTS, Parts, part_of
from guidefield.kernels.collide.separating_axes import keep_direction, no_axis
from guidefield.kernels.distance.point_tree import (
    CLOUD_TABLES,
    RADIUS,
    LaneCloud,
    cloud_of,
    next_block,
    point_gaps,
    words_at,
)
from guidefield.kernels.jit.signatures import DOUBLE_POINTER, Floats, lane_part, lane_step
from guidefield.kernels.kinematics.poses import one_pose, turned_back, write_identity
from guidefield.kernels.simd.blocks import BLOCK, point_at, points_at
from guidefield.kernels.simd.vector import below, first_lane, splat


@lane_step(float64(BODIES, POINTED_PARTS, int64, DOUBLE_POINTER, DOUBLE_POINTER))
def _lowest(bodies: LaneBodies, parts: Parts, body: int, pose: Floats, work: Floats) -> float:
    """The least n.x over the points x of a body in a pose, for the axis n in the scratch space [m]."""
    x, y, z = axis_in(work)
    u, v, w = turned_back(pose, x, y, z)
    origin = x * pose[3] + y * pose[7] + z * pose[11]
    part = part_of(parts, bodies.roots[body])
    if part >= 0:
        return float(origin - reach_along(parts, part, work, -u, -v, -w))
    cover, lowest = bodies.cover, math.inf
    for ball in range(bodies.covers[bodies.groups[body]], bodies.covers[bodies.groups[body + 1]]):
        along = lowest_of_ball(cover, ball, u, v, w)
        lowest = min(lowest, along)
    return float(origin + lowest)


@lane_part
def _beyond(cloud: LaneCloud, block: int, work: Floats, lowest: float, grown: float) -> int:
    """Mask of sixteen points that the axis in the scratch space doesn't keep apart from a body."""
    u, v, w = points_at(cloud.points, block * BLOCK)
    x, y, z = axis_in(work)
    along = u * x + v * y + w * z
    return int(below(splat(lowest - grown), along))


@lane_step(int64(BODIES, int64, DOUBLE_POINTER, CLOUD_TABLES, int64, float64, int64))
def _in_cover(
    bodies: LaneBodies, group: int, pose: Floats, cloud: LaneCloud, block: int, grown: float, near: int
) -> int:
    """The points of some of sixteen that are within `grown` of a ball in a group of a body's cover."""
    cover, mask = bodies.cover, 0
    for ball in range(bodies.covers[group], bodies.covers[group + 1]):
        x, y, z = placed_ball(pose, cover, ball)
        reach = ball_radius(cover, ball) + grown
        mask |= below(point_gaps(cloud.points, block, x, y, z), splat(reach * reach))
        if mask & near == near:
            break
    return int(mask & near)


@lane_step(
    boolean(BODIES, POINTED_PARTS, int64, DOUBLE_POINTER, CLOUD_TABLES, POINTED_PARTS, int64, float64, SCRATCH_MEMORY)
)
def _pose_meets(
    bodies: LaneBodies,
    parts: Parts,
    body: int,
    pose: Floats,
    cloud: LaneCloud,
    scene: Parts,
    root: int,
    clearance: float,
    scratch: Scratch,
) -> bool:
    """Whether a body in a pose touches a ball of a cloud; the search begins with the axis in the scratch space."""
    work, there, grouped = scratch.work, scratch.pose_b, bodies.grouped
    grown = cloud.numbers[RADIUS] + clearance + BAND
    known = not no_axis(work, AXIS)
    lowest = _lowest(bodies, parts, body, pose, work) if known else 0.0
    for group in range(bodies.groups[body], bodies.groups[body + 1]):
        x, y, z = placed_ball(pose, grouped, group)
        reach, block = ball_radius(grouped, group) + grown, -1
        while True:
            block = next_block(cloud, block, x, y, z, reach)
            if block < 0:
                break
            left = below(point_gaps(cloud.points, block, x, y, z), splat(reach * reach))
            if known:
                left &= _beyond(cloud, block, work, lowest, grown)
            if left:
                left = _in_cover(bodies, group, pose, cloud, block, grown, left)
            while left:
                at = block * BLOCK + first_lane(left)
                left &= left - 1
                there[X], there[Y], there[Z] = point_at(cloud.points, at)
                margin = clearance + DECISION_BAND
                if not bodies_apart(parts, bodies.roots[body], pose, scene, root, there, margin, work):
                    return True
                length = axis_length(work)
                known = length > 1e-15
                if known:
                    divide_axis(work, length)
                    lowest = _lowest(bodies, parts, body, pose, work)
                    left &= _beyond(cloud, block, work, lowest, grown)
    return False


@lane_step(boolean(BODIES, POINTED_PARTS, int64, int64, OBSTACLES, POINTED_PARTS, int64, types.float64, SCRATCH_MEMORY))
def meets_cloud(
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
    """Whether a body touches a cloud in any lane of a mask.

    The axis that kept a ball apart last is where the next decision about body and cloud begins.
    """
    work, pose, axes = scratch.work, scratch.pose_a, scratch.obstacle_axes
    at, cloud = axis_place(obstacles, body, obstacle), cloud_of(words_at(obstacles.clouds[obstacle]))
    write_identity(scratch.pose_b)
    write_axis(work, axes[at], axes[at + 1], axes[at + 2])
    while mask:
        one_pose(scratch.poses, bodies.joints[body], first_lane(mask), pose)
        mask &= mask - 1
        if _pose_meets(bodies, parts, body, pose, cloud, scene, obstacles.roots[obstacle], clearance, scratch):
            return True
        keep_direction(work, axes, at, scratch.obstacle_places)
    return False
