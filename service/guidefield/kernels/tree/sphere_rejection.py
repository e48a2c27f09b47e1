"""Configurations of sixteen that certainly touch an obstacle, by inscribed spheres of the bodies alone.

What is hit here touches for `block_touches`, too, so to ask first changes no answer. The sixteen may have nothing to do
with each other, and each has its own verdict.
"""

from __future__ import annotations

from numba import int64, types

from guidefield.kernels.collide.balls import ball_centre, ball_radius
from guidefield.kernels.collide.broadphase import boxes_near, carrier_centre, near_obstacle, place_carriers
from guidefield.kernels.collide.layout import (
    BALL,
    BAND,
    BODY,
    HIT,
    OBSTACLE,
    WORLD,
    LaneWorld,
)
from guidefield.kernels.jit.signatures import FLOAT_POINTER, INTEGER_POINTER, Floats32, Integers, lane_part, lane_step
from guidefield.kernels.kinematics.batch_forward_kinematics import lane_placements
from guidefield.kernels.simd.vector import ALL_LANES, LANES, first_lane

SIEVE = 32
"""Number of inner balls that met an obstacle and are tried before any other."""

FEW = 4
"""If they leave at most this many configurations open, all else costs more than it tells."""


@lane_step(int64(WORLD, types.float64, INTEGER_POINTER))
def _hit_again(world: LaneWorld, clearance: float, hits: Integers) -> int:
    """The lanes where one of the balls that met an obstacle lately does so again; such a ball moves on by a place."""
    bodies, obstacles, scratch = world.bodies, world.obstacles, world.scratch
    poses, inner, mask = scratch.poses, bodies.inner, 0
    for k in range(SIEVE):
        body, o, ball = hits[HIT * k + BODY], hits[HIT * k + OBSTACLE], hits[HIT * k + BALL]
        if body < 0:
            break
        x, y, z = ball_centre(poses, bodies.joints[body], inner, ball)
        reach, left = ball_radius(inner, ball) + clearance - BAND, ALL_LANES & ~mask
        new = left & near_obstacle(obstacles, o, x, y, z, reach, left)
        if new == 0:
            continue
        mask |= new
        if mask == ALL_LANES:
            break
        if k > 0:
            for i in range(HIT * k, HIT * k + HIT):
                hits[i - HIT], hits[i] = hits[i], hits[i - HIT]
    return int(mask)


@lane_step(int64(WORLD, int64, int64, int64, types.float64, INTEGER_POINTER))
def _hits_of(world: LaneWorld, body: int, o: int, near: int, clearance: float, hits: Integers) -> int:
    """The lanes of some where a ball inside a body meets an obstacle; such balls are remembered."""
    bodies, obstacles, scratch = world.bodies, world.obstacles, world.scratch
    mask = 0
    for ball in range(bodies.inners[body], bodies.inners[body + 1]):
        x, y, z = ball_centre(scratch.poses, bodies.joints[body], bodies.inner, ball)
        left = near & ~mask
        new = left & near_obstacle(obstacles, o, x, y, z, ball_radius(bodies.inner, ball) + clearance - BAND, left)
        if new:
            mask |= new
            for i in range(HIT * SIEVE - 1, HIT - 1, -1):
                hits[i] = hits[i - HIT]
            hits[BODY], hits[OBSTACLE], hits[BALL] = body, o, ball
    return int(mask)


@lane_part
def _few(lanes: int) -> bool:
    """Tell if a mask has at most `FEW` lanes."""
    for _ in range(FEW):
        lanes &= lanes - 1
    return bool(lanes == 0)


@lane_step(int64(WORLD, types.float64, FLOAT_POINTER, INTEGER_POINTER))
def certain_hits(world: LaneWorld, clearance: float, coordinates: Floats32, hits: Integers) -> int:
    """Mask of lanes where a ball inside a body meets an obstacle; some where one does may be missing.

    Args:
        world: Robot and obstacles.
        clearance: What it has to keep from obstacles [m], >= 0.
        coordinates: Sixteen values of each chart coordinate, flat, (nv * 16).
        hits: (HIT * SIEVE,) balls that met an obstacle lately: body, obstacle, ball; -1 where there is none; changed.
    """
    joints, bodies, obstacles, scratch = world.joints, world.bodies, world.obstacles, world.scratch
    lane_placements(joints, coordinates, scratch.poses)
    mask = _hit_again(world, clearance, hits)
    if _few(ALL_LANES & ~mask):
        return mask
    place_carriers(bodies, scratch)
    poses, centres, members, n = scratch.poses, scratch.centres, bodies.members, obstacles.size
    for c in range(bodies.moving):
        x, y, z = carrier_centre(centres, c)
        reach, several = ball_radius(bodies.around, c) + clearance, members[c + 1] - members[c] > 1
        for block in range((n + LANES - 1) // LANES):
            candidates = boxes_near(obstacles.boxes, block, x, y, z, reach)
            while candidates:
                o = block * LANES + first_lane(candidates)
                candidates &= candidates - 1
                about = near_obstacle(obstacles, o, x, y, z, reach, ALL_LANES & ~mask)
                if obstacles.whole[o] == 0 or about & ~mask == 0:
                    continue
                for k in range(members[c], members[c + 1]):
                    body, near = bodies.order[k], about & ~mask
                    if near and several:
                        u, v, w = ball_centre(poses, bodies.joints[body], bodies.bounds, body)
                        near &= near_obstacle(obstacles, o, u, v, w, ball_radius(bodies.bounds, body) + clearance, near)
                    if near and not obstacles.may_touch[body * n + o]:
                        mask |= _hits_of(world, body, o, near, clearance, hits)
                if mask == ALL_LANES:
                    return mask
    return int(mask)
