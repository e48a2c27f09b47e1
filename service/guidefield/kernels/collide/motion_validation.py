"""Straight motions judged by samples, sixteen at a time: spread over the whole motion first, then ever closer."""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, int64, types, void

from guidefield.kernels.collide.batch_collision import block_touches
from guidefield.kernels.collide.layout import (
    HIT,
    HITS,
    WORLD,
    LaneWorld,
    world_of,
)
from guidefield.kernels.collide.separating_axes import forget_axes
from guidefield.kernels.jit.signatures import (
    FLOAT_POINTER,
    INDICES,
    Floats32,
    lane_kernel,
    lane_step,
)
from guidefield.kernels.simd.packing import Words, pointers
from guidefield.kernels.simd.vector import LANES, load, splat, store

FRACTIONS = np.arange(1, LANES + 1, dtype=np.float32)
FRACTIONS.setflags(write=False)
"""1 to 16: what a sample's place on a motion is made of."""

EXACT = 1e-3
"""A share of a block: motions that are as long as whole blocks get no more for being rounded up to float32."""


@lane_step(boolean(WORLD, types.float64, FLOAT_POINTER, FLOAT_POINTER, types.float64))
def motion_free(world: LaneWorld, clearance: float, z0: Floats32, z1: Floats32, resolution: float) -> bool:
    """Tell if no sample of the straight motion from z0 to z1 touches; the first is not looked at, the last is.

    With b blocks of sixteen, block k looks at the places (b i - k) / (16 b), i = 1 .. 16: the first spreads over the
    whole motion and holds its end.

    Args:
        world: Robot and obstacles.
        clearance: What to keep from obstacles [m].
        z0: Where the motion begins, a chart point, shape (nv,) [rad or m].
        z1: Where it ends, shape (nv,).
        resolution: Samples per length in the chart [1/rad or 1/m, at size 1].
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
        if block_touches(world, clearance, k == 0):
            return False
    return True


@lane_step(void(WORLD))
def forget(world: LaneWorld) -> None:
    """Forget what earlier answers left behind: the same questions from here on have the same answers to the bit."""
    scratch = world.scratch
    forget_axes(scratch.obstacle_axes, scratch.obstacle_places)
    forget_axes(scratch.pair_axes, scratch.pair_places)
    for k in range(HIT * HITS):
        scratch.hits[k] = -1


@lane_kernel(void(INDICES, types.float64, types.Array(types.float32, 2, "C"), types.Array(types.boolean, 1, "C")))
def touching_configurations(
    words: Words, clearance: float, configurations: np.ndarray, touching_out: np.ndarray
) -> None:
    """Return which of some chart points touch, one after another.

    Args:
        words: Robot and obstacles, a packed `LaneWorld`.
        clearance: What to keep from obstacles [m].
        configurations: Chart points, shape (n, nv) [rad or m].
        touching_out: Shape (n,).
    """
    world = world_of(pointers(words))
    for i in range(configurations.shape[0]):
        for j in range(configurations.shape[1]):
            store(world.block, j * LANES, splat(configurations[i, j]))
        touching_out[i] = block_touches(world, clearance, True)


@lane_kernel(int64(INDICES, types.float64, types.Array(types.float32, 2, "C"), types.float64))
def path_free_until(words: Words, clearance: float, path: np.ndarray, resolution: float) -> int:
    """Return how many of the straight motions along a path are free before the first that is not.

    Args:
        words: Robot and obstacles, a packed `LaneWorld`.
        clearance: What to keep from obstacles [m].
        path: Chart points, shape (n, nv) [rad or m].
        resolution: Samples per length in the chart [1/rad or 1/m].
    """
    world = world_of(pointers(words))
    for i in range(path.shape[0] - 1):
        if not motion_free(world, clearance, pointers(path[i]), pointers(path[i + 1]), resolution):
            return i
    return len(path) - 1
