"""The exact decision for bodies that may touch, lane by lane; each lane's separating axis is tried on all others."""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, int64, types

from guidefield.kernels.lane_kinematics import POSE, moved
from guidefield.kernels.lane_math import Floats32
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
    LANES,
    Vector,
    below,
    f32x16,
    first_lane,
    lane_part,
    lane_step,
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


@lane_part
def _turned_axis(poses: Floats32, joint: int, u: Vector, v: Vector, w: Vector) -> tuple[Vector, Vector, Vector, Vector]:
    """An axis in the world in a joint's frame, and the place of that frame's origin along it."""
    at = joint * POSE
    return (
        load(poses, at) * u + load(poses, at + 64) * v + load(poses, at + 128) * w,
        load(poses, at + 16) * u + load(poses, at + 80) * v + load(poses, at + 144) * w,
        load(poses, at + 32) * u + load(poses, at + 96) * v + load(poses, at + 160) * w,
        load(poses, at + 48) * u + load(poses, at + 112) * v + load(poses, at + 176) * w,
    )


@lane_step(f32x16(POINTED_PARTS, int64, f32x16, f32x16, f32x16))
def _lowest_vertex(parts: Parts, part: int, x: Vector, y: Vector, z: Vector) -> Vector:
    """The least n.v over the vertices v of a polytope, for an axis n = (x, y, z) in its frame."""
    vertices, first, lowest = parts.vertices, parts.shapes[3 * part + 1], splat(1e30)
    for block in range(first, first + parts.shapes[3 * part + 2]):
        for corner in range(block * BLOCK, block * BLOCK + LANES):
            along = x * vertices[corner] + y * vertices[corner + 16] + z * vertices[corner + 32]
            lowest = smallest_of(lowest, along)
    return lowest


@lane_part
def _lowest_ball(bodies: LaneBodies, body: int, x: Vector, y: Vector, z: Vector) -> Vector:
    """The least n.x over the points x of a body's cover, for an axis n = (x, y, z) in its joint's frame."""
    cover, lowest = bodies.cover, splat(1e30)
    for ball in range(bodies.covers[bodies.groups[body]], bodies.covers[bodies.groups[body + 1]]):
        along = x * cover[4 * ball] + y * cover[4 * ball + 1] + z * cover[4 * ball + 2] - cover[4 * ball + 3]
        lowest = smallest_of(lowest, along)
    return lowest


@lane_part
def _keep_axis(parts: Parts, root: int, work: Floats, pose: Floats, way: float, axes: Floats, at: int) -> None:
    """Keep the axis that separated, of length 1 and in the frame of a pose, and how far a body reaches along it.

    `way` is 1, or -1 where the body's reach against the axis is wanted.
    """
    length = max(math.sqrt(work[AXIS] ** 2 + work[AXIS + 1] ** 2 + work[AXIS + 2] ** 2), 1e-30)
    for k in range(3):
        work[AXIS + k] /= length
    _turned_back(pose, work, AXIS, axes, at)
    part = parts.links[3 * root + 2]
    axes[at + 3] = np.inf
    if part >= 0:
        axes[at + 3] = reach_along(parts, part, work, way * axes[at], way * axes[at + 1], way * axes[at + 2])


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
    u, v, w, origin = _turned_axis(scratch.poses, bodies.joints[body], splat(x), splat(y), splat(z))
    left = mask & below(_lowest_ball(bodies, body, u, v, w) + origin, enough)
    part = _polytope(parts, bodies.roots[body])
    if closely and left and part >= 0:
        left &= below(_lowest_vertex(parts, part, u, v, w) + origin, enough)
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
        _pose(scratch.poses, bodies.joints[body], first_lane(mask), pose_a)
        mask &= mask - 1
        for k in range(3):
            work[AXIS + k] = axes[at + k]
        if not bodies_apart(parts, bodies.roots[body], pose_a, scene, root, pose_b, margin, work):
            return True
        _keep_axis(scene, root, work, pose_b, 1.0, axes, at)


@lane_step(int64(BODIES, POINTED_PARTS, int64, int64, int64, int64, int64, int64, SCRATCH_MEMORY))
def _left_of_pieces(
    bodies: LaneBodies,
    parts: Parts,
    joint_a: int,
    b: int,
    joint_b: int,
    body_b: int,
    place: int,
    mask: int,
    scratch: Scratch,
) -> int:
    """The lanes of a mask where the last axis that separated two pieces does not; it is fixed in the first one.

    By the vertices of the second one's hull, but first by its body's cover, if the body is given: it is -1 if not.
    """
    poses, axes, at = scratch.poses, scratch.pair_axes, AXIS_AND_REACH * place
    x, y, z = np.float32(axes[at]), np.float32(axes[at + 1]), np.float32(axes[at + 2])
    part = _polytope(parts, bodies.piece_roots[b])
    if x == 0.0 and y == 0.0 and z == 0.0:
        return mask
    a = joint_a * POSE
    u = load(poses, a) * x + load(poses, a + 16) * y + load(poses, a + 32) * z
    v = load(poses, a + 64) * x + load(poses, a + 80) * y + load(poses, a + 96) * z
    w = load(poses, a + 128) * x + load(poses, a + 144) * y + load(poses, a + 160) * z
    lowest = load(poses, a + 48) * u + load(poses, a + 112) * v + load(poses, a + 176) * w - axes[at + 3]
    u, v, w, origin = _turned_axis(poses, joint_b, -u, -v, -w)
    lowest, enough = lowest + origin, splat(BAND)
    if body_b >= 0:
        mask &= below(_lowest_ball(bodies, body_b, u, v, w) + lowest, enough)
    if mask and part >= 0:
        mask &= below(_lowest_vertex(parts, part, u, v, w) + lowest, enough)
    return mask


@lane_step(boolean(BODIES, POINTED_PARTS, int64, int64, int64, int64, int64, int64, int64, SCRATCH_MEMORY))
def _pieces_meet(
    bodies: LaneBodies,
    parts: Parts,
    a: int,
    joint_a: int,
    b: int,
    joint_b: int,
    body_b: int,
    place: int,
    mask: int,
    scratch: Scratch,
) -> bool:
    """Whether two pieces touch in any lane of a mask; as `meets_obstacle`."""
    work, pose_a, pose_b, axes, at = (
        scratch.work,
        scratch.pose_a,
        scratch.pose_b,
        scratch.pair_axes,
        AXIS_AND_REACH * place,
    )
    root_a, root_b = bodies.piece_roots[a], bodies.piece_roots[b]
    while True:
        mask = _left_of_pieces(bodies, parts, joint_a, b, joint_b, body_b, place, mask, scratch)
        if mask == 0:
            return False
        chosen = first_lane(mask)
        mask &= mask - 1
        _pose(scratch.poses, joint_a, chosen, pose_a)
        _pose(scratch.poses, joint_b, chosen, pose_b)
        _turned(pose_a, axes, at, work, AXIS)
        if not bodies_apart(parts, root_a, pose_a, parts, root_b, pose_b, DECISION_BAND, work):
            return True
        _keep_axis(parts, root_a, work, pose_a, -1.0, axes, at)


@lane_step(boolean(BODIES, POINTED_PARTS, int64, int64, SCRATCH_MEMORY))
def pair_meets(bodies: LaneBodies, parts: Parts, pair: int, mask: int, scratch: Scratch) -> bool:
    """Whether the bodies of a pair touch in any lane of a mask: piece by piece."""
    poses, bounds, pieces = scratch.poses, bodies.piece_bounds, bodies.pieces
    first, second, place = bodies.pairs[3 * pair], bodies.pairs[3 * pair + 1], bodies.pairs[3 * pair + 2]
    joint_a, joint_b = bodies.joints[first], bodies.joints[second]
    several = pieces[first + 1] - pieces[first] > 1 or pieces[second + 1] - pieces[second] > 1
    whole = second if pieces[second + 1] - pieces[second] == 1 else -1
    for a in range(pieces[first], pieces[first + 1]):
        x, y, z = moved(poses, joint_a, bounds[4 * a], bounds[4 * a + 1], bounds[4 * a + 2])
        for b in range(pieces[second], pieces[second + 1]):
            near = mask
            if several:
                u, v, w = moved(poses, joint_b, bounds[4 * b], bounds[4 * b + 1], bounds[4 * b + 2])
                u, v, w, reach = u - x, v - y, w - z, bounds[4 * a + 3] + bounds[4 * b + 3] + BAND
                near &= below(u * u + v * v + w * w, splat(reach * reach))
            if near and _pieces_meet(bodies, parts, a, joint_a, b, joint_b, whole, place, near, scratch):
                return True
            place += 1
    return False
