"""RRT-Connect within path constraints: the trees of rrt_connect.py, whose every step is brought onto the constraints.

After CBiRRT (Berenson et al., ICRA 2009): a stride towards a sample is corrected by Newton's method until the
constraints hold with some room to spare, so that a thin set of configurations is walked along and not waited for.
Samples, the nearest nodes, motions and paths are those of any search; a node is left for samples however far.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import boolean, int64, types

from guidefield.kernels.collide.layout import WORLD, LaneWorld, world_of
from guidefield.kernels.collide.motion_validation import forget
from guidefield.kernels.jit.fields import numba_type
from guidefield.kernels.jit.signatures import (
    FLOAT_POINTER,
    INDICES,
    VECTOR_OUT,
    Floats,
    Floats32,
    lane_kernel,
    lane_part,
    lane_step,
)
from guidefield.kernels.simd.packing import Words, pointers
from guidefield.kernels.simd.vector import LANES
from guidefield.kernels.tree.informed_samples import SAMPLING, Sampling, sampling_of
from guidefield.kernels.tree.nearest import nearest
from guidefield.kernels.tree.nodes import (
    ITERATION,
    MEETING,
    MOTIONS,
    PLANTED,
    ROOTS,
    SEARCH,
    SIZE,
    TRIED,
    TreeSearch,
    add_reached,
    aim_at,
    join,
    search_of,
    step_towards,
)
from guidefield.kernels.tree.path_constraints import FRAMES, KeptFrames, bring_back, largest_share
from guidefield.kernels.tree.rrt_connect import FULL, GOING_ON, MET, begin, choose, is_free


class Strides(NamedTuple):
    """Settings of trees within path constraints.

    Attributes:
        length: Of a stride, by the metric [rad].
        least_gain: A stride that comes nearer to where it was to go by less than this share of its length ends a walk.
        farthest: So does one that ends this many lengths from where it began.
        room: Strides are brought to within this share of each limit.
        corrections: Newton's steps for that, at most.
        resolution: Samples of a motion per length in the chart [1/rad or 1/m].
        clearance: What to keep from obstacles [m].
    """

    length: float
    least_gain: float
    farthest: float
    room: float
    corrections: int
    resolution: float
    clearance: float


class Walk(NamedTuple):
    """Tables and memory that a step of a tree needs.

    Attributes:
        world: Robot and obstacles.
        sampling: Where samples come from.
        search: The trees.
        frames: The constraints.
        strides: How the trees walk.
        z: Scratch, shape (nv,).
    """

    world: LaneWorld
    sampling: Sampling
    search: TreeSearch
    frames: KeptFrames
    strides: Strides
    z: Floats


STRIDES = numba_type(Strides)
WALK = types.BaseTuple.from_types((WORLD, SAMPLING, SEARCH, FRAMES, STRIDES, VECTOR_OUT), Walk)


@lane_step(types.float64(FLOAT_POINTER, FLOAT_POINTER, int64, SAMPLING))
def _apart(a: Floats32, b: Floats32, nv: int, sampling: Sampling) -> float:
    """Return how far two points, shape (nv,), are apart, the short way round."""
    square = 0.0
    for j in range(nv):
        way = a[j] - b[j]
        if sampling.period[j] != 0.0:
            way -= np.float32(np.rint(way * sampling.frequency[j])) * sampling.period[j]
        square += way * way
    return math.sqrt(square)


@lane_step(boolean(WALK, types.float64))
def _corrected(walk: Walk, left: float) -> bool:
    """Bring what is reached onto the constraints; whether it still leads to the target, which was `left` away."""
    sampling, search, strides, z = walk.sampling, walk.search, walk.strides, walk.z
    for j in range(search.nv):
        z[j] = search.reached[j] * sampling.units[j]
    if not bring_back(walk.frames, strides.room, strides.corrections, z):
        return False
    for j in range(search.nv):
        search.reached[j] = z[j] / sampling.units[j]
    gained = left - _apart(search.reached, search.target, search.nv, sampling)
    moved = _apart(search.reached, search.origin, search.nv, sampling)
    return bool(gained >= strides.least_gain * strides.length and moved <= strides.farthest * strides.length)


@lane_step(boolean(WALK))
def _kept(walk: Walk) -> bool:
    """Tell if the constraints hold where a stride ends, and in its middle."""
    search, z = walk.search, walk.z
    for share in (1.0, 0.5):
        for j in range(search.nv):
            z[j] = (search.origin[j] + share * (search.reached[j] - search.origin[j])) * walk.sampling.units[j]
        if largest_share(walk.frames, z) > 1.0:
            return False
    return True


@lane_step(types.UniTuple(int64, 2)(WALK, int64, int64))
def _walk(walk: Walk, tree: int, node: int) -> tuple[int, int]:
    """Walk from a node to the target, a stride at a time, as far as each leads there and is free.

    Returns:
        The last node, and whether a free stride from there ends at the target, which is what is reached then.
    """
    search, strides, counters = walk.search, walk.strides, walk.search.counters
    while counters[SIZE + tree] < search.capacity:
        left = step_towards(search, tree, node, search.target, walk.sampling, strides.length)
        there = left <= strides.length
        if not there and not _corrected(walk, left):
            break
        if not _kept(walk):
            break
        counters[MOTIONS] += 1
        if not is_free(walk.world, walk.sampling, search, strides.clearance, strides.resolution):
            break
        if there:
            return node, 1
        node = add_reached(search, tree, node)
    return node, 0


@lane_part
def _met(walk: Walk, tree: int, node: int) -> bool:
    """Walk from the other tree to a node of a tree; whether it gets there."""
    search, other = walk.search, 1 - tree
    aim_at(search, tree, node)
    last, there = _walk(walk, other, nearest(search, other, search.target, walk.sampling))
    if there:
        search.counters[MEETING + tree], search.counters[MEETING + other] = node, last
    return bool(there)


@lane_step(int64(WALK, int64))
def _grown(walk: Walk, iterations: int) -> int:
    """`grow_within` on pointers, once the roots are planted."""
    search, counters = walk.search, walk.search.counters
    last = counters[ITERATION] + iterations
    while counters[ITERATION] < last:
        if max(counters[SIZE], counters[SIZE + 1]) + 2 >= search.capacity:
            return FULL
        counters[ITERATION] += choose(walk.sampling, search, 1)
        tree, node = search.grown_trees[0], search.grown_nodes[0]
        for j in range(search.nv):
            search.target[j] = search.ends[j * LANES]
        counters[TRIED + tree] += 1
        reached, there = _walk(walk, tree, node)
        if there and counters[SIZE + tree] < search.capacity:
            reached = add_reached(search, tree, reached)
        if reached == node:
            search.failed[tree * search.capacity + node] += 1
        elif _met(walk, tree, reached):
            return MET
    return GOING_ON


@lane_kernel(int64(INDICES, INDICES, INDICES, FRAMES, STRIDES, ROOTS, ROOTS, int64, boolean))
def grow_within(
    world: Words,
    sampling: Words,
    search: Words,
    frames: KeptFrames,
    strides: Strides,
    starts: np.ndarray,
    goals: np.ndarray,
    iterations: int,
    begins: bool,
) -> int:
    """Grow two trees towards each other within path constraints.

    Args:
        world: Robot and obstacles, a packed `LaneWorld`.
        sampling: Where samples come from, a packed `Sampling`.
        search: The trees, a packed `TreeSearch`; changed. Its places say where the sequence of samples begins.
        frames: The constraints; all roots keep them.
        strides: How the trees walk.
        starts: Roots of the first tree, chart points in units of the sampling, shape (k, nv).
        goals: Roots of the second, shape (m, nv).
        iterations: How many more.
        begins: Whether to leave only the roots of the trees before, to forget what the world was asked, and to walk
            straight to each goal first.

    Returns:
        MET (the path is written), FULL (give it more room) or GOING_ON.

    Raises:
        ValueError: if roots, trees, constraints and robot aren't of as many coordinates.
    """
    among, sources, trees = world_of(pointers(world)), sampling_of(pointers(sampling)), search_of(pointers(search))
    nv = trees.nv
    if not starts.shape[1] == goals.shape[1] == among.nv == frames.chain.lower.shape[0] == nv:
        raise ValueError("roots, trees, constraints and robot differ in how many coordinates they have")
    outcome, walk = GOING_ON, Walk(among, sources, trees, frames, strides, np.empty(nv))
    if begins:
        begin(trees, starts, goals)
        forget(among)
        for goal in range(trees.counters[PLANTED + 1]):
            if outcome != MET and _met(walk, 1, goal):
                outcome = MET
    if outcome != MET:
        outcome = _grown(walk, iterations)
    if outcome == MET:
        join(sources, trees, starts, goals)
    return outcome
