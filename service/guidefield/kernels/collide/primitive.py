"""Primitives: their numbers, masks of sixteen points near one, axes away from it, bounds of many, tables of a scene's.

Two forms: rows of `PRIMITIVE` numbers, float32 for SIMD batches, and `PLACED` of `scene/obstacle.py`, float64, of which
`primitive_tables` fills what `collision/batch/scene_tables.py` made room for, in columns of `layout` and `parts`. For a
further kind what asks for kinds needs a branch, here, in `gjk.py`, `kernels/distance`, `prove/proof.py`; few refuse it.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.layout import LINE, SCENE_WORDS, BatchObstacles
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
from guidefield.kernels.distance.distance import BOX as BOX_BODY, CAPSULE as CAPSULE_BODY, CYLINDER as CYLINDER_BODY
from guidefield.kernels.jit.arrays import (
    BlocksOut,
    Floats,
    Floats32,
    Indices,
    IndicesOut,
    Row,
    RowOut,
    Rows,
    RowsOut,
    Vector3,
    numba_type,
)
from guidefield.kernels.jit.decorators import exact_kernel, inlined, kernel, vector_part
from guidefield.kernels.simd.packing import AROUND, BLOCK, pointers, unpacked
from guidefield.kernels.simd.vector import LANES, Vector, below, largest_of, magnitude, root, smallest_of, splat

BOX, CYLINDER, CAPSULE, HALF_SPACE = range(4)
"""Kinds of primitives; a ball is a capsule of no length. Other kinds of parts and obstacles have the numbers behind
these (`parts.POLYTOPE` and after it, `layout.CLOUD`)."""

AXES, CENTRE, HALVES, ROUND, PRIMITIVE = 0, 9, 12, 15, 16
"""Numbers of a primitive: three axes (rows of the rotation from the world), centre, half extents, radius; then how many
numbers there are.

A box has three half extents; a cylinder (flat ends) and a capsule have the half length of the axis as third and a
radius; of a half-space the third axis is the normal, and the centre is a point of its boundary.
"""

HALF_LENGTH = HALVES + 2  # place of the half length of a cylinder or a capsule

CORNERS = 8  # of a box

PLACED = struct.Struct("12d")
"""A primitive as it is declared: its kind, a unit quaternion (x, y, z, w), then centre, half extents and radius as in
`PRIMITIVE`; of a half-space the normal is in the place of half extents."""

_PLACED = PLACED.size // 8

NORMAL = AXES + 6  # place of the third axis of a primitive; of a half-space it is the normal


@vector_part
def _three(primitives: Floats32, at: int) -> Vector3:
    return primitives[at], primitives[at + 1], primitives[at + 2]


@vector_part
def _axis(primitives: Floats32, at: int, k: int) -> Vector3:
    return _three(primitives, at + AXES + 3 * k)


@vector_part
def _beyond(value: Vector, half: float) -> Vector:
    """Excess of a value over +-half, with its sign; 0 within."""
    return value - largest_of(smallest_of(value, splat(half)), splat(-half))


@vector_part
def near_primitive(kind: int, primitives: Floats32, at: int, x: Vector, y: Vector, z: Vector, reach: float) -> int:
    """Return the mask of sixteen world points closer than `reach` to a primitive, or in it [m].

    Its numbers begin at an index of `primitives` (PRIMITIVE * n,).
    """
    cx, cy, cz = _three(primitives, at + CENTRE)
    ax, ay, az = _axis(primitives, at, 2)
    dx, dy, dz = x - cx, y - cy, z - cz
    w = dx * ax + dy * ay + dz * az
    if kind == HALF_SPACE:
        return int(below(w, splat(reach)))
    zero = splat(0.0)
    if kind == BOX:
        ux, uy, uz = _axis(primitives, at, 0)
        vx, vy, vz = _axis(primitives, at, 1)
        hu, hv, hw = _three(primitives, at + HALVES)
        u = largest_of(magnitude(dx * ux + dy * uy + dz * uz) - hu, zero)
        v = largest_of(magnitude(dx * vx + dy * vy + dz * vz) - hv, zero)
        w = largest_of(magnitude(w) - hw, zero)
        return int(below(u * u + v * v + w * w, splat(reach * reach)))
    half, radius = primitives[at + HALF_LENGTH], primitives[at + ROUND]
    along = w
    if kind == CAPSULE:
        along = largest_of(smallest_of(w, splat(half)), splat(-half))
        reach += radius
    px, py, pz = dx - along * ax, dy - along * ay, dz - along * az
    across = px * px + py * py + pz * pz
    if kind == CAPSULE:
        return int(below(across, splat(reach * reach)))
    out = largest_of(root(across) - radius, zero)
    beyond = largest_of(magnitude(w) - half, zero)
    return int(below(out * out + beyond * beyond, splat(reach * reach)))


@vector_part
def away_from_primitive(
    kind: int, primitives: Floats32, at: int, x: Vector, y: Vector, z: Vector
) -> tuple[Vector, Vector, Vector, Vector]:
    """Return axes that point from a primitive to points, and how far it reaches along them.

    Arguments as `near_primitive`. The axes n are in the world, of any length, 0 from points in a box or cylinder; the
    reach is the largest n.p over the points p of the primitive.
    """
    cx, cy, cz = _three(primitives, at + CENTRE)
    ax, ay, az = _axis(primitives, at, 2)
    dx, dy, dz = x - cx, y - cy, z - cz
    w = dx * ax + dy * ay + dz * az
    if kind == HALF_SPACE:
        one = splat(1.0)
        nx, ny, nz, reach = one * ax, one * ay, one * az, splat(0.0)
    elif kind == BOX:
        ux, uy, uz = _axis(primitives, at, 0)
        vx, vy, vz = _axis(primitives, at, 1)
        hu, hv, hw = _three(primitives, at + HALVES)
        u = _beyond(dx * ux + dy * uy + dz * uz, hu)
        v = _beyond(dx * vx + dy * vy + dz * vz, hv)
        w = _beyond(w, hw)
        nx, ny, nz = u * ux + v * vx + w * ax, u * uy + v * vy + w * ay, u * uz + v * vz + w * az
        reach = magnitude(u) * hu + magnitude(v) * hv + magnitude(w) * hw
    else:
        half, radius = primitives[at + HALF_LENGTH], primitives[at + ROUND]
        beyond = _beyond(w, half)
        along = w - beyond if kind == CAPSULE else w
        nx, ny, nz = dx - along * ax, dy - along * ay, dz - along * az
        off = nx * ax + ny * ay + nz * az  # what rounding leaves along the axis, which counts `half` times
        if kind == CAPSULE:
            beyond = off
        else:
            nx, ny, nz = nx - off * ax, ny - off * ay, nz - off * az
        length = root(nx * nx + ny * ny + nz * nz)
        reach = magnitude(beyond) * half + length * radius
        if kind != CAPSULE:  # a cylinder: all times `length`
            out = largest_of(length - radius, splat(0.0))
            beyond = beyond * length
            nx, ny, nz = nx * out + beyond * ax, ny * out + beyond * ay, nz * out + beyond * az
            reach = magnitude(beyond) * half + length * out * radius
    return nx, ny, nz, reach + nx * cx + ny * cy + nz * cz


@vector_part
def write_rotation(placed: Floats, rotation: Floats) -> None:
    """Write the rotation of a primitive, `PLACED` of it of shape (12,), to the first three columns of (3, k)."""
    x, y, z, w = placed[1], placed[2], placed[3], placed[4]
    rotation[0, 0], rotation[0, 1] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w)
    rotation[1, 0], rotation[1, 1] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z)
    rotation[2, 0], rotation[2, 1] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w)
    rotation[0, 2], rotation[1, 2] = 2.0 * (x * z + y * w), 2.0 * (y * z - x * w)
    rotation[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@exact_kernel
def primitive_boxes(placed: Rows, axes: BlocksOut, middles: RowsOut, halves: RowsOut) -> None:
    """Write axes as columns (n, 3, 3), middles and half extents (n, 3) [m] of primitives `PLACED`, (n, 12).

    Of a half-space the middle is the origin and the extents are infinite.
    """
    for i in range(placed.shape[0]):
        row = placed[i]
        kind, radius = row[0], row[11]
        write_rotation(row, axes[i])
        for k in range(3):
            middles[i, k], half = row[5 + k], row[8 + k]
            if kind == HALF_SPACE:
                middles[i, k], half = 0.0, math.inf
            elif kind != BOX and k < 2:
                half = radius
            elif kind == CAPSULE:
                half += radius
            halves[i, k] = half


@exact_kernel
def along_both(axes: Rows, middles: Rows, halves: Rows, rounding: float, centres: RowsOut, boxes: RowsOut) -> None:
    """Write middles of boxes along their axes (n, 3), and boxes (n, 6) along the world's that contain them [m].

    `axes` (n, 9) are columns, row by row, `middles` and `halves` (n, 3) [m], infinite for what is endless; `rounding`
    widens world boxes, of a metre and of each metre from the origin.
    """
    for i in range(axes.shape[0]):
        a, m, h = axes[i], middles[i], halves[i]
        for k in range(3):
            centres[i, k] = m[0] * a[k] + m[1] * a[3 + k] + m[2] * a[6 + k]
            reach = abs(a[3 * k]) * h[0] + abs(a[3 * k + 1]) * h[1] + abs(a[3 * k + 2]) * h[2]
            if math.isinf(h[k]):
                reach = math.inf
            low, high = m[k] - reach, m[k] + reach
            wider = rounding * (1.0 + max(abs(low), abs(high)))
            boxes[i, k], boxes[i, 3 + k] = low - wider, high + wider


@exact_kernel
def primitive_bodies(
    placed: Rows,
    rounding: float,
    kinds: IndicesOut,
    sizes: RowsOut,
    bounds: RowsOut,
    placements: BlocksOut,
    boxes: RowsOut,
) -> None:
    """Write the rows of bodies as `DistanceTables` has them, of primitives `PLACED` (n, 12).

    Kinds (n,), sizes (n, 3), own boxes (n, 6), placements (n, 3, 4), and world boxes (n, 6), wider by `rounding` [m];
    of rows of zeros, which are no primitives, they mean nothing.
    """
    for i in range(placed.shape[0]):
        row, placement = placed[i], placements[i]
        write_rotation(row, placement)
        for k in range(3):
            placement[k, 3] = row[5 + k]
        radius, half = row[11], row[10]
        if row[0] == BOX:
            kinds[i] = BOX_BODY
            sizes[i, 0], sizes[i, 1], sizes[i, 2] = row[8], row[9], row[10]
            bounds[i, 3], bounds[i, 4], bounds[i, 5] = row[8], row[9], row[10]
        else:
            is_capsule = row[0] == CAPSULE
            kinds[i] = CAPSULE_BODY if is_capsule else CYLINDER_BODY
            sizes[i, 0], sizes[i, 1], sizes[i, 2] = radius, half, 0.0
            bounds[i, 3], bounds[i, 4], bounds[i, 5] = radius, radius, half + radius if is_capsule else half
        for k in range(3):
            bounds[i, k] = -bounds[i, 3 + k]
        for k in range(3):
            turned = placement[k]
            reach = abs(turned[0]) * bounds[i, 3] + abs(turned[1]) * bounds[i, 4] + abs(turned[2]) * bounds[i, 5]
            reach += rounding * (1.0 + abs(turned[3]))
            boxes[i, k], boxes[i, 3 + k] = turned[3] - reach, turned[3] + reach


@exact_kernel
def gaps_from_ball(placed: Rows, ball: Row, rounding: float, least: RowOut, most: RowOut) -> None:
    """Write the least and largest distance (n,) of primitives `PLACED` (n, 12) from places in a ball (4,) [m].

    A row of zeros is no primitive: its distances are unbounded. They are wider by `rounding`, of a metre and of each
    metre that places are from the origin.
    """
    middle_far = max(abs(ball[0]), abs(ball[1]), abs(ball[2]))
    for i in range(placed.shape[0]):
        row = placed[i]
        known = False
        for k in range(row.shape[0]):
            known = known or row[k] != 0.0
        if not known:
            least[i], most[i] = -math.inf, math.inf
            continue
        kind, radius = row[0], row[11]
        x, y, z, a, b, c = row[5], row[6], row[7], row[8], row[9], row[10]
        wider = rounding * (1.0 + max(abs(x), abs(y), abs(z)) + middle_far)
        if kind == HALF_SPACE:
            above = (ball[0] - x) * a + (ball[1] - y) * b + (ball[2] - z) * c
            least[i], most[i] = -math.inf, max(above + ball[3], 0.0) + wider
            continue
        apart = math.sqrt((x - ball[0]) ** 2 + (y - ball[1]) ** 2 + (z - ball[2]) ** 2)
        if kind == BOX:
            about, within = math.sqrt(a * a + b * b + c * c), min(a, b, c)
        elif kind == CAPSULE:
            about, within = c + radius, radius
        else:
            about, within = math.sqrt(c * c + radius * radius), min(c, radius)
        least[i] = apart - about - ball[3] - wider
        most[i] = max(apart - within + ball[3], 0.0) + wider


class _ObstaclesWithParts(NamedTuple):
    """Obstacles and their shapes."""

    obstacles: BatchObstacles
    parts: Parts


_scene_of = unpacked(numba_type(_ObstaclesWithParts))


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
    memory each other field of `BatchObstacles` and `Parts` is [bytes], vertices as if all were boxes. The memory, all
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
