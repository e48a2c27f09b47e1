"""RRT-Connect within path constraints: the trees of rrt_connect.py, whose every step is brought onto the constraints.

After CBiRRT (Berenson et al., ICRA 2009): a stride towards a sample is corrected by Newton's method until the
constraints hold with some room to spare. Samples, the nearest nodes, motions and paths are those of rrt_connect.py,
without its domains and batches. `planner/tree_search.py` sets `Strides`: others give other paths for a seed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import boolean, int64, types

from guidefield.kernels.collide.batch_collision import forget
from guidefield.kernels.collide.layout import WORLD, BatchWorld, world_of
from guidefield.kernels.jit.arrays import FLOAT_POINTER, VECTOR_OUT, AnyRows, Floats, Floats32, Indices, numba_type
from guidefield.kernels.jit.decorators import vector_kernel, vector_part, vector_step
from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.simd.vector import LANES
from guidefield.kernels.tree.informed_samples import SAMPLING, Sampling, sampling_of
from guidefield.kernels.tree.nodes import (
    ITERATION,
    MEETING,
    MOTIONS,
    PLANTED,
    SEARCH,
    SIZE,
    TRIED,
    TreeSearch,
    add_reached,
    aim_at,
    join,
    nearest,
    search_of,
    step_towards,
)
from guidefield.kernels.tree.path_constraints import FRAMES, KeptFrames, bring_back, largest_share
from guidefield.kernels.tree.rrt_connect import FULL, GOING_ON, MET, begin, choose, is_free


class Strides(NamedTuple):
    """Settings of trees within path constraints."""

    length: float  # of a stride, by the metric [rad]
    least_gain: float  # a walk ends with a stride that comes nearer to its target by less than this share of its length
    farthest: float  # and with one that ends this many lengths from where it began
    room: float  # strides are brought to within this share of each limit
    corrections: int  # Newton's steps for that, at most
    resolution: float  # samples of a motion per length [1/rad or 1/m]
    clearance: float  # what to keep from obstacles [m]


class Walk(NamedTuple):
    """Tables and memory that a step of a tree needs."""

    world: BatchWorld  # robot and obstacles
    sampling: Sampling  # where samples come from
    search: TreeSearch
    frames: KeptFrames
    strides: Strides  # how the trees walk
    z: Floats  # scratch, shape (nv,)


STRIDES = numba_type(Strides)
WALK = types.BaseTuple.from_types((WORLD, SAMPLING, SEARCH, FRAMES, STRIDES, VECTOR_OUT), Walk)


@vector_step(types.float64(FLOAT_POINTER, FLOAT_POINTER, int64, SAMPLING))
def _distance(a: Floats32, b: Floats32, nv: int, sampling: Sampling) -> float:
    """Return how far two points, shape (nv,), are apart, the short way round."""
    square = 0.0
    for j in range(nv):
        offset = a[j] - b[j]
        if sampling.period[j] != 0.0:
            offset -= np.float32(np.rint(offset * sampling.frequency[j])) * sampling.period[j]
        square += offset * offset
    return math.sqrt(square)


@vector_step(boolean(WALK, types.float64))
def _correct(walk: Walk, left: float) -> bool:
    """Bring what is reached onto the constraints; whether it still leads to the target, which was `left` away."""
    sampling, search, strides, z = walk.sampling, walk.search, walk.strides, walk.z
    for j in range(search.nv):
        z[j] = search.reached[j] * sampling.units[j]
    if not bring_back(walk.frames, strides.room, strides.corrections, z):
        return False
    for j in range(search.nv):
        search.reached[j] = z[j] / sampling.units[j]
    gained = left - _distance(search.reached, search.target, search.nv, sampling)
    moved = _distance(search.reached, search.origin, search.nv, sampling)
    return bool(gained >= strides.least_gain * strides.length and moved <= strides.farthest * strides.length)


@vector_step(boolean(WALK))
def _is_kept(walk: Walk) -> bool:
    """Tell if the constraints hold where a stride ends, and in its middle."""
    search, z = walk.search, walk.z
    for share in (1.0, 0.5):
        for j in range(search.nv):
            z[j] = (search.origin[j] + share * (search.reached[j] - search.origin[j])) * walk.sampling.units[j]
        if largest_share(walk.frames, z) > 1.0:
            return False
    return True


@vector_step(types.UniTuple(int64, 2)(WALK, int64, int64))
def _walk(walk: Walk, tree: int, node: int) -> tuple[int, int]:
    """Walk from a node to the target, a stride at a time, as far as each leads there and is free.

    Returns the last node, and whether a free stride from there ends at the target, which is what is reached then.
    """
    search, strides, counters = walk.search, walk.strides, walk.search.counters
    while counters[SIZE + tree] < search.capacity:
        left = step_towards(search, tree, node, search.target, walk.sampling, strides.length)
        there = left <= strides.length
        if not there and not _correct(walk, left):
            break
        if not _is_kept(walk):
            break
        counters[MOTIONS] += 1
        if not is_free(walk.world, walk.sampling, search, strides.clearance, strides.resolution):
            break
        if there:
            return node, 1
        node = add_reached(search, tree, node)
    return node, 0


@vector_part
def _walk_other(walk: Walk, tree: int, node: int) -> bool:
    """Walk from the other tree to a node of a tree; whether it gets there."""
    search, other = walk.search, 1 - tree
    aim_at(search, tree, node)
    last, there = _walk(walk, other, nearest(search, other, search.target, walk.sampling))
    if there:
        search.counters[MEETING + tree], search.counters[MEETING + other] = node, last
    return bool(there)


@vector_step(int64(WALK, int64))
def _grow(walk: Walk, iterations: int) -> int:
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
        elif _walk_other(walk, tree, reached):
            return MET
    return GOING_ON


@vector_kernel
def grow_within(
    world: Indices,
    sampling: Indices,
    search: Indices,
    frames: KeptFrames,
    strides: Strides,
    starts: AnyRows,
    goals: AnyRows,
    iterations: int,
    begins: bool,
) -> int:
    """Grow two trees towards each other within path constraints; roots (k, nv), (m, nv), else as `rrt_connect.grow`."""
    among, sources, trees = world_of(pointers(world)), sampling_of(pointers(sampling)), search_of(pointers(search))
    nv = trees.nv
    if not starts.shape[1] == goals.shape[1] == among.nv == frames.chain.lower.shape[0] == nv:
        raise ValueError("roots, trees, constraints and robot differ in how many coordinates they have")
    outcome, walk = GOING_ON, Walk(among, sources, trees, frames, strides, np.empty(nv))
    if begins:
        begin(trees, starts, goals)
        forget(among)
        for goal in range(trees.counters[PLANTED + 1]):
            if outcome != MET and _walk_other(walk, 1, goal):
                outcome = MET
    if outcome != MET:
        outcome = _grow(walk, iterations)
    if outcome == MET:
        join(sources, trees, starts, goals)
    return outcome
