"""The exact decision for bodies that may touch, lane by lane; each lane's separating axis is tried on all others."""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, int64, types

from guidefield.kernels.lane_kinematics import POSE
from guidefield.kernels.lane_math import Floats32
from guidefield.kernels.lane_tables import (
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
    FLOAT_POINTER,
    LANES,
    Vector,
    below,
    f32x16,
    first_lane,
    lane_part,
    lane_step,
    largest_lane,
    largest_of,
    load,
    smallest_of,
    splat,
)
from guidefield.kernels.separation import AXIS, BLOCK, POINTED_PARTS, POLYTOPE, Parts, bodies_apart, reach_along
from guidefield.kernels.signatures import Floats


@lane_part
def _pose(poses: Floats32, joint: int, chosen: int, pose_out: Floats) -> None:
    """A joint's placement (12) in one lane."""
    for entry in range(12):
        pose_out[entry] = poses[joint * POSE + entry * LANES + chosen]


@lane_part
def _turned(pose: Floats, source: Floats, start: int, target: Floats, at: int) -> None:
    """Write the rotation of a pose times three numbers."""
    x, y, z = source[start], source[start + 1], source[start + 2]
    for r in range(3):
        target[at + r] = pose[4 * r] * x + pose[4 * r + 1] * y + pose[4 * r + 2] * z


@lane_part
def _turned_back(pose: Floats, source: Floats, start: int, target: Floats, at: int) -> None:
    """Write the inverse rotation of a pose times three numbers."""
    x, y, z = source[start], source[start + 1], source[start + 2]
    for c in range(3):
        target[at + c] = pose[c] * x + pose[4 + c] * y + pose[8 + c] * z


@lane_part
def _polytope(parts: Parts, root: int) -> int:
    """The polytope that a body is or is contained in, as a part; -1 if there is none."""
    part = parts.links[3 * root + 2]
    return part if part >= 0 and parts.shapes[3 * part] == POLYTOPE else -1


@lane_step(f32x16(POINTED_PARTS, int64, FLOAT_POINTER, int64, f32x16, f32x16, f32x16))
def _lowest(parts: Parts, part: int, poses: Floats32, joint: int, u: Vector, v: Vector, w: Vector) -> Vector:
    """The least n.x over the vertices x of a polytope that a joint carries, for an axis n = (u, v, w) in the world."""
    at, vertices = joint * POSE, parts.vertices
    x = load(poses, at) * u + load(poses, at + 64) * v + load(poses, at + 128) * w
    y = load(poses, at + 16) * u + load(poses, at + 80) * v + load(poses, at + 144) * w
    z = load(poses, at + 32) * u + load(poses, at + 96) * v + load(poses, at + 160) * w
    lowest = splat(1e30)
    first = parts.shapes[3 * part + 1]
    for block in range(first, first + parts.shapes[3 * part + 2]):
        for corner in range(block * BLOCK, block * BLOCK + LANES):
            along = x * vertices[corner] + y * vertices[corner + 16] + z * vertices[corner + 32]
            lowest = smallest_of(lowest, along)
    return lowest + load(poses, at + 48) * u + load(poses, at + 112) * v + load(poses, at + 176) * w


@lane_part
def _unit(work: Floats) -> None:
    """Make the last separating axis one long."""
    length = max(math.sqrt(work[AXIS] ** 2 + work[AXIS + 1] ** 2 + work[AXIS + 2] ** 2), 1e-30)
    for k in range(3):
        work[AXIS + k] /= length


@lane_step(int64(BODIES, POINTED_PARTS, int64, int64, OBSTACLES, POINTED_PARTS, int64, types.float64, SCRATCH_MEMORY))
def _left_of_obstacle(
    bodies: LaneBodies,
    parts: Parts,
    body: int,
    obstacle: int,
    obstacles: LaneObstacles,
    scene: Parts,
    mask: int,
    clearance: float,
    scratch: Scratch,
) -> int:
    """The lanes of a mask where the last axis that separated body and obstacle does not; it is fixed in the world."""
    axes, at = scratch.obstacle_axes, 3 * (body * obstacles.size + obstacle)
    x, y, z = axes[at], axes[at + 1], axes[at + 2]
    part = _polytope(parts, bodies.roots[body])
    other = scene.links[3 * obstacles.roots[obstacle] + 2]
    if part < 0 or other < 0 or (x == 0.0 and y == 0.0 and z == 0.0):
        return mask
    highest = reach_along(scene, other, scratch.work, x, y, z)
    u, v, w = splat(x), splat(y), splat(z)
    lowest = _lowest(parts, part, scratch.poses, bodies.joints[body], u, v, w)
    return int(mask & below(lowest, splat(highest + clearance + BAND)))


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
    at, margin = 3 * (body * obstacles.size + obstacle), clearance + DECISION_BAND
    for entry in range(12):
        pose_b[entry] = 1.0 if entry in (0, 5, 10) else 0.0
    while True:
        mask = _left_of_obstacle(bodies, parts, body, obstacle, obstacles, scene, mask, clearance, scratch)
        if mask == 0:
            return False
        _pose(scratch.poses, bodies.joints[body], first_lane(mask), pose_a)
        mask &= mask - 1
        for k in range(3):
            work[AXIS + k] = axes[at + k]
        if not bodies_apart(parts, bodies.roots[body], pose_a, scene, obstacles.roots[obstacle], pose_b, margin, work):
            return True
        _unit(work)
        for k in range(3):
            axes[at + k] = work[AXIS + k]


@lane_step(int64(BODIES, POINTED_PARTS, int64, int64, SCRATCH_MEMORY))
def _left_of_pair(bodies: LaneBodies, parts: Parts, pair: int, mask: int, scratch: Scratch) -> int:
    """The lanes of a mask where the last axis that separated a pair does not; it is fixed in the first body."""
    poses, axes, vertices, shapes = scratch.poses, scratch.pair_axes, parts.vertices, parts.shapes
    first, second = bodies.pairs[2 * pair], bodies.pairs[2 * pair + 1]
    part_a, part_b = _polytope(parts, bodies.roots[first]), _polytope(parts, bodies.roots[second])
    x, y, z = np.float32(axes[3 * pair]), np.float32(axes[3 * pair + 1]), np.float32(axes[3 * pair + 2])
    if part_a < 0 or part_b < 0 or (x == 0.0 and y == 0.0 and z == 0.0):
        return mask
    deepest = splat(-1e30)
    for block in range(shapes[3 * part_a + 1], shapes[3 * part_a + 1] + shapes[3 * part_a + 2]):
        at = block * BLOCK
        along = load(vertices, at) * x + load(vertices, at + 16) * y + load(vertices, at + 32) * z
        deepest = largest_of(deepest, -along)
    a = bodies.joints[first] * POSE
    u = load(poses, a) * x + load(poses, a + 16) * y + load(poses, a + 32) * z
    v = load(poses, a + 64) * x + load(poses, a + 80) * y + load(poses, a + 96) * z
    w = load(poses, a + 128) * x + load(poses, a + 144) * y + load(poses, a + 160) * z
    lowest = load(poses, a + 48) * u + load(poses, a + 112) * v + load(poses, a + 176) * w - largest_lane(deepest)
    highest = -_lowest(parts, part_b, poses, bodies.joints[second], -u, -v, -w)
    return int(mask & below(lowest - highest, splat(BAND)))


@lane_step(boolean(BODIES, POINTED_PARTS, int64, int64, SCRATCH_MEMORY))
def pair_meets(bodies: LaneBodies, parts: Parts, pair: int, mask: int, scratch: Scratch) -> bool:
    """Whether the bodies of a pair touch in any lane of a mask; as `meets_obstacle`."""
    work, pose_a, pose_b, axes = scratch.work, scratch.pose_a, scratch.pose_b, scratch.pair_axes
    first, second = bodies.pairs[2 * pair], bodies.pairs[2 * pair + 1]
    while True:
        mask = _left_of_pair(bodies, parts, pair, mask, scratch)
        if mask == 0:
            return False
        chosen = first_lane(mask)
        mask &= mask - 1
        _pose(scratch.poses, bodies.joints[first], chosen, pose_a)
        _pose(scratch.poses, bodies.joints[second], chosen, pose_b)
        _turned(pose_a, axes, 3 * pair, work, AXIS)
        if not bodies_apart(
            parts, bodies.roots[first], pose_a, parts, bodies.roots[second], pose_b, DECISION_BAND, work
        ):
            return True
        _unit(work)
        _turned_back(pose_a, work, AXIS, axes, 3 * pair)
