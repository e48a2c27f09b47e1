"""Whether a robot touches anything at any of sixteen configurations: cheap certain answers first, the exact one last.

Three answers for a body, an obstacle and a lane. *Apart*: no ball of the body's cover, which contains the body, is near
the obstacle. *Touching*: a ball inside the body meets it. Otherwise *maybe*: `bodies_apart` decides on the shapes
themselves. Float32 moves a point by some micrometres; `BAND` keeps that on the safe side: what is within it of contact
may be called touching, what touches is never called apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import boolean, int64, types, void

from guidefield.kernels.lane_kinematics import LANE_JOINTS, POSE, LaneJoints, lane_placements, moved
from guidefield.kernels.lane_math import PRIMITIVE, Floats32, near_primitive
from guidefield.kernels.lanes import (
    FLOATS,
    FLOATS_OUT,
    LANES,
    Vector,
    below,
    first_lane,
    lane_kernel,
    lane_part,
    load,
    number,
    splat,
    store,
)
from guidefield.kernels.separation import AXIS, PARTS, Parts, bodies_apart
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
        kinds: (n,) lane_math's kind of the primitive that contains each.
        whole: (n,) 1 where that primitive is the obstacle itself, else 0.
        roots: (n,) its root in the scene's parts.
        tested: (bodies * n,) 1 where the body must not touch it.
        primitives: (PRIMITIVE * n,) float32.
    """

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
        found: (3 * (bodies * obstacles + pairs),) what is near what: body, obstacle or body, mask.
        pose_a, pose_b: (12,) each.
        work: (WORK,).
    """

    poses: np.ndarray
    centres: np.ndarray
    placed: np.ndarray
    found: np.ndarray
    pose_a: np.ndarray
    pose_b: np.ndarray
    work: np.ndarray


_INTS_OUT = types.Array(types.int64, 1, "C")
LANE_BODIES = types.NamedTuple([*[INDICES] * 6, *[FLOATS] * 3], LaneBodies)
LANE_OBSTACLES = types.NamedTuple([*[INDICES] * 4, FLOATS], LaneObstacles)
SCRATCH = types.NamedTuple([FLOATS_OUT, FLOATS_OUT, _INTS_OUT, _INTS_OUT, *[VECTOR_OUT] * 3], Scratch)


@lane_part
def _ball(poses: Floats32, joint: int, balls: Floats32, ball: int) -> tuple[Vector, Vector, Vector]:
    """Centre of a ball that a joint carries."""
    at = 4 * ball
    return moved(poses, joint, number(balls, at), number(balls, at + 1), number(balls, at + 2))


@lane_kernel(void(LANE_BODIES, int64, SCRATCH))
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


@lane_kernel(int64(LANE_BODIES, LANE_OBSTACLES, types.float64, SCRATCH))
def _near_obstacles(bodies: LaneBodies, obstacles: LaneObstacles, clearance: float, scratch: Scratch) -> int:
    """Find bodies near obstacles by the balls about them; how many, or -1 if an inner ball is in an obstacle."""
    poses, found, bounds, inner = scratch.poses, scratch.found, bodies.bounds, bodies.inner
    kinds, primitives, tested = obstacles.kinds, obstacles.primitives, obstacles.tested
    n, count = kinds.shape[0], 0
    for k in range(bodies.order.shape[0]):
        body = number(bodies.order, k)
        joint = number(bodies.joints, body)
        x, y, z = _ball(poses, joint, bounds, body)
        reach = number(bounds, 4 * body + 3) + clearance + BAND
        for o in range(n):
            if not number(tested, body * n + o):
                continue
            mask = near_primitive(number(kinds, o), primitives, o * PRIMITIVE, x, y, z, reach)
            if mask == 0:
                continue
            if number(obstacles.whole, o):
                for ball in range(bodies.inners[body], bodies.inners[body + 1]):
                    bx, by, bz = _ball(poses, joint, inner, ball)
                    radius = number(inner, 4 * ball + 3) + clearance - BAND
                    if near_primitive(number(kinds, o), primitives, o * PRIMITIVE, bx, by, bz, radius):
                        return -1
            found[3 * count], found[3 * count + 1], found[3 * count + 2] = body, o, mask
            count += 1
    return count


@lane_kernel(int64(LANE_BODIES, LANE_OBSTACLES, types.float64, int64, SCRATCH))
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
            reach = number(cover, 4 * ball + 3) + clearance + BAND
            mask |= near_primitive(kind, obstacles.primitives, o * PRIMITIVE, x, y, z, reach)
            if mask & near == near:
                break
        if mask & near:
            found[3 * kept], found[3 * kept + 1], found[3 * kept + 2] = body, o, mask & near
            kept += 1
    return kept


@lane_part
def _near_point(centres: Floats32, ball: int, x: Vector, y: Vector, z: Vector, reach: float) -> int:
    """Mask of the lanes where a placed ball's centre is closer than `reach` to a point."""
    dx = load(centres, ball * BALL) - x
    dy = load(centres, ball * BALL + LANES) - y
    dz = load(centres, ball * BALL + 2 * LANES) - z
    return below(dx * dx + dy * dy + dz * dz, splat(reach * reach))


@lane_kernel(int64(LANE_BODIES, int64, int64, SCRATCH))
def _covers_meet(bodies: LaneBodies, first: int, second: int, scratch: Scratch) -> int:
    """Mask of the lanes where the covers of two bodies meet."""
    poses, centres, cover, bounds = scratch.poses, scratch.centres, bodies.cover, bodies.bounds
    x, y, z = _ball(poses, bodies.joints[first], bounds, first)
    u, v, w = _ball(poses, bodies.joints[second], bounds, second)
    radius, other = number(bounds, 4 * first + 3) + BAND, number(bounds, 4 * second + 3) + BAND
    dx, dy, dz = x - u, y - v, z - w
    reach = radius + other
    near = below(dx * dx + dy * dy + dz * dz, splat(reach * reach))
    if near == 0:
        return 0
    _place_cover(bodies, first, scratch)
    _place_cover(bodies, second, scratch)
    mask = 0
    for a in range(bodies.covers[first], bodies.covers[first + 1]):
        ra = number(cover, 4 * a + 3) + BAND
        if _near_point(centres, a, u, v, w, ra + other) == 0:
            continue
        ax, ay, az = load(centres, a * BALL), load(centres, a * BALL + LANES), load(centres, a * BALL + 2 * LANES)
        for b in range(bodies.covers[second], bodies.covers[second + 1]):
            mask |= _near_point(centres, b, ax, ay, az, ra + number(cover, 4 * b + 3))
        if mask & near == near:
            break
    return mask & near


@lane_part
def _pose(poses: Floats32, joint: int, chosen: int, pose_out: Floats) -> None:
    """A joint's placement (12) in one lane."""
    for entry in range(12):
        pose_out[entry] = number(poses, joint * POSE + entry * LANES + chosen)


@lane_kernel(boolean(LANE_BODIES, PARTS, int64, int64, LANE_OBSTACLES, PARTS, int64, types.float64, SCRATCH))
def _touching(
    bodies: LaneBodies,
    parts: Parts,
    body: int,
    other: int,
    obstacles: LaneObstacles,
    scene: Parts,
    mask: int,
    clearance: float,
    scratch: Scratch,
) -> bool:
    """Whether two bodies touch in any lane of a mask; `other` is an obstacle, or -1 - b for the robot's own body b."""
    work, pose_a, pose_b = scratch.work, scratch.pose_a, scratch.pose_b
    work[AXIS] = work[AXIS + 1] = work[AXIS + 2] = 0.0
    for entry in range(12):
        pose_b[entry] = 1.0 if entry in (0, 5, 10) else 0.0
    while mask:
        chosen = first_lane(mask)
        mask &= mask - 1
        _pose(scratch.poses, bodies.joints[body], chosen, pose_a)
        if other >= 0:
            margin = clearance + DECISION_BAND
            if not bodies_apart(parts, bodies.roots[body], pose_a, scene, obstacles.roots[other], pose_b, margin, work):
                return True
        else:
            _pose(scratch.poses, bodies.joints[-1 - other], chosen, pose_b)
            if not bodies_apart(
                parts, bodies.roots[body], pose_a, parts, bodies.roots[-1 - other], pose_b, DECISION_BAND, work
            ):
                return True
    return False


@lane_kernel(boolean(LANE_JOINTS, LANE_BODIES, PARTS, LANE_OBSTACLES, PARTS, types.float64, FLOATS, SCRATCH))
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
    for body in range(placed.shape[0]):
        placed[body] = 0
    count = _undecided_obstacles(bodies, obstacles, clearance, count, scratch)
    for pair in range(bodies.pairs.shape[0] // 2):
        first, second = bodies.pairs[2 * pair], bodies.pairs[2 * pair + 1]
        mask = _covers_meet(bodies, first, second, scratch)
        if mask:
            found[3 * count], found[3 * count + 1], found[3 * count + 2] = first, -1 - second, mask
            count += 1
    for entry in range(count):
        body, other, mask = found[3 * entry], found[3 * entry + 1], found[3 * entry + 2]
        if _touching(bodies, parts, body, other, obstacles, scene, mask, clearance, scratch):
            return True
    return False
