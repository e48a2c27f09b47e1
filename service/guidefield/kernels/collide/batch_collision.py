"""Whether a robot touches obstacles or itself at any of sixteen configurations: what is cheap and tells most, first.

A ball inside a body that met an obstacle lately often does again. Balls about all that a joint carries leave few
obstacles; about those bodies, fewer. A ball inside a body that meets an obstacle is a hit. Where no ball of a body's
cover meets, or the axis that last kept the two apart still does, it is free. What is left is decided exactly, in lanes
as far as that goes. In float32 the cheap tests are off by less than `BAND`: they widen covers and shrink inner balls by
it, so that never a contact passes for free, nor the other way round farther than it.
"""

from __future__ import annotations

from numba import boolean, int64, types

from guidefield.kernels.collide.balls import ball_centre, ball_radius, balls_meet
from guidefield.kernels.collide.broadphase import (
    boxes_near,
    carrier_centre,
    near_obstacle,
    near_obstacle_of,
    place_carriers,
)
from guidefield.kernels.collide.layout import (
    BALL,
    BAND,
    BODIES,
    BODY,
    CLOUD,
    FOUND,
    HIT,
    HITS,
    MASK,
    OBSTACLE,
    OBSTACLES,
    SCRATCH_MEMORY,
    LaneBodies,
    LaneObstacles,
    Scratch,
    carriers_of,
    pair_of,
    pairs_of,
    write_found,
)
from guidefield.kernels.collide.obstacle_narrowphase import left_of_obstacle, meets_cloud, meets_obstacle
from guidefield.kernels.collide.parts import POINTED_PARTS, Parts
from guidefield.kernels.collide.self_collision_cache import left_of_cells
from guidefield.kernels.collide.self_narrowphase import pair_meets
from guidefield.kernels.jit.signatures import FLOAT_POINTER, Floats32, Integers, lane_part, lane_step
from guidefield.kernels.kinematics.batch_forward_kinematics import JOINTS, LaneJoints, lane_placements
from guidefield.kernels.simd.vector import ALL_LANES, LANES, below, first_lane, splat


@lane_part
def _put_first(hits: Integers, body: int, o: int, ball: int, last: int) -> None:
    """Move the hits before one of them on to its place, and put another in front."""
    for k in range(HIT * last + HIT - 1, HIT - 1, -1):
        hits[k] = hits[k - HIT]
    hits[BODY], hits[OBSTACLE], hits[BALL] = body, o, ball


@lane_part
def _met_again(bodies: LaneBodies, obstacles: LaneObstacles, clearance: float, scratch: Scratch) -> bool:
    """Whether one of the inner balls that met an obstacle lately meets the same again."""
    poses, inner, hits = scratch.poses, bodies.inner, scratch.hits
    for k in range(HITS):
        body, o, ball = hits[HIT * k + BODY], hits[HIT * k + OBSTACLE], hits[HIT * k + BALL]
        if body < 0:
            return False
        x, y, z = ball_centre(poses, bodies.joints[body], inner, ball)
        if near_obstacle(obstacles, o, x, y, z, ball_radius(inner, ball) + clearance - BAND, ALL_LANES):
            _put_first(hits, body, o, ball, k)
            return True
    return False


@lane_part
def _met_inside(
    cloudy: bool,
    bodies: LaneBodies,
    body: int,
    obstacles: LaneObstacles,
    o: int,
    near: int,
    clearance: float,
    scratch: Scratch,
) -> bool:
    """`_inner_meets` where it is known whether the obstacle is a cloud."""
    poses, inner, joint = scratch.poses, bodies.inner, bodies.joints[body]
    for ball in range(bodies.inners[body], bodies.inners[body + 1]):
        x, y, z = ball_centre(poses, joint, inner, ball)
        if near & near_obstacle_of(cloudy, obstacles, o, x, y, z, ball_radius(inner, ball) + clearance - BAND, near):
            _put_first(scratch.hits, body, o, ball, HITS - 1)
            return True
    return False


@lane_step(boolean(BODIES, int64, OBSTACLES, int64, int64, types.float64, SCRATCH_MEMORY))
def _inner_meets(
    bodies: LaneBodies, body: int, obstacles: LaneObstacles, o: int, near: int, clearance: float, scratch: Scratch
) -> bool:
    """Whether a ball inside a body meets an obstacle in any of some lanes."""
    if obstacles.kinds[o] == CLOUD:
        return bool(_met_inside(True, bodies, body, obstacles, o, near, clearance, scratch))
    return bool(_met_inside(False, bodies, body, obstacles, o, near, clearance, scratch))


@lane_part
def _near_obstacles(
    bodies: LaneBodies, parts: Parts, obstacles: LaneObstacles, clearance: float, scratch: Scratch, likely: bool
) -> int:
    """Find bodies near obstacles by the balls about them; how many, or -1 if an inner ball is in an obstacle."""
    poses, centres, found, bounds, n = scratch.poses, scratch.centres, scratch.found, bodies.bounds, obstacles.size
    members, order, count = bodies.members, bodies.order, 0
    for c in range(bodies.moving):
        x, y, z = carrier_centre(centres, c)
        reach, several = ball_radius(bodies.around, c) + clearance + BAND, members[c + 1] - members[c] > 1
        for block in range((n + LANES - 1) // LANES):
            candidates = boxes_near(obstacles.boxes, block, x, y, z, reach)
            while candidates:
                o = block * LANES + first_lane(candidates)
                candidates &= candidates - 1
                mask = near_obstacle(obstacles, o, x, y, z, reach, ALL_LANES)
                if mask == 0:
                    continue
                for k in range(members[c], members[c + 1]):
                    body = order[k]
                    if obstacles.may_touch[body * n + o]:
                        continue
                    near = mask
                    if several:
                        u, v, w = ball_centre(poses, bodies.joints[body], bounds, body)
                        near &= near_obstacle(obstacles, o, u, v, w, ball_radius(bounds, body) + clearance + BAND, near)
                        if near == 0:
                            continue
                    looked_for = likely and obstacles.whole[o]
                    if looked_for and _inner_meets(bodies, body, obstacles, o, near, clearance, scratch):
                        return -1
                    if obstacles.kinds[o] != CLOUD:
                        near = left_of_obstacle(bodies, parts, body, o, obstacles, near, clearance, scratch, False)
                    if near == 0:
                        continue
                    count = write_found(found, count, body, o, near)
    return count


@lane_part
def _met_by_cover(
    cloudy: bool,
    bodies: LaneBodies,
    body: int,
    obstacles: LaneObstacles,
    o: int,
    near: int,
    clearance: float,
    scratch: Scratch,
) -> int:
    """`_cover_meets` where it is known whether the obstacle is a cloud."""
    poses, joint, covers = scratch.poses, bodies.joints[body], bodies.covers
    cover, grouped, reach, mask = bodies.cover, bodies.grouped, clearance + BAND, 0
    for group in range(bodies.groups[body], bodies.groups[body + 1]):
        x, y, z = ball_centre(poses, joint, grouped, group)
        lanes = near & ~mask
        lanes &= near_obstacle_of(cloudy, obstacles, o, x, y, z, ball_radius(grouped, group) + reach, lanes)
        if not lanes:
            continue
        for ball in range(covers[group], covers[group + 1]):
            x, y, z = ball_centre(poses, joint, cover, ball)
            mask |= lanes & near_obstacle_of(cloudy, obstacles, o, x, y, z, ball_radius(cover, ball) + reach, lanes)
        if mask == near:
            break
    return int(mask)


@lane_step(int64(BODIES, int64, OBSTACLES, int64, int64, types.float64, SCRATCH_MEMORY))
def _cover_meets(
    bodies: LaneBodies, body: int, obstacles: LaneObstacles, o: int, near: int, clearance: float, scratch: Scratch
) -> int:
    """The lanes of some where a ball of a body's cover meets an obstacle."""
    if obstacles.kinds[o] == CLOUD:
        return int(_met_by_cover(True, bodies, body, obstacles, o, near, clearance, scratch))
    return int(_met_by_cover(False, bodies, body, obstacles, o, near, clearance, scratch))


@lane_part
def _undecided_obstacles(
    bodies: LaneBodies, obstacles: LaneObstacles, clearance: float, count: int, scratch: Scratch
) -> int:
    """Keep of what is near only what the covers can't tell apart; how many."""
    found, kept = scratch.found, 0
    for entry in range(count):
        at = FOUND * entry
        body, o = found[at + BODY], found[at + OBSTACLE]
        mask = _cover_meets(bodies, body, obstacles, o, found[at + MASK], clearance, scratch)
        if mask:
            kept = write_found(found, kept, body, o, mask)
    return kept


@lane_part
def _near_pairs(
    joints: LaneJoints, bodies: LaneBodies, parts: Parts, count: int, coordinates: Floats32, scratch: Scratch
) -> int:
    """Add the pairs of the robot's bodies that come near each other to what was found; how many that is now.

    -1 if any touch by their cells.
    """
    poses, centres, bounds, found = scratch.poses, scratch.centres, bodies.bounds, scratch.found
    for meeting in range(bodies.n_meetings):
        a, b = carriers_of(bodies, meeting)
        x, y, z = carrier_centre(centres, a)
        u, v, w = carrier_centre(centres, b)
        x, y, z = x - u, y - v, z - w
        reach = ball_radius(bodies.around, a) + ball_radius(bodies.around, b) + BAND
        near = below(x * x + y * y + z * z, splat(reach * reach))
        if near:
            near = left_of_cells(joints, bodies, parts, meeting, near, coordinates, scratch)
            if near < 0:
                return -1
        if near == 0:
            continue
        first_pair, past_pair = pairs_of(bodies, meeting)
        for pair in range(first_pair, past_pair):
            first, second = pair_of(bodies, pair)
            joint_a, joint_b = bodies.joints[first], bodies.joints[second]
            mask = near & balls_meet(poses, joint_a, first, joint_b, second, bounds, BAND)
            if mask:
                count = write_found(found, count, -1, pair, mask)
    return count


@lane_step(
    boolean(
        JOINTS, BODIES, POINTED_PARTS, OBSTACLES, POINTED_PARTS, types.float64, FLOAT_POINTER, SCRATCH_MEMORY, boolean
    )
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
    likely: bool,
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
        likely: Whether a contact is likely: else it is not looked for with what finds one sooner.
    """
    found = scratch.found
    lane_placements(joints, coordinates, scratch.poses)
    if likely and _met_again(bodies, obstacles, clearance, scratch):
        return True
    place_carriers(bodies, scratch)
    count = _near_obstacles(bodies, parts, obstacles, clearance, scratch, likely)
    if count < 0:
        return True
    count = _undecided_obstacles(bodies, obstacles, clearance, count, scratch)
    count = _near_pairs(joints, bodies, parts, count, coordinates, scratch)
    for entry in range(count):
        at = FOUND * entry
        body, other, mask = found[at + BODY], found[at + OBSTACLE], found[at + MASK]
        if body < 0:
            touches = pair_meets(bodies, parts, other, mask, scratch)
        elif obstacles.kinds[other] == CLOUD:
            touches = meets_cloud(bodies, parts, body, other, obstacles, scene, mask, clearance, scratch)
        else:
            touches = meets_obstacle(bodies, parts, body, other, obstacles, scene, mask, clearance, scratch)
        if touches:
            return True
    return bool(count < 0)
