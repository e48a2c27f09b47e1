"""Collision tests of a robot against obstacles and itself at sixteen configurations at once, along motions and paths.

Tests go from cheap to exact. An inner ball that met an obstacle lately often does again. Balls about all bodies of a
joint leave few obstacles, balls about each body fewer. An inner ball that meets an obstacle is a contact, and alone
finds one wholly inside a mesh. A pair is free where no ball of the body's cover meets, or the axis that last separated
both still does. GJK decides the rest. In float32 the cheap tests are off by less than `BAND`: they widen covers and
shrink inner balls by it, so that no contact passes for free, and nothing farther away counts as one. Search trees and
shortcuts call `motion_free`; a search that is to be repeatable has to `forget` hits and axes first.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, int64, types, void

from guidefield.kernels.collide.broadphase import (
    boxes_near,
    link_centre,
    meets_drifting,
    near_obstacle,
    near_obstacle_of,
    place_links,
)
from guidefield.kernels.collide.layout import (
    BALL,
    BAND,
    BODY,
    CLOUD,
    FOUND,
    HIT,
    HITS,
    MASK,
    OBSTACLE,
    WORLD,
    BatchWorld,
    links_of,
    pair_of,
    pairs_of,
    robot_of,
    world_of,
    write_found,
)
from guidefield.kernels.collide.obstacle_narrowphase import forget_axes, left_of_obstacle, meets_cloud, meets_obstacle
from guidefield.kernels.collide.parts import ball_centre, ball_radius, balls_meet
from guidefield.kernels.collide.self_narrowphase import left_of_cells, pair_meets
from guidefield.kernels.jit.arrays import FLOAT_POINTER, Floats32, Indices, Integers, SingleRows, TruthsOut
from guidefield.kernels.jit.decorators import vector_kernel, vector_part, vector_step
from guidefield.kernels.kinematics.batch_forward_kinematics import batch_placements
from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.simd.vector import ALL_LANES, LANES, below, first_lane, load, splat, store


@vector_part
def _put_first(hits: Integers, body: int, o: int, ball: int, last: int) -> None:
    """Move the hits before one of them on to its place, and put another in front."""
    for k in range(HIT * last + HIT - 1, HIT - 1, -1):
        hits[k] = hits[k - HIT]
    hits[BODY], hits[OBSTACLE], hits[BALL] = body, o, ball


@vector_part
def _meets_again(world: BatchWorld, clearance: float) -> bool:
    """Tell if one of the inner balls that met an obstacle lately meets the same again."""
    bodies, obstacles, scratch = world.bodies, world.obstacles, world.scratch
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


@vector_part
def _meets_inside(world: BatchWorld, cloudy: bool, body: int, o: int, near: int, clearance: float) -> bool:
    """`_inner_meets` where it is known whether the obstacle is a cloud."""
    bodies, obstacles, scratch = world.bodies, world.obstacles, world.scratch
    poses, inner, joint = scratch.poses, bodies.inner, bodies.joints[body]
    for ball in range(bodies.inners[body], bodies.inners[body + 1]):
        x, y, z = ball_centre(poses, joint, inner, ball)
        if near & near_obstacle_of(cloudy, obstacles, o, x, y, z, ball_radius(inner, ball) + clearance - BAND, near):
            _put_first(scratch.hits, body, o, ball, HITS - 1)
            return True
    return False


@vector_step(boolean(WORLD, int64, int64, int64, types.float64))
def _inner_meets(world: BatchWorld, body: int, o: int, near: int, clearance: float) -> bool:
    """Return if an inscribed sphere of a body meets an obstacle in any lane of the mask `near`."""
    obstacles = world.obstacles
    if obstacles.kinds[o] == CLOUD:
        return bool(_meets_inside(world, True, body, o, near, clearance))
    return bool(_meets_inside(world, False, body, o, near, clearance))


@vector_part
def _list_near_obstacles(world: BatchWorld, clearance: float, likely: bool) -> int:
    """Write pairs of body and obstacle whose bounding balls meet; how many, -1 if an inner ball is in an obstacle."""
    bodies, obstacles, scratch = world.bodies, world.obstacles, world.scratch
    poses, centres, found, bounds, n = scratch.poses, scratch.centres, scratch.found, bodies.bounds, obstacles.size
    members, order, count = bodies.members, bodies.order, 0
    for c in range(bodies.moving):
        x, y, z = link_centre(centres, c)
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
                    if obstacles.ignored[body * n + o]:
                        continue
                    near = mask
                    if several:
                        u, v, w = ball_centre(poses, bodies.joints[body], bounds, body)
                        near &= near_obstacle(obstacles, o, u, v, w, ball_radius(bounds, body) + clearance + BAND, near)
                        if near == 0:
                            continue
                    looked_for = likely and obstacles.whole[o]
                    if looked_for and _inner_meets(world, body, o, near, clearance):
                        return -1
                    if obstacles.kinds[o] != CLOUD:
                        near = left_of_obstacle(world, body, o, near, clearance, False)
                    if near == 0:
                        continue
                    count = write_found(found, count, body, o, near)
    return count


@vector_part
def _meets_by_cover(world: BatchWorld, cloudy: bool, body: int, o: int, near: int, clearance: float) -> int:
    """`_cover_meets` where it is known whether the obstacle is a cloud."""
    bodies, obstacles, scratch = world.bodies, world.obstacles, world.scratch
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


@vector_step(int64(WORLD, int64, int64, int64, types.float64))
def _cover_meets(world: BatchWorld, body: int, o: int, near: int, clearance: float) -> int:
    """Return the lanes of the mask `near` where a bounding sphere of a body meets an obstacle."""
    obstacles = world.obstacles
    if obstacles.kinds[o] == CLOUD:
        return int(_meets_by_cover(world, True, body, o, near, clearance))
    return int(_meets_by_cover(world, False, body, o, near, clearance))


@vector_part
def _keep_undecided(world: BatchWorld, clearance: float, count: int) -> int:
    """Keep of `count` near pairs those that the bodies' covers can't tell apart; how many."""
    scratch = world.scratch
    found, kept = scratch.found, 0
    for entry in range(count):
        at = FOUND * entry
        body, o = found[at + BODY], found[at + OBSTACLE]
        mask = _cover_meets(world, body, o, found[at + MASK], clearance)
        if mask:
            kept = write_found(found, kept, body, o, mask)
    return kept


@vector_part
def _add_near_pairs(world: BatchWorld, count: int) -> int:
    """Add the robot's own near pairs to the `count` found before; how many, or -1 if cells say that some touch."""
    bodies, scratch = world.bodies, world.scratch
    coordinates = world.block
    poses, centres, bounds, found = scratch.poses, scratch.centres, bodies.bounds, scratch.found
    for link_pair in range(bodies.n_link_pairs):
        a, b = links_of(bodies, link_pair)
        x, y, z = link_centre(centres, a)
        u, v, w = link_centre(centres, b)
        x, y, z = x - u, y - v, z - w
        reach = ball_radius(bodies.around, a) + ball_radius(bodies.around, b) + BAND
        near = below(x * x + y * y + z * z, splat(reach * reach))
        if near:
            near = left_of_cells(robot_of(world), link_pair, near, coordinates)
            if near < 0:
                return -1
        if near == 0:
            continue
        first_pair, past_pair = pairs_of(bodies, link_pair)
        for pair in range(first_pair, past_pair):
            first, second = pair_of(bodies, pair)
            joint_a, joint_b = bodies.joints[first], bodies.joints[second]
            mask = near & balls_meet(poses, joint_a, first, joint_b, second, bounds, BAND)
            if mask:
                count = write_found(found, count, -1, pair, mask)
    return count


@vector_step(boolean(WORLD, types.float64, boolean))
def block_touches(world: BatchWorld, clearance: float, likely: bool) -> bool:
    """Tell if the robot touches an obstacle or itself at any of the sixteen configurations of a world's block.

    It keeps `clearance` from obstacles [m], >= 0. If a contact is `likely`, inner balls are tried first: they find one
    sooner, alone find an obstacle wholly inside a mesh, and cost time where there is none.
    """
    joints, bodies, obstacles, scratch = world.joints, world.bodies, world.obstacles, world.scratch
    coordinates = world.block
    found = scratch.found
    batch_placements(joints, coordinates, scratch.poses)
    if likely and _meets_again(world, clearance):
        return True
    place_links(bodies, scratch)
    count = _list_near_obstacles(world, clearance, likely)
    if count < 0:
        return True
    count = _keep_undecided(world, clearance, count)
    count = _add_near_pairs(world, count)
    for entry in range(count):
        at = FOUND * entry
        body, other, mask = found[at + BODY], found[at + OBSTACLE], found[at + MASK]
        if body < 0:
            touches = pair_meets(robot_of(world), other, mask)
        elif obstacles.kinds[other] == CLOUD:
            touches = meets_cloud(world, body, other, mask, clearance)
        else:
            touches = meets_obstacle(world, body, other, mask, clearance)
        if touches:
            return True
    return bool(count < 0)


FRACTIONS = np.arange(1, LANES + 1, dtype=np.float32)
FRACTIONS.setflags(write=False)
"""1 to 16, the first of `BatchWorld.fractions`: `motion_free` makes the samples' places on a motion of them."""

EXACT = 1e-3  # share of a block of samples that may be missing, for rounding to float32; with more, samples are sparser


@vector_step(boolean(WORLD, types.float64, FLOAT_POINTER, FLOAT_POINTER, types.float64))
def motion_free(world: BatchWorld, clearance: float, z0: Floats32, z1: Floats32, resolution: float) -> bool:
    """Tell if no sample of the straight motion between local coordinates (nv,) touches.

    The first isn't tested, the last is. With b blocks of sixteen, block k tests the places (b i - k) / (16 b), i
    = 1 .. 16: the first spreads over the whole motion and holds its end. `resolution` is samples per length in
    local coordinates [1/rad or 1/m, at size 1]. Boxes that drift are kept from as well.
    """
    nv, square, block = world.nv, 0.0, world.block
    for j in range(nv):
        square += ((z1[j] - z0[j]) * world.fractions[LANES + j]) ** 2
    blocks = max(1, math.ceil(math.sqrt(square) * resolution / LANES - EXACT))
    for k in range(blocks):
        place = load(world.fractions, 0) * (1.0 / LANES) - k / (LANES * blocks)
        for j in range(nv):
            origin, end = z0[j], z1[j]
            store(block, j * LANES, place * (end - origin) + origin)
        if block_touches(world, clearance, k == 0) or (world.drifting.size > 0 and meets_drifting(world)):
            return False
    return True


@vector_step(void(WORLD))
def forget(world: BatchWorld) -> None:
    """Forget what earlier answers left behind: the same questions from here on have the same answers to the bit."""
    scratch = world.scratch
    forget_axes(scratch.obstacle_axes, scratch.obstacle_places)
    forget_axes(scratch.pair_axes, scratch.pair_places)
    for k in range(HIT * HITS):
        scratch.hits[k] = -1


@vector_kernel
def touching_configurations(
    words: Indices, clearance: float, configurations: SingleRows, touching_out: TruthsOut
) -> None:
    """Write which local coordinates (n, nv) [rad or m] touch, (n,): sixteen at once, and one by one where any does.

    `words` are a packed `BatchWorld`; `clearance` is kept from obstacles [m].
    """
    world, count = world_of(pointers(words)), configurations.shape[0]
    for begin in range(0, count, LANES):
        end = min(begin + LANES, count)
        if end - begin > 1:
            for j in range(configurations.shape[1]):
                for k in range(LANES):
                    world.block[j * LANES + k] = configurations[min(begin + k, end - 1), j]
            if not block_touches(world, clearance, True):
                touching_out[begin:end] = False
                continue
        for i in range(begin, end):
            for j in range(configurations.shape[1]):
                store(world.block, j * LANES, splat(configurations[i, j]))
            touching_out[i] = block_touches(world, clearance, True)


@vector_kernel
def path_free_until(words: Indices, clearance: float, path: SingleRows, resolution: float) -> int:
    """Return how many of the straight motions along a path (n, nv) are free before the first that is not.

    Arguments are those of `touching_configurations`, `resolution` is samples per length [1/rad or 1/m].
    """
    world = world_of(pointers(words))
    for i in range(path.shape[0] - 1):
        if not motion_free(world, clearance, pointers(path[i]), pointers(path[i + 1]), resolution):
            return i
    return len(path) - 1
