"""Nearest among very many nodes: buckets of 32, split at the median; boxes about sixteen of them tested at once.

A node goes where the splits send it, so boxes overlap little; the search asks the boxes alone, so it is exact whatever
they are: which coordinate is split costs time, or decides ties. Where it is split matters: both halves get 16 nodes, by
which `buckets_for` has room, which nothing checks. Angles that wrap are kept between half a turn and minus that; a box
is its middle and half of its sides, and how far a point is from it is measured the short way round, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import int64, types, void

from guidefield.kernels.jit.arrays import FLOAT_POINTER, Floats32, IndicesOut, Integers, SinglesOut, numba_type
from guidefield.kernels.jit.decorators import vector_part, vector_step
from guidefield.kernels.simd.packing import pointed
from guidefield.kernels.simd.vector import (
    LANES,
    Vector,
    below,
    first_lane,
    lane,
    largest_lane,
    largest_of,
    load,
    magnitude,
    rint,
    smallest_lane,
    splat,
)
from guidefield.kernels.tree.informed_samples import SAMPLING, Sampling

BUCKET = 2 * LANES  # nodes of a bucket that is full: `_set_box` reads them as two vectors

KNOWN, COUNT, ENTRIES, STATE = 0, 1, 2, 3
"""Places in a tree's state: nodes in buckets, buckets, entries of the tree of splits; and how many places."""

_SPLIT, _LOWER, _UPPER, _ENTRY = 0, 1, 2, 3
"""Places in an entry: the coordinate that is split, or -1 of a bucket; what is below, or the bucket; what is above."""

_CERTAIN = 0.9999  # a box is passed by if even this share of its distance squared in float32 is too far; may shrink


class Buckets(NamedTuple):
    """The nodes of two trees that are in buckets; each array holds both trees, one after the other."""

    n: int  # buckets that each tree has room for, a multiple of 16
    # (2 * n * nv * BUCKET,) points, bucket by bucket, coordinate by coordinate; one that isn't full repeats its
    # first
    inside: SinglesOut
    members: IndicesOut  # (2 * n * BUCKET,) their nodes
    filled: IndicesOut  # (2 * n,) how many a bucket has
    # middles, halves: (2 * nv * n,) the boxes about them, coordinate by coordinate
    middles: SinglesOut
    halves: SinglesOut
    splits: IndicesOut  # (2 * 2 * n * 3,) entries of the trees of splits, the first is the root
    cuts: SinglesOut  # (2 * 2 * n,) at which value an entry splits
    state: IndicesOut  # (2 * STATE,)
    point: SinglesOut  # (nv,) memory


BUCKETS_TYPE = numba_type(Buckets)
BUCKETS = pointed(BUCKETS_TYPE)


def buckets_for(nv: int, capacity: int) -> Buckets:
    """Return empty buckets for `capacity` nodes of nv coordinates in each of two trees."""
    n = -(-capacity // (BUCKET // 2 * LANES)) * LANES  # a split leaves 16 nodes in a bucket
    return Buckets(
        n=n,
        inside=np.zeros(2 * n * nv * BUCKET, np.float32),
        members=np.zeros(2 * n * BUCKET, np.int64),
        filled=np.zeros(2 * n, np.int64),
        middles=np.zeros(2 * nv * n, np.float32),
        halves=np.zeros(2 * nv * n, np.float32),
        splits=np.full(2 * 2 * n * _ENTRY, -1, np.int64),
        cuts=np.zeros(2 * 2 * n, np.float32),
        state=np.zeros(2 * STATE, np.int64),
        point=np.zeros(nv, np.float32),
    )


@vector_part
def wrap_difference(apart: Vector, period: float, frequency: float) -> Vector:
    """Differences of a coordinate, the short way round if it wraps."""
    if period != 0.0:
        apart = apart - rint(apart * frequency) * period
    return apart


@vector_step(void(BUCKETS, int64, int64, int64, int64))
def _set_box(buckets: Buckets, nv: int, tree: int, bucket: int, filled: int) -> None:
    """Set the number of a bucket's nodes; repeat the first in the rest of it, and find the box about them."""
    inside, members, n, start = buckets.inside, buckets.members, buckets.n, tree * buckets.n + bucket
    buckets.filled[start] = filled
    for i in range(filled, BUCKET):
        members[start * BUCKET + i] = members[start * BUCKET]
    for j in range(nv):
        row = (start * nv + j) * BUCKET
        for i in range(filled, BUCKET):
            inside[row + i] = inside[row]
        first, second = load(inside, row), load(inside, row + LANES)
        low = min(smallest_lane(first), smallest_lane(second))
        high = max(largest_lane(first), largest_lane(second))
        middle, at = np.float32(0.5) * (low + high), (tree * nv + j) * n + bucket
        buckets.middles[at], buckets.halves[at] = middle, max(high - middle, middle - low)


@vector_part
def _exchange(inside: Floats32, members: Integers, nv: int, start: int, i: int) -> None:
    at = start * BUCKET + i
    members[at - 1], members[at] = members[at], members[at - 1]
    for j in range(nv):
        at = (start * nv + j) * BUCKET + i
        inside[at - 1], inside[at] = inside[at], inside[at - 1]


@vector_step(void(BUCKETS, int64, int64, int64))
def _split(buckets: Buckets, nv: int, tree: int, entry: int) -> None:
    """Split an entry's bucket, which is full, at the median of its widest coordinate."""
    inside, members, n, splits = buckets.inside, buckets.members, buckets.n, buckets.splits
    state, at = tree * STATE, (tree * 2 * n + entry) * _ENTRY
    bucket, new, below_it = splits[at + _LOWER], buckets.state[state + COUNT], buckets.state[state + ENTRIES]
    start, other, widest = tree * n + bucket, tree * n + new, 0
    for j in range(1, nv):
        if buckets.halves[(tree * nv + j) * n + bucket] > buckets.halves[(tree * nv + widest) * n + bucket]:
            widest = j
    row = (start * nv + widest) * BUCKET
    for last in range(1, BUCKET):
        i = last
        while i > 0 and inside[row + i - 1] > inside[row + i]:
            _exchange(inside, members, nv, start, i)
            i -= 1
    half = BUCKET // 2
    for i in range(half):
        members[other * BUCKET + i] = members[start * BUCKET + half + i]
        for j in range(nv):
            inside[(other * nv + j) * BUCKET + i] = inside[(start * nv + j) * BUCKET + half + i]
    buckets.cuts[tree * 2 * n + entry] = inside[row + half]
    _set_box(buckets, nv, tree, bucket, half)
    _set_box(buckets, nv, tree, new, half)
    splits[at + _SPLIT], splits[at + _LOWER], splits[at + _UPPER] = widest, below_it, below_it + 1
    for side in range(2):
        lower = (tree * 2 * n + below_it + side) * _ENTRY
        splits[lower + _SPLIT], splits[lower + _LOWER] = -1, bucket if side == 0 else new
    buckets.state[state + COUNT], buckets.state[state + ENTRIES] = new + 1, below_it + 2


@vector_step(int64(BUCKETS, int64, FLOAT_POINTER))
def _entry_of(buckets: Buckets, tree: int, point: Floats32) -> int:
    """The entry whose bucket the splits send a point to."""
    splits, cuts, start, entry = buckets.splits, buckets.cuts, tree * 2 * buckets.n, 0
    while splits[(start + entry) * _ENTRY + _SPLIT] >= 0:
        at = (start + entry) * _ENTRY
        side = _UPPER if point[splits[at + _SPLIT]] >= cuts[start + entry] else _LOWER
        entry = splits[at + side]
    return int(entry)


@vector_step(void(BUCKETS, int64, int64, int64, FLOAT_POINTER, int64, SAMPLING))
def put_in_bucket(
    buckets: Buckets, nv: int, tree: int, node: int, nodes: Floats32, stride: int, sampling: Sampling
) -> None:
    """Put a node of a tree in its bucket; `nodes` (2 * nv * stride,) are the trees' points by coordinate."""
    point, splits, state = buckets.point, buckets.splits, tree * STATE
    for j in range(nv):
        value = nodes[(tree * nv + j) * stride + node]
        if sampling.period[j] != 0.0:
            value -= np.float32(np.rint(value * sampling.frequency[j])) * sampling.period[j]
        point[j] = value
    if buckets.state[state + COUNT] == 0:
        root = tree * 2 * buckets.n * _ENTRY
        splits[root + _SPLIT], splits[root + _LOWER] = -1, 0
        buckets.filled[tree * buckets.n] = 0
        buckets.state[state + COUNT], buckets.state[state + ENTRIES] = 1, 1
    entry = _entry_of(buckets, tree, point)
    bucket = splits[(tree * 2 * buckets.n + entry) * _ENTRY + _LOWER]
    if buckets.filled[tree * buckets.n + bucket] == BUCKET:
        _split(buckets, nv, tree, entry)
        entry = _entry_of(buckets, tree, point)
        bucket = splits[(tree * 2 * buckets.n + entry) * _ENTRY + _LOWER]
    start = tree * buckets.n + bucket
    filled = buckets.filled[start]
    buckets.members[start * BUCKET + filled] = node
    for j in range(nv):
        buckets.inside[(start * nv + j) * BUCKET + filled] = point[j]
    _set_box(buckets, nv, tree, bucket, filled + 1)


_NEAREST = types.Tuple((int64, types.float32))


@vector_step(_NEAREST(BUCKETS, int64, int64, int64, FLOAT_POINTER, SAMPLING, int64, types.float32))
def _nearest_in(
    buckets: Buckets, nv: int, tree: int, bucket: int, target: Floats32, sampling: Sampling, winner: int, best: float
) -> tuple[int, float]:
    """The nearest node of a bucket and its distance squared, or what was found before."""
    start = tree * buckets.n + bucket
    for half in range(0, BUCKET, LANES):
        total = splat(0.0)
        for j in range(nv):
            apart = load(buckets.inside, (start * nv + j) * BUCKET + half) - target[j]
            apart = wrap_difference(apart, sampling.period[j], sampling.frequency[j])
            total = total + apart * apart
        mask = below(total, splat(best))
        while mask:
            k = first_lane(mask)
            mask &= mask - 1
            if lane(total, k) < best:
                best, winner = lane(total, k), buckets.members[start * BUCKET + half + k]
    return winner, best


@vector_step(_NEAREST(BUCKETS, int64, int64, FLOAT_POINTER, SAMPLING, int64, types.float32))
def nearest_in_buckets(
    buckets: Buckets, nv: int, tree: int, target: Floats32, sampling: Sampling, winner: int, best: float
) -> tuple[int, float]:
    """Return the node in buckets nearest to a target (nv,), and its distance squared, if below `best`.

    Else those given.
    """
    point, n = buckets.point, buckets.n
    for j in range(nv):
        point[j] = target[j]
        if sampling.period[j] != 0.0:
            point[j] -= np.float32(np.rint(target[j] * sampling.frequency[j])) * sampling.period[j]
    first = buckets.splits[(tree * 2 * n + _entry_of(buckets, tree, point)) * _ENTRY + _LOWER]
    winner, best = _nearest_in(buckets, nv, tree, first, point, sampling, winner, best)
    count = buckets.state[tree * STATE + COUNT]
    for group in range(0, count, LANES):
        total = splat(0.0)
        for j in range(nv):
            at = (tree * nv + j) * n + group
            apart = wrap_difference(load(buckets.middles, at) - point[j], sampling.period[j], sampling.frequency[j])
            apart = largest_of(magnitude(apart) - load(buckets.halves, at), splat(0.0))
            total = total + apart * apart
        total = total * _CERTAIN
        mask = below(total, splat(best))
        if count - group < LANES:
            mask &= (1 << (count - group)) - 1
        while mask:
            k = first_lane(mask)
            mask &= mask - 1
            if group + k != first and lane(total, k) < best:
                winner, best = _nearest_in(buckets, nv, tree, group + k, point, sampling, winner, best)
    return winner, best
