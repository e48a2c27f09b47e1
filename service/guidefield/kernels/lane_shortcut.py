"""Paths shortened in lanes: detours left out where the straight way is free, then straight ways between places.

The places come from a fixed sequence that fills the square of pairs evenly, so the same path becomes the same one.
"""

from __future__ import annotations

import math

import numpy as np
from numba import int64, types

from guidefield.kernels.lane_motion import motion_free, world_of
from guidefield.kernels.lanes import lane_kernel, lane_part, pointers
from guidefield.kernels.packing import Words
from guidefield.kernels.tree_kinematics import INDICES

_PATH = types.Array(types.float32, 2, "C")

# The additive recurrence of the plastic number (M. Roberts, 2018).
_STEP_X, _STEP_Y = 0.7548776662466927, 0.5698402909980532


@lane_part
def _length(path: np.ndarray, segment: int) -> float:
    """Length of a segment of a path."""
    square = 0.0
    for j in range(path.shape[1]):
        square += (path[segment + 1, j] - path[segment, j]) ** 2
    return math.sqrt(square)


@lane_part
def _moved(path: np.ndarray, first: int, count: int, by: int) -> None:
    """Move the points from `first` on by some places, towards the end where that is positive."""
    for k in range(count - first):
        i = count - 1 - k if by > 0 else first + k
        for j in range(path.shape[1]):
            path[i + by, j] = path[i, j]


@lane_part
def _place(path: np.ndarray, count: int, along: float, point: int) -> int:
    """Write the place so far along a path into one of its rows; the segment that it is on."""
    segment = 0
    while segment < count - 2 and along > _length(path, segment):
        along -= _length(path, segment)
        segment += 1
    share = np.float32(min(along / max(_length(path, segment), 1e-12), 1.0))
    for j in range(path.shape[1]):
        path[point, j] = path[segment, j] + share * (path[segment + 1, j] - path[segment, j])
    return segment


@lane_kernel(int64(INDICES, _PATH, int64, types.float64, types.float64))
def without_detours(words: Words, path: np.ndarray, count: int, clearance: float, resolution: float) -> int:
    """From each point on, leave out all before the farthest that is reached straight.

    Args:
        words: Robot and obstacles, a packed `LaneWorld`.
        path: Chart points, the first `count` of its rows, shape (n, nv) [rad or m]; changed.
        count: How many points there are.
        clearance: What to keep from obstacles [m].
        resolution: Samples per length in the chart [1/rad or 1/m].

    Returns:
        How many points are left.
    """
    world, i = world_of(pointers(words)), 0
    while i < count - 2:
        for j in range(count - 1, i + 1, -1):
            if motion_free(world, clearance, pointers(path[i]), pointers(path[j]), resolution):
                _moved(path, j, count, i + 1 - j)
                count -= j - i - 1
                break
        i += 1
    return count


@lane_kernel(int64(INDICES, _PATH, int64, types.float64, types.float64, int64, int64))
def shortcut(
    words: Words, path: np.ndarray, count: int, clearance: float, resolution: float, first: int, tries: int
) -> int:
    """Take straight ways between places on a path, where they are free.

    Args:
        words: Robot and obstacles, a packed `LaneWorld`.
        path: Chart points, the first `count` of its rows, shape (n, nv) [rad or m]; changed. Each try may need one row
            more; the last two are for looking ahead.
        count: How many points there are.
        clearance: What to keep from obstacles [m].
        resolution: Samples per length in the chart [1/rad or 1/m].
        first: Where in the sequence of places to begin.
        tries: How many pairs of places.

    Returns:
        How many points there are now.
    """
    world, low, high = world_of(pointers(words)), len(path) - 2, len(path) - 1
    for k in range(first, first + tries):
        total = 0.0
        for segment in range(count - 1):
            total += _length(path, segment)
        x, y = (0.5 + k * _STEP_X) % 1.0, (0.5 + k * _STEP_Y) % 1.0
        start = _place(path, count, min(x, y) * total, low)
        end = _place(path, count, max(x, y) * total, high)
        if start < end and motion_free(world, clearance, pointers(path[low]), pointers(path[high]), resolution):
            more = 2 + start - end
            _moved(path, end + 1, count, more)
            count += more
            for j in range(path.shape[1]):
                path[start + 1, j], path[start + 2, j] = path[low, j], path[high, j]
    return count
