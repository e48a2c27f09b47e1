"""The exact decision for bodies that may touch a cloud: the few balls near a body, by GJK; an axis tells for many."""

from __future__ import annotations

import math

from numba import boolean, float64, int64, types

from guidefield.kernels.collide.gjk import AXIS, POINTED_PARTS, Parts, bodies_apart, reach_along
from guidefield.kernels.collide.layout import (
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
from guidefield.kernels.kinematics.poses import one_pose, placed, turned_back
from guidefield.kernels.simd.blocks import BLOCK
from guidefield.kernels.simd.vector import below, first_lane, load, splat


@lane_step(float64(BODIES, POINTED_PARTS, int64, DOUBLE_POINTER, DOUBLE_POINTER))
def _lowest(bodies: LaneBodies, parts: Parts, body: int, pose: Floats, work: Floats) -> float:
    """The least n.x over the points x of a body in a pose, for the axis n in the scratch space [m]."""
    u, v, w = turned_back(pose, work[AXIS], work[AXIS + 1], work[AXIS + 2])
    origin = work[AXIS] * pose[3] + work[AXIS + 1] * pose[7] + work[AXIS + 2] * pose[11]
    part = parts.links[3 * bodies.roots[body] + 2]
    if part >= 0:
        return float(origin - reach_along(parts, part, work, -u, -v, -w))
    cover, lowest = bodies.cover, math.inf
    for ball in range(bodies.covers[bodies.groups[body]], bodies.covers[bodies.groups[body + 1]]):
        along = u * cover[4 * ball] + v * cover[4 * ball + 1] + w * cover[4 * ball + 2] - cover[4 * ball + 3]
        lowest = min(lowest, along)
    return float(origin + lowest)


@lane_part
def _beyond(cloud: LaneCloud, block: int, work: Floats, lowest: float, grown: float) -> int:
    """Mask of sixteen points that the axis in the scratch space doesn't keep apart from a body."""
    at = block * BLOCK
    along = load(cloud.points, at) * work[AXIS] + load(cloud.points, at + 16) * work[AXIS + 1]
    along = along + load(cloud.points, at + 32) * work[AXIS + 2]
    return int(below(splat(lowest - grown), along))


@lane_step(int64(BODIES, int64, DOUBLE_POINTER, CLOUD_TABLES, int64, float64, int64))
def _in_cover(
    bodies: LaneBodies, group: int, pose: Floats, cloud: LaneCloud, block: int, grown: float, near: int
) -> int:
    """The points of some of sixteen that are within `grown` of a ball in a group of a body's cover."""
    cover, mask = bodies.cover, 0
    for ball in range(bodies.covers[group], bodies.covers[group + 1]):
        x, y, z = placed(pose, cover[4 * ball], cover[4 * ball + 1], cover[4 * ball + 2])
        reach = cover[4 * ball + 3] + grown
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
        x, y, z = placed(pose, grouped[4 * group], grouped[4 * group + 1], grouped[4 * group + 2])
        reach, block = grouped[4 * group + 3] + grown, -1
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
                there[3], there[7], there[11] = cloud.points[at], cloud.points[at + 16], cloud.points[at + 32]
                margin = clearance + DECISION_BAND
                if not bodies_apart(parts, bodies.roots[body], pose, scene, root, there, margin, work):
                    return True
                length = math.sqrt(work[AXIS] ** 2 + work[AXIS + 1] ** 2 + work[AXIS + 2] ** 2)
                known = length > 1e-15
                if known:
                    for k in range(3):
                        work[AXIS + k] /= length
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
    at, cloud = AXIS_AND_REACH * (body * obstacles.size + obstacle), cloud_of(words_at(obstacles.clouds[obstacle]))
    for entry in range(12):
        scratch.pose_b[entry] = 1.0 if entry in (0, 5, 10) else 0.0
    for k in range(3):
        work[AXIS + k] = axes[at + k]
    while mask:
        one_pose(scratch.poses, bodies.joints[body], first_lane(mask), pose)
        mask &= mask - 1
        if _pose_meets(bodies, parts, body, pose, cloud, scene, obstacles.roots[obstacle], clearance, scratch):
            return True
        keep_direction(work, axes, at, scratch.obstacle_places)
    return False
