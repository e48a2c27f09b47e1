"""RRT-Connect (Kuffner and LaValle 2000) on lanes: two trees, an even sequence, the dynamic domain of Yershova (2005).

The kernel runs a bounded number of iterations and can be called again to go on, so a deadline or a cancellation is
kept without a clock in the kernel, and the same seed gives the same path whatever the load.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import boolean, int64, types

from guidefield.kernels.lane_math import Floats32
from guidefield.kernels.lane_motion import WORLD, LaneWorld, motion_free, world_of
from guidefield.kernels.lanes import (
    DOUBLE_POINTER,
    FLOAT_POINTER,
    FLOATS,
    FLOATS_OUT,
    INTEGERS_OUT,
    LANES,
    below,
    first_lane,
    lane,
    lane_kernel,
    lane_step,
    load,
    pointed,
    pointers,
    rint,
    splat,
)
from guidefield.kernels.packing import Words, unpacked
from guidefield.kernels.signatures import VECTOR, VECTOR_OUT, Floats
from guidefield.kernels.tree_kinematics import INDICES

RANGE = 1.0
"""Longest extension of a tree [rad or m]."""

DOMAIN = 4.0
"""A node whose extension failed is only extended towards samples within this of it [rad or m]."""

LEAST_DOMAIN = 1.0
DOMAIN_STEP = 1e-4
"""By which fraction that radius grows when an extension succeeds, and shrinks when it fails."""

PATIENCE = 16
"""After so many samples in a row outside of the domains one is extended to all the same: else a search may dry up."""

UNSEARCHED, MET, FULL, GOING_ON = range(4)
"""How a call ended: the trees met; a tree is full; its iterations were done."""

SIZE, ITERATION, ACTIVE, MEETING, MOTIONS, ROOT = 0, 2, 3, 4, 6, 7
"""Places in the counters: both trees' sizes, iterations so far, which tree grew last, the nodes that met, motions,
the roots that the path joins."""
COUNTERS = 9


class Sampling(NamedTuple):
    """Where samples come from.

    Attributes:
        steps: (nv,) by which each coordinate's place in the box goes on from sample to sample, modulo 1.
        lower, width: (nv,) the box that samples fill.
        period: (nv,) 2 pi for coordinates that wrap, else 0; float32.
        frequency: (nv,) 1 / (2 pi) for those, else 0; float32.
        n_rotations: How many joints turn about a point.
        rotations: (n_rotations,) where their rotation vectors begin: these are of rotations drawn evenly.
    """

    steps: np.ndarray
    lower: np.ndarray
    width: np.ndarray
    period: np.ndarray
    frequency: np.ndarray
    n_rotations: int
    rotations: np.ndarray


class Search(NamedTuple):
    """Two trees and what belongs to their search; each array holds both trees, one after the other.

    Attributes:
        nv: Coordinates of a chart point.
        capacity: Nodes that each tree has room for.
        nodes: (2 * nv * capacity,) chart points, coordinate by coordinate.
        parents: (2 * capacity,) -1 for roots.
        domains: (2 * capacity,) radius of each node's domain; infinite until an extension fails.
        places: (nv,) where in the box the last sample was, as shares of its sides.
        counters: (COUNTERS,).
        sample, target, origin, reached: (nv,) memory.
    """

    nv: int
    capacity: int
    nodes: np.ndarray
    parents: np.ndarray
    domains: np.ndarray
    places: np.ndarray
    counters: np.ndarray
    sample: np.ndarray
    target: np.ndarray
    origin: np.ndarray
    reached: np.ndarray


SAMPLING = types.NamedTuple([*[VECTOR] * 3, *[FLOATS] * 2, types.int64, INDICES], Sampling)
SEARCH = types.NamedTuple(
    [*[types.int64] * 2, FLOATS_OUT, INTEGERS_OUT, FLOATS_OUT, VECTOR_OUT, INTEGERS_OUT, *[FLOATS_OUT] * 4], Search
)

_SAMPLING, _SEARCH = pointed(SAMPLING), pointed(SEARCH)
sampling_of, search_of = unpacked(SAMPLING), unpacked(SEARCH)


@lane_step(types.void(DOUBLE_POINTER, int64, FLOAT_POINTER))
def _turn_evenly(places: Floats, at: int, sample_out: Floats32) -> None:
    """The rotation vector, at most pi long, of the rotation at a place in the unit cube (Shoemake 1992).

    Places that fill the cube evenly are rotations that fill all of them evenly.
    """
    inner, outer = math.sqrt(1.0 - places[at]), math.sqrt(places[at])
    a, b = 2.0 * math.pi * places[at + 1], 2.0 * math.pi * places[at + 2]
    x, y, z, w = inner * math.sin(a), inner * math.cos(a), outer * math.sin(b), outer * math.cos(b)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.atan2(sine, abs(w)) / max(sine, 1e-12)
    if w < 0.0:
        scale = -scale
    sample_out[at], sample_out[at + 1], sample_out[at + 2] = scale * x, scale * y, scale * z


@lane_step(types.void(_SAMPLING, _SEARCH))
def _next_sample(sampling: Sampling, search: Search) -> None:
    """The next point of the sequence, in the box."""
    for j in range(search.nv):
        place = search.places[j] + sampling.steps[j]
        place -= 1.0 if place >= 1.0 else 0.0
        search.places[j] = place
        search.sample[j] = sampling.lower[j] + place * sampling.width[j]
    for k in range(sampling.n_rotations):
        _turn_evenly(search.places, sampling.rotations[k], search.sample)


@lane_step(types.Tuple((int64, types.float64))(_SEARCH, int64, FLOAT_POINTER, _SAMPLING))
def _nearest(search: Search, tree: int, target: Floats32, sampling: Sampling) -> tuple[int, float]:
    """The node nearest to a target, sixteen at a time, and its distance squared; angles that wrap go the short way."""
    nodes, period, frequency, capacity, nv = (
        search.nodes,
        sampling.period,
        sampling.frequency,
        search.capacity,
        search.nv,
    )
    start, size = tree * nv * capacity, search.counters[SIZE + tree]
    best, winner = np.float32(np.inf), 0
    for i in range(0, size, LANES):
        total = splat(0.0)
        for j in range(nv):
            apart = load(nodes, start + j * capacity + i) - target[j]
            if period[j] != 0.0:
                apart = apart - rint(apart * frequency[j]) * period[j]
            total = total + apart * apart
        mask = below(total, splat(best))
        if size - i < LANES:
            mask &= (1 << (size - i)) - 1
        while mask:
            k = first_lane(mask)
            mask &= mask - 1
            square = lane(total, k)
            if square < best:
                best, winner = square, i + k
    return winner, float(best)


@lane_step(types.float64(_SEARCH, int64, int64, FLOAT_POINTER, _SAMPLING))
def _step_towards(search: Search, tree: int, node: int, target: Floats32, sampling: Sampling) -> float:
    """Write a node's point and the one at most `RANGE` towards a target; the distance to the target itself."""
    origin, reached, nodes, square = search.origin, search.reached, search.nodes, 0.0
    nv, capacity = search.nv, search.capacity
    for j in range(nv):
        origin[j] = nodes[(tree * nv + j) * capacity + node]
        way = target[j] - origin[j]
        if sampling.period[j] != 0.0:
            way -= np.float32(np.rint(way * sampling.frequency[j])) * sampling.period[j]
        reached[j] = way
        square += way * way
    distance = math.sqrt(square)
    share = np.float32(min(1.0, RANGE / max(distance, 1e-12)))
    for j in range(nv):
        reached[j] = origin[j] + share * reached[j]
    return distance


@lane_step(int64(_SEARCH, int64, int64))
def _add(search: Search, tree: int, parent: int) -> int:
    """Add the point that was reached to a tree; its index."""
    at, nv, capacity = search.counters[SIZE + tree], search.nv, search.capacity
    for j in range(nv):
        search.nodes[(tree * nv + j) * capacity + at] = search.reached[j]
    search.parents[tree * capacity + at] = parent
    search.domains[tree * capacity + at] = np.inf
    search.counters[SIZE + tree] = at + 1
    return int(at)


@lane_step(boolean(WORLD, _SAMPLING, _SEARCH, types.float64, types.float64, int64))
def _connected(
    world: LaneWorld,
    sampling: Sampling,
    search: Search,
    clearance: float,
    resolution: float,
    tree: int,
) -> bool:
    """Grow a tree towards the target as far as the way is free; whether it got there, from the node in the counters."""
    counters = search.counters
    node, _ = _nearest(search, tree, search.target, sampling)
    while counters[SIZE + tree] < search.capacity:
        distance = _step_towards(search, tree, node, search.target, sampling)
        counters[MOTIONS] += 1
        if not motion_free(world, clearance, search.origin, search.reached, resolution):
            return False
        if distance <= RANGE:
            counters[MEETING + tree] = node
            return True
        node = _add(search, tree, node)
    return False


@lane_step(int64(WORLD, _SAMPLING, _SEARCH, types.float64, types.float64, int64))
def _grown(
    world: LaneWorld,
    sampling: Sampling,
    search: Search,
    clearance: float,
    resolution: float,
    iterations: int,
) -> int:
    """`grow` on pointers."""
    counters, sample, reached, target = search.counters, search.sample, search.reached, search.target
    nv, capacity, domains, refused = search.nv, search.capacity, search.domains, 0
    for _ in range(iterations):
        if max(counters[SIZE], counters[SIZE + 1]) + 1 >= capacity:
            return FULL
        counters[ITERATION] += 1
        a = 1 - counters[ACTIVE]
        if counters[SIZE + 1 - a] * 2 <= counters[SIZE + a]:  # the other is much smaller: it goes on
            a = 1 - a
        counters[ACTIVE] = a
        _next_sample(sampling, search)
        node, square = _nearest(search, a, sample, sampling)
        domain = domains[a * capacity + node]
        if square > domain * domain and refused < PATIENCE:
            refused += 1
            continue
        refused = 0
        _step_towards(search, a, node, sample, sampling)
        counters[MOTIONS] += 1
        if not motion_free(world, clearance, search.origin, reached, resolution):
            smaller = DOMAIN if domain == np.inf else max(domain * (1.0 - DOMAIN_STEP), LEAST_DOMAIN)
            domains[a * capacity + node] = smaller
            continue
        if domain != np.inf:
            domains[a * capacity + node] = domain * (1.0 + DOMAIN_STEP)
        met = _add(search, a, node)
        for j in range(nv):
            target[j] = reached[j]
        if _connected(world, sampling, search, clearance, resolution, 1 - a):
            counters[MEETING + a] = met
            return MET
    return GOING_ON


@lane_kernel(int64(INDICES, INDICES, INDICES, types.float64, types.float64, int64))
def grow(world: Words, sampling: Words, search: Words, clearance: float, resolution: float, iterations: int) -> int:
    """Go on growing two trees towards each other.

    Args:
        world: Robot and obstacles, a packed `LaneWorld`.
        sampling: Where samples come from, a packed `Sampling`.
        search: The trees, whose roots have been written, a packed `Search`; changed.
        clearance: What to keep from obstacles [m].
        resolution: Samples per length in the chart [1/rad or 1/m].
        iterations: How many more.

    Returns:
        MET (the nodes are in the counters), FULL (give it more room) or GOING_ON.
    """
    sources, trees = sampling_of(pointers(sampling)), search_of(pointers(search))
    return _grown(world_of(pointers(world)), sources, trees, clearance, resolution, iterations)
