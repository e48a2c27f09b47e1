"""Tables of primitives for SIMD batches, and the words and memory of a world, each written by one call.

The order of words is that of `LaneWorld`; offsets are those of `collision/lanes/scene_tables.py`.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.layout import HIT, HITS, DriftingBoxes, LaneObstacles, Scratch
from guidefield.kernels.collide.parts import (
    BALL_ROW,
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
    RADIUS,
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
from guidefield.kernels.jit.arrays import Floats, Floats32, IndexRows, Indices, IndicesOut, Row, numba_type
from guidefield.kernels.jit.decorators import inlined, inner_kernel, kernel
from guidefield.kernels.simd.packing import AROUND, BLOCK, pointers, unpacked
from guidefield.kernels.simd.vector_model import LANES

LINE = 64  # bytes of a line of the cache: sixteen floats that lie across two of them take twice as long to get
SCENE_WORDS = len(LaneObstacles._fields) + len(Parts._fields)  # number of words of obstacles and their shapes

_IGNORED = LaneObstacles._fields.index("ignored")

MEMORY_WORDS = len(Scratch._fields) + 1  # number of words behind those: of the scratch and the block
DRIFT_WORDS = len(DriftingBoxes._fields)  # and behind those, not written here

_HITS = 1 + Scratch._fields.index("hits")


@inner_kernel
def _write_left_out(left_out: IndexRows, owners: Indices, ignored: IndicesOut) -> None:
    """Mark what may touch: for each body all obstacles that stand for one of the scene."""
    n, most = len(owners), -1
    for o in range(n):
        most = max(most, owners[o])
    last, before = np.full(most + 1, -1), np.empty(n, np.int64)
    for o in range(n):
        before[o] = last[owners[o]]
        last[owners[o]] = o
    for p in range(len(left_out)):
        o = last[left_out[p, 1]] if left_out[p, 1] <= most else -1
        while o >= 0:
            ignored[left_out[p, 0] * n + o] = 1
            o = before[o]


@kernel
def lay_out(
    robot: Indices,
    scene: Indices,
    offsets: Indices,
    owners: Indices,
    bodies: int,
    moving: Indices,
    left_out: IndexRows,
    memory: IndicesOut,
    words: IndicesOut,
) -> int:
    """Write a world's words, and what its memory holds at first; return where that begins [bytes].

    `scene` (SCENE_WORDS,) has the words of obstacles and their shapes, `offsets` (1 + MEMORY_WORDS,) is where in the
    memory there is what may touch, the scratch and the block [bytes], `owners` (n,) names the obstacle of the scene
    that each represents, `moving` (m,) are the bodies tested against obstacles, ascending, but for the pairs `left_out`
    (k, 2). The memory is all zero; what is in it begins where a line of the cache does.
    """
    first, n, begins = len(robot), len(owners), -memory.ctypes.data % LINE
    start = memory.ctypes.data + begins
    words[:first] = robot
    words[first : first + SCENE_WORDS] = scene
    words[first + _IGNORED] = start + offsets[0]
    for k in range(MEMORY_WORDS):
        words[first + SCENE_WORDS + k] = start + offsets[1 + k]
    at = (begins + offsets[_HITS]) // 8
    memory[at : at + HIT * HITS] = -1
    at = (begins + offsets[0]) // 8
    k = 0
    for body in range(bodies):  # of a mesh of very many triangles little is written: most stays as it is
        if k < len(moving) and moving[k] == body:
            k += 1
        else:
            memory[at + body * n : at + (body + 1) * n] = 1
    if len(left_out):
        _write_left_out(left_out, owners, memory[at:])
    return begins


CORNERS = 8  # of a box

PLACED = struct.Struct("12d")
"""A primitive as it is declared: its kind, a unit quaternion (x, y, z, w), then centre, half extents and radius as in
`PRIMITIVE`; of a half-space the normal is in the place of half extents."""

_PLACED = PLACED.size // 8

NORMAL = AXES + 6  # place of the third axis of a primitive; of a half-space it is the normal


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
    """Radius of the ball about a primitive's centre that contains it [m]."""
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
    _write_axes(placed[at + 1], placed[at + 2], placed[at + 3], placed[at + 4], row)
    for k in range(7):
        row[CENTRE + k] = placed[at + 5 + k]
    if kind == HALF_SPACE:
        for k in range(3):
            row[k] = row[3 + k] = row[HALVES + k] = 0.0
            row[NORMAL + k] = placed[at + 8 + k]


@kernel
def primitive_tables(placed: Row, offsets: Indices, memory: IndicesOut, words: IndicesOut) -> int:
    """Write tables of primitives, each an obstacle of one node and one part, and a block of vertices of a box.

    `placed` has them as `PLACED`; `offsets` (SCENE_WORDS,) has the number of obstacles with boxes, then where in the
    memory each other field of `LaneObstacles` and `Parts` is [bytes], vertices as if all were boxes. The memory, all
    zero, gets the tables from where a line of the cache begins, which is returned [bytes], without what may touch.
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
