"""Whether a robot touches anything at any of sixteen configurations: cheap certain answers first, the exact one last.

Three answers for a body, an obstacle and a lane. *Apart*: no ball of the body's cover, which contains the body, is near
the obstacle. *Touching*: a ball inside the body meets it. Otherwise *maybe*: `bodies_apart` decides on the shapes
themselves. Float32 moves a point by some micrometres; `BAND` keeps that on the safe side: what is within it of contact
may be called touching, what touches is never called apart.
"""

from __future__ import annotations

from numba import boolean, int64, types, void

from guidefield.kernels.lane_decision import meets_obstacle, pair_meets
from guidefield.kernels.lane_kinematics import JOINTS, LaneJoints, lane_placements, moved
from guidefield.kernels.lane_math import PRIMITIVE, Floats32, near_primitive
from guidefield.kernels.lane_tables import (
    BALL,
    BAND,
    BODIES,
    OBSTACLES,
    SCRATCH_MEMORY,
    LaneBodies,
    LaneObstacles,
    Scratch,
)
from guidefield.kernels.lanes import FLOAT_POINTER, LANES, Vector, below, lane_part, lane_step, load, splat, store
from guidefield.kernels.separation import POINTED_PARTS, Parts


@lane_part
def _ball(poses: Floats32, joint: int, balls: Floats32, ball: int) -> tuple[Vector, Vector, Vector]:
    """Centre of a ball that a joint carries."""
    at = 4 * ball
    return moved(poses, joint, balls[at], balls[at + 1], balls[at + 2])


@lane_step(void(BODIES, int64, SCRATCH_MEMORY))
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


@lane_step(int64(BODIES, OBSTACLES, types.float64, SCRATCH_MEMORY))
def _near_obstacles(bodies: LaneBodies, obstacles: LaneObstacles, clearance: float, scratch: Scratch) -> int:
    """Find bodies near obstacles by the balls about them; how many, or -1 if an inner ball is in an obstacle."""
    poses, found, bounds, inner = scratch.poses, scratch.found, bodies.bounds, bodies.inner
    kinds, primitives, tested = obstacles.kinds, obstacles.primitives, obstacles.tested
    n, count = obstacles.size, 0
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


@lane_step(int64(BODIES, OBSTACLES, types.float64, int64, SCRATCH_MEMORY))
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


@lane_step(int64(BODIES, int64, int64, SCRATCH_MEMORY))
def _bounds_meet(bodies: LaneBodies, first: int, second: int, scratch: Scratch) -> int:
    """Mask of the lanes where the balls about two bodies meet."""
    poses, bounds = scratch.poses, bodies.bounds
    x, y, z = _ball(poses, bodies.joints[first], bounds, first)
    u, v, w = _ball(poses, bodies.joints[second], bounds, second)
    x, y, z, reach = x - u, y - v, z - w, bounds[4 * first + 3] + bounds[4 * second + 3] + BAND
    return int(below(x * x + y * y + z * z, splat(reach * reach)))


@lane_step(
    boolean(JOINTS, BODIES, POINTED_PARTS, OBSTACLES, POINTED_PARTS, types.float64, FLOAT_POINTER, SCRATCH_MEMORY)
)
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
        joints: The robot's joints.
        bodies: Its bodies.
        parts: Their shapes.
        obstacles: What is around it.
        scene: Its shapes.
        clearance: What it has to keep from obstacles [m], >= 0.
        coordinates: Sixteen values of each chart coordinate, flat, (nv * 16).
        scratch: Memory.
    """
    lane_placements(joints, coordinates, scratch.poses)
    count = _near_obstacles(bodies, obstacles, clearance, scratch)
    if count < 0:
        return True
    placed, found = scratch.placed, scratch.found
    for body in range(bodies.size):
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
            if meets_obstacle(bodies, parts, body, other, obstacles, scene, mask, clearance, scratch):
                return True
        elif pair_meets(bodies, parts, other, mask, scratch):
            return True
    return False
