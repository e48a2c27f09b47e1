"""Whether a robot touches anything at any of sixteen configurations: cheap certain answers first, the exact one last.

Three answers for a body, an obstacle and a lane. *Apart*: no ball of the body's cover, which contains the body, is near
the obstacle. *Touching*: a ball inside the body meets it. Otherwise *maybe*: `bodies_apart` decides on the shapes
themselves. Float32 moves a point by some micrometres; `BAND` keeps that on the safe side: what is within it of contact
may be called touching, what touches is never called apart.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import boolean, int64, types, void

from guidefield.kernels.lane_kinematics import JOINTS, POSE, LaneJoints, lane_placements, moved
from guidefield.kernels.lane_math import PRIMITIVE, Floats32, near_primitive
from guidefield.kernels.lanes import (
    FLOAT_POINTER,
    FLOATS,
    FLOATS_OUT,
    INTEGERS_OUT,
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
    pointed,
    smallest_of,
    splat,
    store,
)
from guidefield.kernels.separation import AXIS, BLOCK, POINTED_PARTS, POLYTOPE, Parts, bodies_apart, reach_along
from guidefield.kernels.signatures import VECTOR_OUT, Floats
from guidefield.kernels.tree_kinematics import INDICES

BAND = 1e-5
"""Within this of contact [m] either answer may come."""

DECISION_BAND = 2e-6
"""What the exact decision keeps of it [m]: more than the error of a placement in float32."""

BALL = 3 * LANES
"""Floats of a ball's centre in sixteen lanes."""


class LaneBodies(NamedTuple):
    """The robot's bodies; lengths [m] in the frame of the joint that carries a body.

    Attributes:
        count: n.
        moving: m.
        n_pairs: p.
        joints: (n,) the joint that carries each.
        covers: (n + 1,) where each body's cover begins in `cover`.
        inners: (n + 1,) where its inner balls begin in `inner`.
        roots: (n,) its root in the robot's parts.
        order: (m,) the bodies that move in the world, in the order in which they are tested: those far out first.
        pairs: (2 * p,) bodies that must not touch each other.
        bounds: (4 * n,) a ball about each body's cover.
        cover: (4 * c,) balls that contain the bodies.
        inner: (4 * i,) balls that are inside them.
    """

    count: int
    moving: int
    n_pairs: int
    joints: np.ndarray
    covers: np.ndarray
    inners: np.ndarray
    roots: np.ndarray
    order: np.ndarray
    pairs: np.ndarray
    bounds: np.ndarray
    cover: np.ndarray
    inner: np.ndarray


class LaneObstacles(NamedTuple):
    """Obstacles, in the world [m]; one of many triangles stands as several.

    Attributes:
        count: n.
        kinds: (n,) lane_math's kind of the primitive that contains each.
        whole: (n,) 1 where that primitive is the obstacle itself, else 0.
        roots: (n,) its root in the scene's parts.
        tested: (bodies * n,) 1 where the body must not touch it.
        primitives: (PRIMITIVE * n,) float32.
    """

    count: int
    kinds: np.ndarray
    whole: np.ndarray
    roots: np.ndarray
    tested: np.ndarray
    primitives: np.ndarray


class Scratch(NamedTuple):
    """Memory that a search uses again and again; its contents mean nothing between calls.

    Attributes:
        poses: (joints * POSE,) placements; the world's is written once.
        centres: (cover * BALL,) centres of cover balls.
        placed: (bodies,) whether a body's are up to date.
        found: (3 * (bodies * obstacles + pairs),) what is near what: body, obstacle and mask, or -1, pair and mask.
        obstacle_axes: (3 * bodies * obstacles,) the axis that last separated them, in the world; 0 where there is none.
        pair_axes: (3 * pairs,) the axis that last separated each pair, in the first one's frame; 0 where there is none.
        pose_a, pose_b: (12,) each.
        work: (WORK,).
    """

    poses: np.ndarray
    centres: np.ndarray
    placed: np.ndarray
    found: np.ndarray
    obstacle_axes: np.ndarray
    pair_axes: np.ndarray
    pose_a: np.ndarray
    pose_b: np.ndarray
    work: np.ndarray


LANE_BODIES = types.NamedTuple([*[types.int64] * 3, *[INDICES] * 6, *[FLOATS] * 3], LaneBodies)
LANE_OBSTACLES = types.NamedTuple([types.int64, *[INDICES] * 4, FLOATS], LaneObstacles)
SCRATCH = types.NamedTuple([*[FLOATS_OUT] * 2, *[INTEGERS_OUT] * 2, *[VECTOR_OUT] * 5], Scratch)

_BODIES, _OBSTACLES, _SCRATCH = pointed(LANE_BODIES), pointed(LANE_OBSTACLES), pointed(SCRATCH)


@lane_part
def _ball(poses: Floats32, joint: int, balls: Floats32, ball: int) -> tuple[Vector, Vector, Vector]:
    """Centre of a ball that a joint carries."""
    at = 4 * ball
    return moved(poses, joint, balls[at], balls[at + 1], balls[at + 2])


@lane_step(void(_BODIES, int64, _SCRATCH))
def _place_cover(bodies: LaneBodies, body: int, scratch: Scratch) -> None:
    """Bring a body's cover to where the body is, unless it has been."""
    poses, centres, cover = scratch.poses, scratch.centres, bodies.cover
    if scratch.placed[body]:
        return
    scratch.placed[body] = 1
    for ball in range(bodies.covers[body], bodies.covers[body + 1]):
        x, y, z = _ball(poses, bodies.joints[body], cover, ball)
        store(centres, ball * BALL, x)
        store(centres, ball * BALL + LANES, y)
        store(centres, ball * BALL + 2 * LANES, z)


@lane_step(int64(_BODIES, _OBSTACLES, types.float64, _SCRATCH))
def _near_obstacles(bodies: LaneBodies, obstacles: LaneObstacles, clearance: float, scratch: Scratch) -> int:
    """Find bodies near obstacles by the balls about them; how many, or -1 if an inner ball is in an obstacle."""
    poses, found, bounds, inner = scratch.poses, scratch.found, bodies.bounds, bodies.inner
    kinds, primitives, tested = obstacles.kinds, obstacles.primitives, obstacles.tested
    n, count = obstacles.count, 0
    for k in range(bodies.moving):
        body = bodies.order[k]
        joint = bodies.joints[body]
        x, y, z = _ball(poses, joint, bounds, body)
        reach = bounds[4 * body + 3] + clearance + BAND
        for o in range(n):
            if not tested[body * n + o]:
                continue
            mask = near_primitive(kinds[o], primitives, o * PRIMITIVE, x, y, z, reach)
            if mask == 0:
                continue
            if obstacles.whole[o]:
                for ball in range(bodies.inners[body], bodies.inners[body + 1]):
                    bx, by, bz = _ball(poses, joint, inner, ball)
                    radius = inner[4 * ball + 3] + clearance - BAND
                    if near_primitive(kinds[o], primitives, o * PRIMITIVE, bx, by, bz, radius):
                        return -1
            found[3 * count], found[3 * count + 1], found[3 * count + 2] = body, o, mask
            count += 1
    return count


@lane_step(int64(_BODIES, _OBSTACLES, types.float64, int64, _SCRATCH))
def _undecided_obstacles(
    bodies: LaneBodies, obstacles: LaneObstacles, clearance: float, count: int, scratch: Scratch
) -> int:
    """Keep of what is near only what the covers can't tell apart; how many."""
    found, centres, cover = scratch.found, scratch.centres, bodies.cover
    kept = 0
    for entry in range(count):
        body, o, near = found[3 * entry], found[3 * entry + 1], found[3 * entry + 2]
        kind = obstacles.kinds[o]
        _place_cover(bodies, body, scratch)
        mask = 0
        for ball in range(bodies.covers[body], bodies.covers[body + 1]):
            x, y, z = (
                load(centres, ball * BALL),
                load(centres, ball * BALL + LANES),
                load(centres, ball * BALL + 2 * LANES),
            )
            reach = cover[4 * ball + 3] + clearance + BAND
            mask |= near_primitive(kind, obstacles.primitives, o * PRIMITIVE, x, y, z, reach)
            if mask & near == near:
                break
        if mask & near:
            found[3 * kept], found[3 * kept + 1], found[3 * kept + 2] = body, o, mask & near
            kept += 1
    return kept


@lane_step(int64(_BODIES, int64, int64, _SCRATCH))
def _bounds_meet(bodies: LaneBodies, first: int, second: int, scratch: Scratch) -> int:
    """Mask of the lanes where the balls about two bodies meet."""
    poses, bounds = scratch.poses, bodies.bounds
    x, y, z = _ball(poses, bodies.joints[first], bounds, first)
    u, v, w = _ball(poses, bodies.joints[second], bounds, second)
    x, y, z, reach = x - u, y - v, z - w, bounds[4 * first + 3] + bounds[4 * second + 3] + BAND
    return below(x * x + y * y + z * z, splat(reach * reach))


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


@lane_step(int64(_BODIES, POINTED_PARTS, int64, int64, _OBSTACLES, POINTED_PARTS, int64, types.float64, _SCRATCH))
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
    axes, at = scratch.obstacle_axes, 3 * (body * obstacles.count + obstacle)
    x, y, z = axes[at], axes[at + 1], axes[at + 2]
    part = _polytope(parts, bodies.roots[body])
    other = scene.links[3 * obstacles.roots[obstacle] + 2]
    if part < 0 or other < 0 or (x == 0.0 and y == 0.0 and z == 0.0):
        return mask
    highest = reach_along(scene, other, scratch.work, x, y, z)
    u, v, w = splat(x), splat(y), splat(z)
    lowest = _lowest(parts, part, scratch.poses, bodies.joints[body], u, v, w)
    return mask & below(lowest, splat(highest + clearance + BAND))


@lane_step(boolean(_BODIES, POINTED_PARTS, int64, int64, _OBSTACLES, POINTED_PARTS, int64, types.float64, _SCRATCH))
def _meets_obstacle(
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
    at, margin = 3 * (body * obstacles.count + obstacle), clearance + DECISION_BAND
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


@lane_step(int64(_BODIES, POINTED_PARTS, int64, int64, _SCRATCH))
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
    return mask & below(lowest - highest, splat(BAND))


@lane_step(boolean(_BODIES, POINTED_PARTS, int64, int64, _SCRATCH))
def _meet(bodies: LaneBodies, parts: Parts, pair: int, mask: int, scratch: Scratch) -> bool:
    """Whether the bodies of a pair touch in any lane of a mask; as `_meets_obstacle`."""
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


@lane_step(boolean(JOINTS, _BODIES, POINTED_PARTS, _OBSTACLES, POINTED_PARTS, types.float64, FLOAT_POINTER, _SCRATCH))
def block_touches(
    joints: LaneJoints,
    bodies: LaneBodies,
    parts: Parts,
    obstacles: LaneObstacles,
    scene: Parts,
    clearance: float,
    coordinates: Floats32,
    scratch: Scratch,
) -> bool:
    """Whether the robot touches an obstacle or itself at any of sixteen configurations.

    Args:
        joints, bodies, parts: The robot.
        obstacles, scene: What is around it.
        clearance: What it has to keep from obstacles [m], >= 0.
        coordinates: Sixteen values of each chart coordinate, flat, (nv * 16).
        scratch: Memory.
    """
    lane_placements(joints, coordinates, scratch.poses)
    count = _near_obstacles(bodies, obstacles, clearance, scratch)
    if count < 0:
        return True
    placed, found = scratch.placed, scratch.found
    for body in range(bodies.count):
        placed[body] = 0
    count = _undecided_obstacles(bodies, obstacles, clearance, count, scratch)
    for pair in range(bodies.n_pairs):
        first, second = bodies.pairs[2 * pair], bodies.pairs[2 * pair + 1]
        mask = _bounds_meet(bodies, first, second, scratch)
        if mask:
            found[3 * count], found[3 * count + 1], found[3 * count + 2] = -1, pair, mask
            count += 1
    for entry in range(count):
        body, other, mask = found[3 * entry], found[3 * entry + 1], found[3 * entry + 2]
        if body >= 0:
            if _meets_obstacle(bodies, parts, body, other, obstacles, scene, mask, clearance, scratch):
                return True
        elif _meet(bodies, parts, other, mask, scratch):
            return True
    return False
