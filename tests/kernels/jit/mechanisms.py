"""Kernels of each kind, quick to compile: together they use all that is changed inside numba.

Parts: such as are compiled into their callers, are optimised before that, don't count references, and do so again.
Kernels: of Python's and of SIMD batches, steps that only kernels call, and those of other files.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types, void

from guidefield.kernels.jit.arrays import (
    FLOAT_POINTER,
    FLOATS,
    INDICES,
    INDICES_OUT,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    VECTOR,
    VECTOR_OUT,
    Floats,
    Row,
    numba_type,
)
from guidefield.kernels.jit.decorators import (
    compiled,
    counted,
    inlined,
    make_kernel as kernel,
    optimized,
    uncounted,
    vector_part,
    vector_step,
)
from guidefield.kernels.simd.packing import Words, pointers, unpacked
from guidefield.kernels.simd.rotations import cosine_and_sine
from guidefield.kernels.simd.vector import LANES, below, lane_count, load, root, splat, store, total
from guidefield.kernels.timing.hermite import piece_peaks

FLOATS_IN_OUT = types.Array(types.float32, 1, "C")


class Weighted(NamedTuple):
    """Values and their weights, shape (n,) each."""

    values: Row
    weights: Row


WEIGHTED = numba_type(Weighted)


@inlined
def _product(a: float, b: float) -> float:
    return a * b


@uncounted
def _weighted_sum(weighted: Weighted) -> float:
    found = 0.0
    for i in range(weighted.values.shape[0]):
        found += _product(weighted.values[i], weighted.weights[i])
    return found + _spread(weighted)


@counted
def _spread(weighted: Weighted) -> float:
    """The difference of the largest and the smallest value, by way of an array."""
    ends = np.empty(2)
    ends[0], ends[1] = weighted.values.min(), weighted.values.max()
    return float(ends[1] - ends[0])


@optimized
def _length(x: Any) -> float:
    """The sum of square roots, by vectors: the number of values is a multiple of their lanes."""
    found = 0.0 * load(x, 0)
    for i in range(0, x.shape[0], lane_count(x)):
        found = found + root(load(x, i) * load(x, i))
    return total(found)


@compiled(void(WEIGHTED, VECTOR_OUT))
def sums(weighted: Weighted, sums_out: Floats) -> None:
    """The weighted sum with the values' range, and the sum of their amounts."""
    sums_out[0], sums_out[1] = _weighted_sum(weighted), _length(weighted.values)


@compiled(SCALAR(VECTOR, MATRIX, MATRIX, MATRIX_OUT, MATRIX_OUT))
def fastest(times: Floats, positions: Floats, velocities: Floats, speeds_out: Floats, others_out: Floats) -> float:
    """The largest speed on a curve, by the kernel of another file."""
    piece_peaks(times, positions, velocities, speeds_out, others_out)
    return float(speeds_out.max())


class Turning(NamedTuple):
    """What is packed: angles, sixteen a row, where their cosines go, and how many rows there are."""

    angles: np.ndarray
    cosines: np.ndarray
    rows: int


turning_of = unpacked(types.NamedTuple([FLOATS, FLOATS_IN_OUT, types.int64], Turning))


@vector_part
def _doubled(lanes: Any) -> Any:
    return lanes + lanes


@vector_step(types.int64(FLOAT_POINTER, FLOAT_POINTER, types.int64))
def _turned(angles: Any, cosines_out: Any, row: int) -> int:
    c, s = cosine_and_sine(_doubled(load(angles, row * LANES)))
    store(cosines_out, row * LANES, c)
    return int(below(s, splat(0.0)))


@kernel(void(INDICES, INDICES_OUT))
def turned(words: Words, masks_out: np.ndarray) -> None:
    """Cosines of twice the angles, and which of their sines are negative."""
    turning = turning_of(pointers(words))
    for row in range(turning.rows):
        masks_out[row] = _turned(turning.angles, turning.cosines, row)
