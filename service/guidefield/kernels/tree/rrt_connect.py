"""RRT-Connect (Kuffner and LaValle 2000) in SIMD batches: two trees, an even sequence of samples, dynamic domains.

Dynamic domains are those of Yershova (2005). Of many extensions nearly all fail where a tree has to find out of
somewhere narrow: after a while sixteen are chosen at a time, and their ends are judged at once by what is quick to see.
The kernel runs a bounded number of iterations and can be called again to go on, so a deadline or a cancellation is kept
without a clock in the kernel, and the same seed gives the same path whatever the load. By another constant a seed gives
another path, or none until the search is given up; what it gives is free at samples.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, int64, types

from guidefield.kernels.collide.batch_collision import forget, motion_free
from guidefield.kernels.collide.broadphase import boxes_near, link_centre, near_obstacle, place_links
from guidefield.kernels.collide.layout import BALL, BAND, BODY, HIT, OBSTACLE, WORLD, BatchWorld, world_of
from guidefield.kernels.collide.parts import ball_centre, ball_radius
from guidefield.kernels.jit.arrays import FLOAT_POINTER, INTEGER_POINTER, AnyRows, Floats32, Indices, Integers
from guidefield.kernels.jit.decorators import vector_kernel, vector_part, vector_step
from guidefield.kernels.kinematics.batch_forward_kinematics import batch_placements
from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.simd.vector import ALL_LANES, LANES, first_lane, lane, load, store
from guidefield.kernels.tree.informed_samples import (
    SAMPLING,
    Sampling,
    StraightPath,
    next_samples,
    pass_samples,
    sampling_of,
)
from guidefield.kernels.tree.nodes import (
    ACTIVE,
    COUNTERS,
    ITERATION,
    MEETING,
    MOTIONS,
    PLANTED,
    RANGE,
    REFUSED,
    SEARCH,
    SIZE,
    TRIED,
    TreeSearch,
    add_reached,
    aim_at,
    join,
    nearest,
    nearest_to_each,
    plant,
    search_of,
    step_each,
    step_towards,
)

SIEVE = 32  # number, at least 1, of inner balls that met an obstacle and are tried before any other
FEW = 4  # if these balls leave at most this many configurations undecided, the others aren't tried


@vector_step(int64(WORLD, types.float64, INTEGER_POINTER))
def _hit_again(world: BatchWorld, clearance: float, hits: Integers) -> int:
    """Return the lanes where a ball that met an obstacle lately meets it again; such a ball moves on by a place."""
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


@vector_step(int64(WORLD, int64, int64, int64, types.float64, INTEGER_POINTER))
def _hits_of(world: BatchWorld, body: int, o: int, near: int, clearance: float, hits: Integers) -> int:
    """Return the lanes of the mask `near` where a ball inside a body meets an obstacle; remember such balls."""
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


@vector_part
def _are_few(lanes: int) -> bool:
    for _ in range(FEW):
        lanes &= lanes - 1
    return bool(lanes == 0)


@vector_step(int64(WORLD, types.float64, FLOAT_POINTER, INTEGER_POINTER))
def certain_hits(world: BatchWorld, clearance: float, coordinates: Floats32, hits: Integers) -> int:
    """Return the lanes where a ball inside a body meets an obstacle; some where one does may be missing.

    Such tests in float32 are off by less than `BAND`, so balls inside are smaller by it.

    `coordinates` (nv * 16) are sixteen values of each local coordinate, `clearance` is kept from obstacles [m], >= 0;
    `hits` (HIT * SIEVE,) are balls that met an obstacle lately: body, obstacle, ball; -1 where there is none; changed.
    """
    joints, bodies, obstacles, scratch = world.joints, world.bodies, world.obstacles, world.scratch
    batch_placements(joints, coordinates, scratch.poses)
    mask = _hit_again(world, clearance, hits)
    if _are_few(ALL_LANES & ~mask):
        return mask
    place_links(bodies, scratch)
    poses, centres, members, n = scratch.poses, scratch.centres, bodies.members, obstacles.size
    for c in range(bodies.moving):
        x, y, z = link_centre(centres, c)
        reach, several = ball_radius(bodies.around, c) + clearance, members[c + 1] - members[c] > 1
        for block in range((n + LANES - 1) // LANES):
            candidates = boxes_near(obstacles.boxes, block, x, y, z, reach)
            while candidates:
                o = block * LANES + first_lane(candidates)
                candidates &= candidates - 1
                about = near_obstacle(obstacles, o, x, y, z, reach, ALL_LANES & ~mask)
                # a hit on a primitive that only contains its obstacle isn't certain
                if obstacles.whole[o] == 0 or about & ~mask == 0:
                    continue
                for k in range(members[c], members[c + 1]):
                    body, near = bodies.order[k], about & ~mask
                    if near and several:
                        u, v, w = ball_centre(poses, bodies.joints[body], bodies.bounds, body)
                        near &= near_obstacle(obstacles, o, u, v, w, ball_radius(bodies.bounds, body) + clearance, near)
                    if near and not obstacles.ignored[body * n + o]:
                        mask |= _hits_of(world, body, o, near, clearance, hits)
                if mask == ALL_LANES:
                    return mask
    return int(mask)


DOMAIN = 1.1
"""Radius, over sqrt(nv), of the domain of a node whose extension failed [rad or m]: it is only extended towards samples
in it. Points that differ by so much in each coordinate are sqrt(nv) times as far apart."""

NARROW, WIDER, HALFWAY = 1.5, 1.5, 64
"""Distance of most samples from the paths between roots at first [rad or m], by how much more in the end, and after how
many motions, above 0, it is half of that: easy problems end near the path, hard ones lead further round."""

LEAST_DOMAIN, DOMAIN_STEP = 1.0, 1e-4
"""Least value of that radius [rad or m], and by which fraction it grows when an extension succeeds, and shrinks when it
fails."""

PATIENCE = 16
"""After this many samples in a row outside of all domains one is taken all the same: else a search may dry up."""

BALANCE = 1.0  # a tree that is this many times smaller than the other grows again; else they take turns

STUBBORN, SHORTEST = 2000, 4
"""Failed extensions of a node, at least 1, after which its next are half as long, each time; how often at most: to a
sixteenth. What holds nearly everything of a length back lets something shorter pass. Sooner, or more gently, costs more
than it gains."""

ALONE = 64
"""Motions that are judged one by one before sixteen extensions are chosen at a time: easy searches end before."""

MET, FULL, GOING_ON = range(3)  # ends of a call: the trees met; a tree is full; its iterations were done


@vector_part
def is_free(world: BatchWorld, sampling: Sampling, search: TreeSearch, clearance: float, resolution: float) -> bool:
    """Tell if the straight motion from the origin to what is reached is free."""
    for j in range(search.nv):
        search.first[j] = search.origin[j] * sampling.units[j]
        search.last[j] = search.reached[j] * sampling.units[j]
    return bool(motion_free(world, clearance, search.first, search.last, resolution))


@vector_step(boolean(WORLD, SAMPLING, SEARCH, types.float64, types.float64, int64))
def _connect(
    world: BatchWorld, sampling: Sampling, search: TreeSearch, clearance: float, resolution: float, tree: int
) -> bool:
    """Grow a tree towards the target as far as that is free; whether it got there, from the node in the counters."""
    counters = search.counters
    node = nearest(search, tree, search.target, sampling)
    while counters[SIZE + tree] < search.capacity:
        distance = step_towards(search, tree, node, search.target, sampling, RANGE)
        counters[MOTIONS] += 1
        if not is_free(world, sampling, search, clearance, resolution):
            return False
        if distance <= RANGE:
            counters[MEETING + tree] = node
            return True
        node = add_reached(search, tree, node)
    return False


@vector_part
def _choose_samples(search: TreeSearch, tree: int) -> int:
    """Mask of the sixteen samples that are extended to: those in the domains of their nodes, and some others."""
    domains, first, taken, refused = search.domains, tree * search.capacity, 0, search.counters[REFUSED]
    for k in range(LANES):
        domain = domains[first + int(search.nearest[k])]
        passed_by = (search.squares[k] > domain * domain) & (refused < PATIENCE)
        refused = refused + 1 if passed_by else 0
        taken |= (0 if passed_by else 1) << k
    search.counters[REFUSED] = refused
    return int(taken)


@vector_part
def path_between_roots(search: TreeSearch, drawn: int) -> StraightPath:
    """Return what the next samples are near: the path between a start and a goal, every pair of which has its turns."""
    counters, capacity, motions = search.counters, search.capacity, search.counters[MOTIONS]
    turn = counters[ITERATION] + drawn
    share, other = turn * (math.sqrt(5.0) - 1.0) / 2.0, turn * (math.sqrt(2.0) - 1.0)
    start = int((share - math.floor(share)) * counters[PLANTED])
    goal = search.nv * capacity + int((other - math.floor(other)) * counters[PLANTED + 1])
    return StraightPath(search.nodes, start, goal, capacity, NARROW + WIDER * motions / (motions + HALFWAY))


@vector_step(int64(SAMPLING, SEARCH, int64))
def choose(sampling: Sampling, search: TreeSearch, batch: int) -> int:
    """Write a batch of extensions: node and tree of each, and where it would end; return how many samples it took.

    Samples come sixteen at a time, towards one tree. One outside of the domain of the node nearest to it is passed by,
    but not for ever. Those that are left when the batch is full are drawn again.
    """
    counters, nv, drawn, chosen = search.counters, search.nv, 0, 0
    while chosen < batch:
        tree = 1 - counters[ACTIVE]
        if counters[SIZE + 1 - tree] * BALANCE <= counters[SIZE + tree]:  # the other is smaller: it goes on
            tree = 1 - tree
        next_samples(sampling, nv, search.places, path_between_roots(search, drawn), search.samples)
        nearest_to_each(search, tree, sampling)
        taken, used = _choose_samples(search, tree), LANES
        while taken:
            k = first_lane(taken)
            taken &= taken - 1
            node = int(search.nearest[k])
            search.grown_trees[chosen], search.grown_nodes[chosen] = tree, node
            halved = min(search.failed[tree * search.capacity + node] // STUBBORN, SHORTEST)
            search.longest[chosen] = RANGE / (1 << halved)
            for j in range(nv):
                search.ends[j * LANES + chosen] = lane(load(search.samples, j * LANES), k)
            chosen += 1
            if chosen == batch:
                used, taken, counters[REFUSED] = k + 1, 0, 0
        pass_samples(sampling, nv, search.places, used)
        drawn += used
        if used == LANES or batch == 1:  # else this tree goes on with the next batch
            counters[ACTIVE] = tree
    step_each(search, sampling, batch)
    return drawn


@vector_part
def _extension_free(
    world: BatchWorld, sampling: Sampling, search: TreeSearch, clearance: float, resolution: float, slot: int
) -> bool:
    """Tell if an extension of the batch is free; what it reaches is then what is reached."""
    for j in range(search.nv):
        search.origin[j] = search.origins[j * LANES + slot]
        search.reached[j] = search.ends[j * LANES + slot]
    return bool(is_free(world, sampling, search, clearance, resolution))


@vector_part
def begin(search: TreeSearch, starts: np.ndarray, goals: np.ndarray) -> None:
    """Leave only the roots of both trees, shapes (k, nv) and (m, nv), and nothing counted."""
    for k in range(COUNTERS):
        search.counters[k] = 0
    search.counters[ACTIVE] = 1
    for k in range(3 * SIEVE):
        search.hits[k] = -1
    plant(search, 0, starts)
    plant(search, 1, goals)


@vector_step(int64(WORLD, SAMPLING, SEARCH, types.float64, types.float64, int64, int64))
def _go_on(
    world: BatchWorld, sampling: Sampling, search: TreeSearch, clearance: float, resolution: float, slot: int, node: int
) -> int:
    """Continue a free extension of the batch to its sample, by `RANGE` at most; return the node that it comes to.

    Where one step was free the next often is. To go on until something is in the way costs more than it gains.
    """
    tree, share = search.grown_trees[slot], search.longest[slot]
    if share == 1.0:
        return node
    for j in range(search.nv):
        search.target[j] = search.origin[j] + (search.reached[j] - search.origin[j]) / share
    step_towards(search, tree, node, search.target, sampling, RANGE)
    search.counters[MOTIONS] += 1
    if not is_free(world, sampling, search, clearance, resolution):
        return node
    return int(add_reached(search, tree, node))


@vector_step(int64(WORLD, SAMPLING, SEARCH, types.float64, types.float64, int64, int64))
def _grow(
    world: BatchWorld,
    sampling: Sampling,
    search: TreeSearch,
    clearance: float,
    resolution: float,
    iterations: int,
    motions: int,
) -> int:
    """`grow` on pointers."""
    counters, capacity, domains = search.counters, search.capacity, search.domains
    domain = DOMAIN * math.sqrt(search.nv)
    last, last_motion = counters[ITERATION] + iterations, counters[MOTIONS] + motions
    while counters[ITERATION] < last and counters[MOTIONS] < last_motion:
        batch, hit = 1, 0
        if counters[MOTIONS] >= ALONE:
            batch = LANES
        counters[ITERATION] += choose(sampling, search, batch)
        if batch > 1:
            for j in range(search.nv):
                store(search.judged, j * LANES, load(search.ends, j * LANES) * sampling.units[j])
            hit = certain_hits(world, clearance, search.judged, search.hits)
        for slot in range(batch):
            tree, node = search.grown_trees[slot], search.grown_nodes[slot]
            if max(counters[SIZE], counters[SIZE + 1]) + 2 >= capacity:
                return FULL
            counters[MOTIONS] += 1
            counters[TRIED + tree] += 1
            at = tree * capacity + node
            if hit >> slot & 1 or not _extension_free(world, sampling, search, clearance, resolution, slot):
                search.failed[at] += 1
                domains[at] = domain if domains[at] == np.inf else max(domains[at] * (1.0 - DOMAIN_STEP), LEAST_DOMAIN)
                continue
            if domains[at] != np.inf:
                domains[at] *= 1.0 + DOMAIN_STEP
            met = add_reached(search, tree, node)
            met = _go_on(world, sampling, search, clearance, resolution, slot, met)
            aim_at(search, tree, met)
            if _connect(world, sampling, search, clearance, resolution, 1 - tree):
                counters[MEETING + tree] = met
                return MET
    return GOING_ON


@vector_kernel
def grow(
    world: Indices,
    sampling: Indices,
    search: Indices,
    starts: AnyRows,
    goals: AnyRows,
    clearance: float,
    resolution: float,
    iterations: int,
    motions: int,
    begins: bool,
) -> int:
    """Grow two trees towards each other: MET (the path is written), FULL (it needs more capacity) or GOING_ON.

    `world`, `sampling` and `search` are packed; the places of the search say where the sequence of samples begins.
    `starts` (k, nv) and `goals` (m, nv) are roots, coordinates in units of the sampling; `clearance` is kept from
    obstacles [m], `resolution` is samples per length [1/rad or 1/m]. It goes on for `iterations` or until `motions` are
    judged, and ends the batch that is begun; `begins` leaves only the roots of the trees before, and forgets what the
    world was asked.

    Raises ValueError if roots, trees and robot aren't of as many coordinates.
    """
    among, sources, trees = world_of(pointers(world)), sampling_of(pointers(sampling)), search_of(pointers(search))
    if starts.shape[1] != trees.nv or goals.shape[1] != trees.nv or among.nv != trees.nv:
        raise ValueError("roots, trees and robot differ in how many coordinates they have")
    if begins:
        begin(trees, starts, goals)
        forget(among)
    outcome = _grow(among, sources, trees, clearance, resolution, iterations, motions)
    if outcome == MET:
        join(sources, trees, starts, goals)
    return outcome
