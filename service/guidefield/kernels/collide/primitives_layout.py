"""Tables of primitives for the lane kernels."""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

import numpy as np
from numba import int64

from guidefield.kernels.collide.arena import LINE, SCENE_WORDS
from guidefield.kernels.collide.balls import BALL_ROW, RADIUS
from guidefield.kernels.collide.layout import LaneObstacles
from guidefield.kernels.collide.parts import (
    BLOCKS,
    DISC,
    FIRST_BLOCK,
    HALF_LENGTH as PART_LENGTH,
    KIND,
    LEFT,
    LINK,
    OWN,
    PART,
    PLANE_OFFSET,
    POLYTOPE,
    RIGHT,
    ROUND as PART_ROUND,
    SHAPE,
    Parts,
)
from guidefield.kernels.collide.primitive import (
    AXES,
    BOX,
    CAPSULE,
    CENTRE,
    CYLINDER,
    HALF_LENGTH,
    HALF_SPACE,
    HALVES,
    PRIMITIVE,
    ROUND,
)
from guidefield.kernels.jit.fields import numba_type
from guidefield.kernels.jit.signatures import INDICES, INDICES_OUT, VECTOR, Floats, Floats32, compiled, inlined
from guidefield.kernels.simd.blocks import AROUND, BLOCK
from guidefield.kernels.simd.packing import Words, pointers, unpacked
from guidefield.kernels.simd.vector_model import LANES

CORNERS = 8
"""Of a box."""

PLACED = struct.Struct("12d")
"""A primitive as it is declared: its kind, a unit quaternion (x, y, z, w), then centre, half extents and radius as in
`PRIMITIVE`; of a half-space the normal is in the place of half extents."""

_PLACED = PLACED.size // 8

NORMAL = AXES + 6
"""Where the third axis of a primitive is; of a half-space it is the normal."""


class _Scene(NamedTuple):
    """Obstacles and their shapes."""

    obstacles: LaneObstacles
    parts: Parts


_scene_of = unpacked(numba_type(_Scene))


@inlined
def _box_about(kind: int, row: Floats, boxes: Floats32, place: int) -> None:
    """Write the box along the world's axes, coordinate by coordinate sixteen places apart."""
    for k in range(3):
        if kind == HALF_SPACE:
            low = row[CENTRE + k] if row[NORMAL + k] == -1.0 else -math.inf
            high = row[CENTRE + k] if row[NORMAL + k] == 1.0 else math.inf
        else:
            reach = row[HALVES] * abs(row[k]) + row[HALVES + 1] * abs(row[3 + k])
            reach += row[HALVES + 2] * abs(row[NORMAL + k])
            if kind == CAPSULE:
                reach += row[ROUND]
            elif kind == CYLINDER:
                reach += row[ROUND] * math.sqrt(row[k] * row[k] + row[3 + k] * row[3 + k])
            low, high = row[CENTRE + k] - reach, row[CENTRE + k] + reach
        boxes[place + LANES * k], boxes[place + LANES * (3 + k)] = low, high


@inlined
def _radius(kind: int, row: Floats) -> float:
    """Of the ball about a primitive's centre that contains it [m]."""
    if kind == HALF_SPACE:
        return math.inf
    if kind == CAPSULE:
        return float(row[HALF_LENGTH] + row[ROUND])
    if kind == CYLINDER:
        return math.sqrt(row[ROUND] * row[ROUND] + row[HALF_LENGTH] * row[HALF_LENGTH])
    return math.sqrt(row[HALVES] ** 2 + row[HALVES + 1] ** 2 + row[HALVES + 2] ** 2)


@inlined
def _corners(row: Floats, vertices: Floats32, place: int) -> None:
    """Write a box's corners; the first one once more in every place that is left."""
    for lane in range(LANES):
        corner = lane if lane < CORNERS else 0
        for k in range(3):
            at = row[CENTRE + k]
            for axis in range(3):
                side = 1.0 if corner >> (2 - axis) & 1 else -1.0
                at += side * row[HALVES + axis] * row[3 * axis + k]
            vertices[place + LANES * k + lane] = at


@inlined
def _round(kind: int, row: Floats, numbers: Floats, place: int) -> None:
    """Write the numbers of a cylinder, a capsule or a half-space as a part."""
    if kind == HALF_SPACE:
        for k in range(3):
            numbers[place + k] = row[NORMAL + k]
            numbers[place + PLANE_OFFSET] += row[NORMAL + k] * row[CENTRE + k]
        return
    for k in range(3):
        for axis in range(3):
            numbers[place + 4 * k + axis] = row[3 * axis + k]
        numbers[place + 4 * k + 3] = row[CENTRE + k]
    numbers[place + PART_LENGTH] = row[HALF_LENGTH]
    numbers[place + (DISC if kind == CYLINDER else PART_ROUND)] = row[ROUND]


@inlined
def _write_axes(x: float, y: float, z: float, w: float, row: Floats) -> None:
    """Write the rows of the rotation from the world, of a body that is turned by a unit quaternion."""
    row[0], row[1], row[2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)
    row[3], row[4], row[5] = 2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + x * w)
    row[6], row[7], row[8] = 2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)


@inlined
def _write_row(kind: int, placed: Floats, at: int, row: Floats) -> None:
    """Write the numbers of a primitive, as `PRIMITIVE` has them."""
    _write_axes(placed[at + 1], placed[at + 2], placed[at + 3], placed[at + 4], row)
    for k in range(7):
        row[CENTRE + k] = placed[at + 5 + k]
    if kind == HALF_SPACE:
        for k in range(3):
            row[k] = row[3 + k] = row[HALVES + k] = 0.0
            row[NORMAL + k] = placed[at + 8 + k]


@compiled(int64(VECTOR, INDICES, INDICES_OUT, INDICES_OUT))
def primitive_tables(placed: Floats, offsets: Words, memory: Words, words: Words) -> int:
    """Tables of primitives each of which is an obstacle: one node and one part each, and a block of vertices of a box.

    Args:
        placed: How they are declared, `PLACED` one after the other.
        offsets: For how many obstacles there are boxes, then where in the memory each other field of `LaneObstacles` is
            and of `Parts` [bytes], vertices as if all were boxes; shape (SCENE_WORDS,).
        memory: All zero; gets the tables, from where a line of the cache begins. What may touch isn't there.
        words: Gets their words, shape (SCENE_WORDS,).

    Returns:
        Where that is [bytes].
    """
    begins = -memory.ctypes.data % LINE
    for k in range(1, SCENE_WORDS):
        words[k] = memory.ctypes.data + begins + offsets[k]
    words[0] = offsets[0]
    obstacles, parts = _scene_of(pointers(words))
    boxes, blocks, row = obstacles.boxes, 0, np.empty(PRIMITIVE)
    for block in range((obstacles.size + LANES - 1) // LANES):
        for k in range(AROUND):
            boxes[AROUND * block + k] = math.inf if k < AROUND // 2 else -math.inf
    for i in range(len(placed) // _PLACED):
        kind = int(placed[_PLACED * i])
        _write_row(kind, placed, _PLACED * i, row)
        obstacles.kinds[i], obstacles.whole[i], obstacles.roots[i] = kind, 1, i
        for k in range(PRIMITIVE):
            obstacles.primitives[PRIMITIVE * i + k] = row[k]
        _box_about(kind, row, boxes, AROUND * (i // LANES) + i % LANES)
        for k in range(3):
            parts.balls[BALL_ROW * i + k] = row[CENTRE + k]
        parts.balls[BALL_ROW * i + RADIUS] = _radius(kind, row)
        node, shape = LINK * i, SHAPE * i
        parts.links[node + LEFT], parts.links[node + RIGHT], parts.links[node + OWN] = -1, -1, i
        parts.shapes[shape + KIND] = POLYTOPE if kind == BOX else kind
        parts.shapes[shape + FIRST_BLOCK], parts.shapes[shape + BLOCKS] = blocks, 1 if kind == BOX else 0
        if kind == BOX:
            _corners(row, parts.vertices, BLOCK * blocks)
            blocks += 1
        else:
            _round(kind, row, parts.numbers, PART * i)
    return begins
