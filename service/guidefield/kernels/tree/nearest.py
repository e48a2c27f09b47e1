"""The node of a tree that is nearest to one point, or to each of sixteen samples."""

from __future__ import annotations

import numpy as np
from numba import int64, void

from guidefield.kernels.jit.signatures import FLOAT_POINTER, Floats32, lane_part, lane_step
from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.simd.vector import (
    ALL_LANES,
    LANES,
    below,
    first_lane,
    lane,
    load,
    select,
    smallest_lane,
    smallest_of,
    splat,
    store,
)
from guidefield.kernels.tree.informed_samples import SAMPLING, Sampling
from guidefield.kernels.tree.kd_buckets import KNOWN, STATE, nearest_in_buckets, put_in_bucket, short_way
from guidefield.kernels.tree.nodes import LATE, SEARCH, SIZE, TreeSearch

_PLACES = np.arange(LANES, dtype=np.float32)


@lane_step(int64(SEARCH, int64, SAMPLING))
def _put_in_buckets(search: TreeSearch, tree: int, sampling: Sampling) -> int:
    """Put the nodes of a tree in buckets that are not yet; how many there are."""
    size = search.counters[SIZE + tree]
    for node in range(search.buckets.state[tree * STATE + KNOWN], size):
        put_in_bucket(search.buckets, search.nv, tree, node, search.nodes, search.capacity, sampling)
    search.buckets.state[tree * STATE + KNOWN] = size
    return int(size)


@lane_part
def _known(search: TreeSearch, tree: int, sampling: Sampling) -> int:
    """Return how many nodes of a tree are in buckets; fewer than `LATE` are left."""
    known = search.buckets.state[tree * STATE + KNOWN]
    if search.counters[SIZE + tree] - known >= LATE:
        known = _put_in_buckets(search, tree, sampling)
    return int(known)


@lane_step(int64(SEARCH, int64, FLOAT_POINTER, SAMPLING))
def nearest(search: TreeSearch, tree: int, target: Floats32, sampling: Sampling) -> int:
    """The node nearest to a target, shape (nv,); angles that wrap go the short way.

    The nodes that came last are looked at sixteen at a time, each lane keeping its nearest; the others are in buckets.
    """
    nodes, capacity, nv, period, frequency = (
        search.nodes,
        search.capacity,
        search.nv,
        sampling.period,
        sampling.frequency,
    )
    start, size, known = tree * nv * capacity, search.counters[SIZE + tree], _known(search, tree, sampling)
    least, which = splat(np.inf), splat(0.0)
    for i in range(known, size, LANES):
        total = splat(0.0)
        for j in range(nv):
            apart = short_way(load(nodes, start + j * capacity + i) - target[j], period[j], frequency[j])
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


@lane_step(void(SEARCH, int64, SAMPLING, int64))
def _nearer_in_buckets(search: TreeSearch, tree: int, sampling: Sampling, k: int) -> None:
    """Write of one of the sixteen samples the nearest node if that is in a bucket."""
    sample = search.sample
    for j in range(search.nv):
        sample[j] = search.samples[j * LANES + k]
    winner, square = int(search.nearest[k]), search.squares[k]
    winner, square = nearest_in_buckets(search.buckets, search.nv, tree, sample, sampling, winner, square)
    search.squares[k], search.nearest[k] = square, winner


@lane_part
def nearest_to_each(search: TreeSearch, tree: int, sampling: Sampling) -> None:
    """Write of each of the sixteen samples the node nearest to it and how far it is from it, squared.

    The samples are in lanes, four nodes at a time go by; none is looked at beyond the last, but that one again.
    """
    nodes, samples, capacity, nv = search.nodes, search.samples, search.capacity, search.nv
    start, last, known = tree * nv * capacity, search.counters[SIZE + tree] - 1, _known(search, tree, sampling)
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
                x, y = short_way(x, period, frequency), short_way(y, period, frequency)
                z, w = short_way(z, period, frequency), short_way(w, period, frequency)
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
