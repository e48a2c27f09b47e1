"""Tables of primitives for the lane kernels."""

from __future__ import annotations

import math

import numpy as np
from numba import types, void
from numpy.typing import NDArray

from guidefield.kernels.lane_math import BOX, CAPSULE, CYLINDER, HALF_SPACE, PRIMITIVE, Floats32
from guidefield.kernels.lanes import FLOATS_OUT, INTEGERS_OUT, LANES
from guidefield.kernels.separation import BLOCK, PART, POLYTOPE, Parts
from guidefield.kernels.signatures import MATRIX, VECTOR_OUT, Floats, compiled, inlined
from guidefield.kernels.tree_kinematics import INDICES

Integers = NDArray[np.int64]

CORNERS = 8
"""Of a box."""

_PARTS_OUT = types.NamedTuple([VECTOR_OUT, INTEGERS_OUT, INTEGERS_OUT, VECTOR_OUT, FLOATS_OUT], Parts)


@inlined
def _box_about(kind: int, row: Floats, boxes: Floats32, place: int) -> None:
    """Write the box along the world's axes, coordinate by coordinate sixteen places apart."""
    for k in range(3):
        if kind == HALF_SPACE:
            low = row[9 + k] if row[6 + k] == -1.0 else -math.inf
            high = row[9 + k] if row[6 + k] == 1.0 else math.inf
        else:
            reach = row[12] * abs(row[k]) + row[13] * abs(row[3 + k]) + row[14] * abs(row[6 + k])
            if kind == CAPSULE:
                reach += row[15]
            elif kind == CYLINDER:
                reach += row[15] * math.sqrt(max(1.0 - row[6 + k] * row[6 + k], 0.0))
            low, high = row[9 + k] - reach, row[9 + k] + reach
        boxes[place + LANES * k], boxes[place + LANES * (3 + k)] = low, high


@inlined
def _radius(kind: int, row: Floats) -> float:
    """Of the ball about a primitive's centre that contains it [m]."""
    if kind == HALF_SPACE:
        return math.inf
    if kind == CAPSULE:
        return float(row[14] + row[15])
    if kind == CYLINDER:
        return math.sqrt(row[15] * row[15] + row[14] * row[14])
    return math.sqrt(row[12] * row[12] + row[13] * row[13] + row[14] * row[14])


@inlined
def _corners(row: Floats, vertices: Floats32, place: int) -> None:
    """Write a box's corners; the first one once more in every place that is left."""
    for lane in range(LANES):
        corner = lane if lane < CORNERS else 0
        for k in range(3):
            at = row[9 + k]
            for axis in range(3):
                side = 1.0 if corner >> (2 - axis) & 1 else -1.0
                at += side * row[12 + axis] * row[3 * axis + k]
            vertices[place + LANES * k + lane] = at


@inlined
def _round(kind: int, row: Floats, numbers: Floats, place: int) -> None:
    """Write the numbers of a cylinder, a capsule or a half-space as a part."""
    if kind == HALF_SPACE:
        for k in range(3):
            numbers[place + k] = row[6 + k]
            numbers[place + 3] += row[6 + k] * row[9 + k]
        return
    for k in range(3):
        for axis in range(3):
            numbers[place + 4 * k + axis] = row[3 * axis + k]
        numbers[place + 4 * k + 3] = row[9 + k]
    numbers[place + 14] = row[14]
    numbers[place + (12 if kind == CYLINDER else 15)] = row[15]


@compiled(void(INDICES, MATRIX, FLOATS_OUT, FLOATS_OUT, _PARTS_OUT))
def primitive_tables(kinds: Integers, rows: Floats, primitives: Floats32, boxes: Floats32, parts: Parts) -> None:
    """Tables of primitives each of which is an obstacle: one node and one part each, and a block of vertices of a box.

    Args:
        kinds: lane_math's kinds, shape (n,).
        rows: Their numbers, shape (n, PRIMITIVE).
        primitives: The same, as `LaneObstacles` has them.
        boxes: As `LaneObstacles` has them; places behind theirs are left as they are.
        parts: Their shapes.
    """
    blocks = 0
    for i in range(len(kinds)):
        row, kind = rows[i], kinds[i]
        for k in range(PRIMITIVE):
            primitives[PRIMITIVE * i + k] = row[k]
        _box_about(kind, row, boxes, 6 * LANES * (i // LANES) + i % LANES)
        for k in range(3):
            parts.balls[4 * i + k] = row[9 + k]
        parts.balls[4 * i + 3] = _radius(kind, row)
        parts.links[3 * i], parts.links[3 * i + 1], parts.links[3 * i + 2] = -1, -1, i
        parts.shapes[3 * i], parts.shapes[3 * i + 1], parts.shapes[3 * i + 2] = kind, blocks, 0
        for k in range(PART):
            parts.numbers[PART * i + k] = 0.0
        if kind == BOX:
            parts.shapes[3 * i], parts.shapes[3 * i + 2] = POLYTOPE, 1
            _corners(row, parts.vertices, BLOCK * blocks)
            blocks += 1
        else:
            _round(kind, row, parts.numbers, PART * i)
