"""RRT-Connect (Kuffner and LaValle 2000) on lanes: two trees, an even sequence, the dynamic domain of Yershova (2005).

Of many extensions nearly all fail where a tree has to find out of somewhere narrow. So after a while sixteen are
chosen at a time, and where they would end is judged at once by what is quick to see; the others are judged as ever.

The kernel runs a bounded number of iterations and can be called again to go on, so a deadline or a cancellation is
kept without a clock in the kernel, and the same seed gives the same path whatever the load.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, int64, types

from guidefield.kernels.collide.layout import WORLD, LaneWorld, world_of
from guidefield.kernels.collide.motion_validation import forget, motion_free
from guidefield.kernels.jit.signatures import INDICES, lane_kernel, lane_part, lane_step
from guidefield.kernels.simd.packing import Words, pointers
from guidefield.kernels.simd.vector import LANES, first_lane, lane, load, store
from guidefield.kernels.tree.informed_samples import SAMPLING, Sampling, Way, next_samples, pass_samples, sampling_of
from guidefield.kernels.tree.nearest import nearest, nearest_to_each
from guidefield.kernels.tree.nodes import (
    ACTIVE,
    COUNTERS,
    ITERATION,
    MEETING,
    MOTIONS,
    PLANTED,
    RANGE,
    REFUSED,
    ROOTS,
    SEARCH,
    SIZE,
    TRIED,
    TreeSearch,
    add_reached,
    aim_at,
    join,
    plant,
    search_of,
    step_each,
    step_towards,
)
from guidefield.kernels.tree.sphere_rejection import SIEVE, certain_hits

DOMAIN = 1.1
"""A node whose extension failed is only extended towards samples within so much of it [rad or m], times sqrt(nv): so
far apart are points that differ by as much in each coordinate."""

NARROW, WIDER, HALFWAY = 1.5, 1.5, 64
"""Distance of most samples from the ways between roots at first [rad or m], by how much more in the end, and after how
many motions it is half of that: easy problems end near the way, hard ones lead further round."""

LEAST_DOMAIN, DOMAIN_STEP = 1.0, 1e-4
"""Least value of that radius [rad or m], and by which fraction it grows when an extension succeeds, and shrinks when it
fails."""

PATIENCE = 16
"""After so many samples in a row outside of the domains one is extended to all the same: else a search may dry up."""

BALANCE = 1.0
"""A tree that is so many times smaller than the other grows again; else they take turns."""

STUBBORN, SHORTEST = 2000, 4
"""After every so many extensions of a node that failed the next ones are half as long, up to so many times: what holds
nearly everything of a length back lets something shorter pass. Sooner, or more gently, costs more than it gains."""

ALONE = 64
"""So many motions are judged one by one before sixteen extensions are chosen at a time: easy searches end before."""

MET, FULL, GOING_ON = range(3)
"""Ends of a call: the trees met; a tree is full; its iterations were done."""


@lane_part
def is_free(world: LaneWorld, sampling: Sampling, search: TreeSearch, clearance: float, resolution: float) -> bool:
    """Tell if the straight motion from the origin to what is reached is free."""
    for j in range(search.nv):
        search.first[j] = search.origin[j] * sampling.units[j]
        search.last[j] = search.reached[j] * sampling.units[j]
    return bool(motion_free(world, clearance, search.first, search.last, resolution))


@lane_step(boolean(WORLD, SAMPLING, SEARCH, types.float64, types.float64, int64))
def _connected(
    world: LaneWorld,
    sampling: Sampling,
    search: TreeSearch,
    clearance: float,
    resolution: float,
    tree: int,
) -> bool:
    """Grow a tree towards the target as far as the way is free; whether it got there, from the node in the counters."""
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


@lane_part
def _taken(search: TreeSearch, tree: int) -> int:
    """Mask of the sixteen samples that are extended to: those in the domains of their nodes, and some others."""
    domains, first, taken, refused = search.domains, tree * search.capacity, 0, search.counters[REFUSED]
    for k in range(LANES):
        domain = domains[first + int(search.nearest[k])]
        passed_by = (search.squares[k] > domain * domain) & (refused < PATIENCE)
        refused = refused + 1 if passed_by else 0
        taken |= (0 if passed_by else 1) << k
    search.counters[REFUSED] = refused
    return int(taken)


@lane_part
def way_of(search: TreeSearch, drawn: int) -> Way:
    """Return what the next samples are near: the way between a start and a goal, every pair of which has its turns."""
    counters, capacity, motions = search.counters, search.capacity, search.counters[MOTIONS]
    turn = counters[ITERATION] + drawn
    share, other = turn * (math.sqrt(5.0) - 1.0) / 2.0, turn * (math.sqrt(2.0) - 1.0)
    start = int((share - math.floor(share)) * counters[PLANTED])
    goal = search.nv * capacity + int((other - math.floor(other)) * counters[PLANTED + 1])
    return Way(search.nodes, start, goal, capacity, NARROW + WIDER * motions / (motions + HALFWAY))


@lane_step(int64(SAMPLING, SEARCH, int64))
def choose(sampling: Sampling, search: TreeSearch, batch: int) -> int:
    """Write a batch of extensions: from which node of which tree, and where they would end; how many samples it took.

    Samples come sixteen at a time, towards one tree. One outside of the domain of the node nearest to it is passed by,
    but not for ever. Those that are left when the batch is full are drawn again.
    """
    counters, nv, drawn, chosen = search.counters, search.nv, 0, 0
    while chosen < batch:
        tree = 1 - counters[ACTIVE]
        if counters[SIZE + 1 - tree] * BALANCE <= counters[SIZE + tree]:  # the other is smaller: it goes on
            tree = 1 - tree
        next_samples(sampling, nv, search.places, way_of(search, drawn), search.samples)
        nearest_to_each(search, tree, sampling)
        taken, used = _taken(search, tree), LANES
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


@lane_part
def _extension_free(
    world: LaneWorld, sampling: Sampling, search: TreeSearch, clearance: float, resolution: float, slot: int
) -> bool:
    """Tell if an extension of the batch is free; what it reaches is then what is reached."""
    for j in range(search.nv):
        search.origin[j] = search.origins[j * LANES + slot]
        search.reached[j] = search.ends[j * LANES + slot]
    return bool(is_free(world, sampling, search, clearance, resolution))


@lane_part
def begin(search: TreeSearch, starts: np.ndarray, goals: np.ndarray) -> None:
    """Leave only the roots of both trees, shapes (k, nv) and (m, nv), and nothing counted."""
    for k in range(COUNTERS):
        search.counters[k] = 0
    search.counters[ACTIVE] = 1
    for k in range(3 * SIEVE):
        search.hits[k] = -1
    plant(search, 0, starts)
    plant(search, 1, goals)


@lane_step(int64(WORLD, SAMPLING, SEARCH, types.float64, types.float64, int64, int64))
def _gone_on(
    world: LaneWorld,
    sampling: Sampling,
    search: TreeSearch,
    clearance: float,
    resolution: float,
    slot: int,
    node: int,
) -> int:
    """Let an extension of the batch that was free go on to its sample, by `RANGE` at most; the node it comes to.

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


@lane_step(int64(WORLD, SAMPLING, SEARCH, types.float64, types.float64, int64))
def _grown(
    world: LaneWorld,
    sampling: Sampling,
    search: TreeSearch,
    clearance: float,
    resolution: float,
    iterations: int,
) -> int:
    """`grow` on pointers."""
    counters, capacity, domains = search.counters, search.capacity, search.domains
    domain = DOMAIN * math.sqrt(search.nv)
    last = counters[ITERATION] + iterations
    while counters[ITERATION] < last:
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
            met = _gone_on(world, sampling, search, clearance, resolution, slot, met)
            aim_at(search, tree, met)
            if _connected(world, sampling, search, clearance, resolution, 1 - tree):
                counters[MEETING + tree] = met
                return MET
    return GOING_ON


@lane_kernel(int64(INDICES, INDICES, INDICES, ROOTS, ROOTS, types.float64, types.float64, int64, boolean))
def grow(
    world: Words,
    sampling: Words,
    search: Words,
    starts: np.ndarray,
    goals: np.ndarray,
    clearance: float,
    resolution: float,
    iterations: int,
    begins: bool,
) -> int:
    """Grow two trees towards each other.

    Args:
        world: Robot and obstacles, a packed `LaneWorld`.
        sampling: Where samples come from, a packed `Sampling`.
        search: The trees, a packed `TreeSearch`; changed. Its places say where the sequence of samples begins.
        starts: Roots of the first tree, chart points in units of the sampling, shape (k, nv).
        goals: Roots of the second, shape (m, nv).
        clearance: What to keep from obstacles [m].
        resolution: Samples per length in the chart [1/rad or 1/m].
        iterations: How many more; a batch that is begun is ended.
        begins: Whether to leave only the roots of the trees before, and to forget what the world was asked.

    Returns:
        MET (the path is written), FULL (give it more room) or GOING_ON.

    Raises:
        ValueError: if roots, trees and robot aren't of as many coordinates.
    """
    among, sources, trees = world_of(pointers(world)), sampling_of(pointers(sampling)), search_of(pointers(search))
    if starts.shape[1] != trees.nv or goals.shape[1] != trees.nv or among.nv != trees.nv:
        raise ValueError("roots, trees and robot differ in how many coordinates they have")
    if begins:
        begin(trees, starts, goals)
        forget(among)
    outcome = _grown(among, sources, trees, clearance, resolution, iterations)
    if outcome == MET:
        join(sources, trees, starts, goals)
    return outcome
