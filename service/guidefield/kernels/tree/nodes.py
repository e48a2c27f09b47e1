"""The nodes of two trees that a search in SIMD batches grows: steps from them, one more of them, the path between.

`planner/tree_search.py` makes the arrays of `TreeSearch`, and reads path and counters; `rrt_connect.py` and
`constrained_connect.py` grow the trees in them. `RANGE` changes which path a seed gives, not whether it is free; `LATE`
the time, and the path by rounding and ties alone, as buckets are exact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import int64, types, void

from guidefield.kernels.jit.arrays import FLOAT_POINTER, Floats32, IndicesOut, RowOut, SinglesOut, numba_type
from guidefield.kernels.jit.decorators import vector_part, vector_step
from guidefield.kernels.simd.packing import pointed, pointers, unpacked
from guidefield.kernels.simd.vector import (
    ALL_LANES,
    LANES,
    below,
    first_lane,
    lane,
    load,
    root,
    select,
    smallest_lane,
    smallest_of,
    splat,
    store,
)
from guidefield.kernels.tree.informed_samples import SAMPLING, Sampling
from guidefield.kernels.tree.kd_buckets import KNOWN, STATE, Buckets, nearest_in_buckets, put_in_bucket, wrap_difference

RANGE = 1.0  # longest extension of a tree, by the metric [rad]
LATE = 1024  # newest nodes of a tree that are examined one by one, at most; buckets pay for more

SIZE, ITERATION, ACTIVE, MEETING, MOTIONS, ROWS, REFUSED, TRIED, PLANTED = 0, 2, 3, 4, 6, 7, 8, 9, 11
"""Places in the counters: both trees' sizes, iterations so far, which tree grew last, the nodes that met, motions,
rows of the path, how many samples in a row were outside of their nodes' domains, the extensions of both trees that were
judged, and the roots of both trees."""
COUNTERS = 13  # their number


class TreeSearch(NamedTuple):
    """Two trees and what belongs to their search; each array holds both trees, one after the other."""

    nv: int  # local coordinates of the group
    capacity: int  # nodes that each tree has room for
    # (2 * nv * capacity,) points in units of `Sampling`, coordinate by coordinate, as all else is but what is called
    # local coordinates. Distances between these are distances by the group's metric.
    nodes: SinglesOut
    parents: IndicesOut  # (2 * capacity,) -1 for roots
    domains: SinglesOut  # (2 * capacity,) radius of each node's domain; infinite until an extension fails
    failed: IndicesOut  # (2 * capacity,) how many of each node's extensions were not free
    places: RowOut  # (nv + 1,) where in its box the last sample was, as shares of its sides, and which box that was
    counters: IndicesOut  # (COUNTERS,)
    # sample, target, origin, reached: (nv,) memory
    sample: SinglesOut
    target: SinglesOut
    origin: SinglesOut
    reached: SinglesOut
    # first, last: (nv,) local coordinates: the ends of the motion that is judged
    first: SinglesOut
    last: SinglesOut
    samples: SinglesOut  # (nv * 16,) samples, coordinate by coordinate
    squares: SinglesOut  # (16,) how far each is from the node nearest to it, squared
    nearest: SinglesOut  # (16,) those nodes
    # grown_trees, grown_nodes: (16,) of a batch of extensions the trees and the nodes that they are of
    grown_trees: IndicesOut
    grown_nodes: IndicesOut
    longest: SinglesOut  # (16,) how long they may be; then which share of the ways to their samples they are
    # origins, ends: (nv * 16,) where they begin and end, coordinate by coordinate
    origins: SinglesOut
    ends: SinglesOut
    judged: SinglesOut  # (nv * 16,) local coordinates: where they end
    hits: IndicesOut  # (3 * SIEVE,) what the sieve of a batch tries first
    path: RowOut  # (2 * nv * capacity,) the path once the trees have met, point by point
    buckets: Buckets  # where the older nodes of large trees are


_SEARCH = numba_type(TreeSearch)
SEARCH = pointed(_SEARCH)

search_of = unpacked(_SEARCH)  # makes a search of its words

ROOTS = types.Array(types.float64, 2, "A", readonly=True)  # roots of a tree, shape (n, nv), in any order in memory


@vector_part
def step_each(search: TreeSearch, sampling: Sampling, batch: int) -> None:
    """Shorten the first extensions of a batch, whose ends are their samples, to their longest lengths."""
    nodes, origins, ends, longest = search.nodes, search.origins, search.ends, search.longest
    nv, capacity = search.nv, search.capacity
    for slot in range(batch):
        at = search.grown_trees[slot] * nv * capacity + search.grown_nodes[slot]
        for j in range(nv):
            origins[j * LANES + slot] = lane(load(nodes, at + j * capacity), 0)
    square = splat(0.0)
    for j in range(nv):
        offset = load(ends, j * LANES) - load(origins, j * LANES)
        offset = wrap_difference(offset, sampling.period[j], sampling.frequency[j])
        store(ends, j * LANES, offset)
        square = square + offset * offset
    store(search.squares, 0, root(square))
    for slot in range(batch):
        longest[slot] = min(np.float32(1.0), longest[slot] / max(search.squares[slot], np.float32(1e-12)))
    share = load(longest, 0)
    for j in range(nv):
        store(ends, j * LANES, load(ends, j * LANES) * share + load(origins, j * LANES))


@vector_step(types.float64(SEARCH, int64, int64, FLOAT_POINTER, SAMPLING, types.float64))
def step_towards(
    search: TreeSearch, tree: int, node: int, target: Floats32, sampling: Sampling, longest: float
) -> float:
    """Write a node's point, and one at most `longest` from it towards a target (nv,); return the target's distance."""
    origin, reached, nodes, square = search.origin, search.reached, search.nodes, 0.0
    nv, capacity = search.nv, search.capacity
    for j in range(nv):
        origin[j] = nodes[(tree * nv + j) * capacity + node]
        offset = target[j] - origin[j]
        if sampling.period[j] != 0.0:
            offset -= np.float32(np.rint(offset * sampling.frequency[j])) * sampling.period[j]
        reached[j] = offset
        square += offset * offset
    distance = math.sqrt(square)
    share = np.float32(min(1.0, longest / max(distance, 1e-12)))
    for j in range(nv):
        reached[j] = origin[j] + share * reached[j]
    return distance


@vector_part
def aim_at(search: TreeSearch, tree: int, node: int) -> None:
    """Let a node of a tree be the target."""
    for j in range(search.nv):
        search.target[j] = search.nodes[(tree * search.nv + j) * search.capacity + node]


@vector_step(int64(SEARCH, int64, int64))
def add_reached(search: TreeSearch, tree: int, parent: int) -> int:
    """Add the point that was reached to a tree, which has room; its index."""
    at, nv, capacity = search.counters[SIZE + tree], search.nv, search.capacity
    for j in range(nv):
        search.nodes[(tree * nv + j) * capacity + at] = search.reached[j]
    search.parents[tree * capacity + at] = parent
    search.domains[tree * capacity + at] = np.inf
    search.failed[tree * capacity + at] = 0
    search.counters[SIZE + tree] = at + 1
    return int(at)


@vector_step(void(SEARCH, int64, ROOTS))
def plant(search: TreeSearch, tree: int, roots: np.ndarray) -> None:
    """Leave nothing of a tree but its roots, shape (n, nv); there is room for them."""
    nv, capacity, first = search.nv, search.capacity, tree * search.capacity
    for i in range(len(roots)):
        for j in range(nv):
            search.nodes[(tree * nv + j) * capacity + i] = roots[i, j]
        search.parents[first + i] = -1
        search.domains[first + i] = np.inf
        search.failed[first + i] = 0
    search.counters[SIZE + tree] = search.counters[PLANTED + tree] = len(roots)
    for k in range(STATE):
        search.buckets.state[tree * STATE + k] = 0


@vector_part
def _wrap_near(place: float, before: float, period: float) -> float:
    """A coordinate, if it wraps with whole turns added so that it is no more than half a turn from another."""
    if period != 0.0:
        place += 2.0 * math.pi * np.rint((before - place) / (2.0 * math.pi))
    return place


@vector_step(void(SAMPLING, SEARCH, ROOTS, ROOTS))
def join(sampling: Sampling, search: TreeSearch, starts: np.ndarray, goals: np.ndarray) -> None:
    """Write the branch from the root of the first tree and that to the root of the second, which have met.

    The trees met where a step of the one towards the other's last point would end. Whole turns are added to the second
    branch, so that no coordinate that wraps goes more than half a turn from point to point. Nodes are float32, so the
    ends are the roots (k, nv) and (m, nv) as they were given.
    """
    nv, capacity, counters, parents = search.nv, search.capacity, search.counters, search.parents
    nodes, path, row, node = search.nodes, search.path, 0, counters[MEETING]
    while parents[node] >= 0:
        row += 1
        node = parents[node]
    for j in range(nv):
        path[j] = starts[node, j]
    counters[ROWS], node = row + 1, counters[MEETING]
    while row > 0:
        for j in range(nv):
            path[row * nv + j] = nodes[j * capacity + node]
        row, node = row - 1, parents[node]
    row, node = counters[ROWS], counters[MEETING + 1]
    while node >= 0:
        above = parents[capacity + node]
        for j in range(nv):
            place = float(nodes[(nv + j) * capacity + node])
            if above < 0:
                place = goals[node, j]
            path[row * nv + j] = _wrap_near(place, path[(row - 1) * nv + j], sampling.period[j])
        row, node = row + 1, above
    counters[ROWS] = row


_PLACES = np.arange(LANES, dtype=np.float32)


@vector_step(int64(SEARCH, int64, SAMPLING))
def _put_in_buckets(search: TreeSearch, tree: int, sampling: Sampling) -> int:
    """Put the nodes of a tree in buckets that are not yet; how many there are."""
    size = search.counters[SIZE + tree]
    for node in range(search.buckets.state[tree * STATE + KNOWN], size):
        put_in_bucket(search.buckets, search.nv, tree, node, search.nodes, search.capacity, sampling)
    search.buckets.state[tree * STATE + KNOWN] = size
    return int(size)


@vector_part
def _look_up(search: TreeSearch, tree: int, sampling: Sampling) -> int:
    """Return how many nodes of a tree are in buckets; fewer than `LATE` are left."""
    known = search.buckets.state[tree * STATE + KNOWN]
    if search.counters[SIZE + tree] - known >= LATE:
        known = _put_in_buckets(search, tree, sampling)
    return int(known)


@vector_step(int64(SEARCH, int64, FLOAT_POINTER, SAMPLING))
def nearest(search: TreeSearch, tree: int, target: Floats32, sampling: Sampling) -> int:
    """The node nearest to a target, shape (nv,); angles that wrap go the short way.

    The nodes that came last are examined sixteen at a time, each lane keeping its nearest; the others are in buckets.
    """
    nodes, capacity, nv, period, frequency = (
        search.nodes,
        search.capacity,
        search.nv,
        sampling.period,
        sampling.frequency,
    )
    start, size, known = tree * nv * capacity, search.counters[SIZE + tree], _look_up(search, tree, sampling)
    least, which = splat(np.inf), splat(0.0)
    for i in range(known, size, LANES):
        total = splat(0.0)
        for j in range(nv):
            apart = wrap_difference(load(nodes, start + j * capacity + i) - target[j], period[j], frequency[j])
            total = total + apart * apart
        if size - i < LANES:
            total = select(load(pointers(_PLACES), 0) < size - i - 0.5, total, np.inf)
        which = select(total < least, splat(np.float32(i)), which)
        least = smallest_of(total, least)
    best = smallest_lane(least)
    k = first_lane(ALL_LANES & ~below(splat(best), least))
    winner = int(lane(which, k)) + k
    if known:
        winner, _ = nearest_in_buckets(search.buckets, nv, tree, target, sampling, winner, best)
    return int(winner)


@vector_step(void(SEARCH, int64, SAMPLING, int64))
def _nearer_in_buckets(search: TreeSearch, tree: int, sampling: Sampling, k: int) -> None:
    """Write of one of the sixteen samples the nearest node if that is in a bucket."""
    sample = search.sample
    for j in range(search.nv):
        sample[j] = search.samples[j * LANES + k]
    winner, square = int(search.nearest[k]), search.squares[k]
    winner, square = nearest_in_buckets(search.buckets, search.nv, tree, sample, sampling, winner, square)
    search.squares[k], search.nearest[k] = square, winner


@vector_part
def nearest_to_each(search: TreeSearch, tree: int, sampling: Sampling) -> None:
    """Write of each of the sixteen samples the node nearest to it and how far it is from it, squared.

    Each lane has a sample, four nodes at a time go by; none is examined beyond the last, but that one again.
    """
    nodes, samples, capacity, nv = search.nodes, search.samples, search.capacity, search.nv
    start, last, known = tree * nv * capacity, search.counters[SIZE + tree] - 1, _look_up(search, tree, sampling)
    least, which = splat(np.inf), splat(0.0)
    for a in range(known, last + 1, 4):
        b, c, d = min(a + 1, last), min(a + 2, last), min(a + 3, last)
        s, t, u, v = splat(0.0), splat(0.0), splat(0.0), splat(0.0)
        for j in range(nv):
            period, frequency = sampling.period[j], sampling.frequency[j]
            sample, row = load(samples, j * LANES), start + j * capacity
            x, y = sample - nodes[row + a], sample - nodes[row + b]
            z, w = sample - nodes[row + c], sample - nodes[row + d]
            if period != 0.0:
                x, y = wrap_difference(x, period, frequency), wrap_difference(y, period, frequency)
                z, w = wrap_difference(z, period, frequency), wrap_difference(w, period, frequency)
            s, t, u, v = s + x * x, t + y * y, u + z * z, v + w * w
        which = select(s < least, splat(np.float32(a)), which)
        least = smallest_of(s, least)
        which = select(t < least, splat(np.float32(b)), which)
        least = smallest_of(t, least)
        which = select(u < least, splat(np.float32(c)), which)
        least = smallest_of(u, least)
        which = select(v < least, splat(np.float32(d)), which)
        least = smallest_of(v, least)
    store(search.squares, 0, least)
    store(search.nearest, 0, which)
    if known:
        for k in range(LANES):
            _nearer_in_buckets(search, tree, sampling, k)
