"""Shortcuts of a path in SIMD batches: detours left out, then free straight motions between places on it.

Places come from a fixed sequence that fills the square of pairs evenly: another gives other paths, as free at samples.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.collide.batch_collision import motion_free
from guidefield.kernels.collide.layout import BatchWorld, world_of
from guidefield.kernels.jit.arrays import Indices, Rows, RowsOut, SingleRows
from guidefield.kernels.jit.decorators import vector_kernel, vector_part
from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.simd.vector import LANES

# The additive recurrence of the plastic number (M. Roberts, 2018).
_STEP_X, _STEP_Y = 0.7548776662466927, 0.5698402909980532


@vector_part
def _length(world: BatchWorld, path: np.ndarray, segment: int) -> float:
    """Length of a segment of a path, each coordinate as it counts."""
    square = 0.0
    for j in range(path.shape[1]):
        square += ((path[segment + 1, j] - path[segment, j]) * world.fractions[LANES + j]) ** 2
    return math.sqrt(square)


@vector_part
def _total(world: BatchWorld, path: np.ndarray, count: int) -> float:
    total = 0.0
    for segment in range(count - 1):
        total += _length(world, path, segment)
    return total


@vector_part
def _move(path: np.ndarray, first: int, count: int, by: int) -> None:
    """Move the points from `first` on by some places, towards the end where that is positive."""
    for k in range(count - first):
        i = count - 1 - k if by > 0 else first + k
        for j in range(path.shape[1]):
            path[i + by, j] = path[i, j]


@vector_part
def _place(world: BatchWorld, path: np.ndarray, count: int, along: float, point: int) -> int:
    """Write the place so far along a path into one of its rows; the segment that it is on."""
    segment = 0
    while segment < count - 2 and along > _length(world, path, segment):
        along -= _length(world, path, segment)
        segment += 1
    share = np.float32(min(along / max(_length(world, path, segment), 1e-12), 1.0))
    for j in range(path.shape[1]):
        path[point, j] = path[segment, j] + share * (path[segment + 1, j] - path[segment, j])
    return segment


@vector_part
def _without_detours(world: BatchWorld, path: np.ndarray, count: int, clearance: float, resolution: float) -> int:
    """From each point on, leave out all before the farthest that is reached straight; return how many are left."""
    i = 0
    while i < count - 2:
        for j in range(count - 1, i + 1, -1):
            if motion_free(world, clearance, pointers(path[i]), pointers(path[j]), resolution):
                _move(path, j, count, i + 1 - j)
                count -= j - i - 1
                break
        i += 1
    return count


@vector_part
def _with_shortcuts(
    world: BatchWorld, path: np.ndarray, count: int, clearance: float, resolution: float, tries: int
) -> int:
    """Take straight paths between places on a path, where they are free; how many points it has then.

    Each try may need one row more; the last two are for looking ahead.
    """
    low, high, total = len(path) - 2, len(path) - 1, _total(world, path, count)
    for k in range(tries):
        if count < 3:
            break
        x, y = (0.5 + k * _STEP_X) % 1.0, (0.5 + k * _STEP_Y) % 1.0
        start = _place(world, path, count, min(x, y) * total, low)
        end = _place(world, path, count, max(x, y) * total, high)
        if start < end and motion_free(world, clearance, pointers(path[low]), pointers(path[high]), resolution):
            more = 2 + start - end
            _move(path, end + 1, count, more)
            count += more
            for j in range(path.shape[1]):
                path[start + 1, j], path[start + 2, j] = path[low, j], path[high, j]
            total = _total(world, path, count)
    return count


@vector_kernel
def shorten(
    words: Indices, path: Rows, clearance: float, resolution: float, tries: int, rows: SingleRows, short_out: RowsOut
) -> int:
    """Leave out detours of a path (n, nv), take straight paths between places on it, and leave out detours again.

    `words` are a packed `BatchWorld`, `clearance` is kept from obstacles [m], `resolution` is samples per length
    [1/rad or 1/m], `tries` the number of pairs of places; scratch of shape (n + tries + 2, nv), float32, and so is
    `short_out`, whose ends are as they were given. Returns the count of points.
    """
    world, count, nv = world_of(pointers(words)), len(path), path.shape[1]
    for i in range(count):
        for j in range(nv):
            rows[i, j] = path[i, j]
    count = _without_detours(world, rows, count, clearance, resolution)
    count = _with_shortcuts(world, rows, count, clearance, resolution, tries)
    count = _without_detours(world, rows, count, clearance, resolution)
    for i in range(count):
        for j in range(nv):
            short_out[i, j] = rows[i, j]
    for j in range(nv):
        short_out[0, j], short_out[count - 1, j] = path[0, j], path[len(path) - 1, j]
    return count
