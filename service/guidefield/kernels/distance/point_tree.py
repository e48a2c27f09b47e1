# ruff: noqa: ARG001  numba calls typing and code generation with arguments that most have no use for
"""A cloud, balls of one radius about many points: a tree of boxes sixteen wide, a grid of distances, queries by both.

Points are in float32: distances are off by less than `BAND` of `kernels/collide/layout.py`. `scene/cloud.py` writes the
tables and keeps them alive, as kernels get their address; a cell of the grid is filled when first asked.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import boolean, float64, int64, types
from numba.extending import intrinsic

from guidefield.kernels.jit.arrays import INTEGER_POINTER, Floats32, Indices, Singles, SinglesOut, numba_type
from guidefield.kernels.jit.decorators import vector_part, vector_step
from guidefield.kernels.simd.packing import AROUND, BLOCK, point_at, pointed, points_at, unpacked
from guidefield.kernels.simd.vector import (
    ALL_LANES,
    LANES,
    Vector,
    below,
    f32x16,
    first_lane,
    largest_of,
    smallest_lane,
    splat,
)

NUMBERS = 12
"""Numbers of a cloud: middle of the grid's first cell (3), size of a cell, cells per length, box about the points (6),
radius."""

CELL, PER_LENGTH, LOW, HIGH, RADIUS = 3, 4, 5, 8, 11  # their places
NOWHERE = 1e30  # coordinate of points that fill up the last sixteen [m]


class BatchCloud(NamedTuple):
    """A cloud of balls, in the world [m]."""

    levels: int  # levels of boxes; the highest has one block of sixteen
    # columns, rows, layers: How many cells the grid has along x, y, z
    columns: int
    rows: int
    layers: int
    # (levels + 1,) where the blocks of each level begin in `boxes`, from level 1 on; level 1 has a box for each sixteen
    # points, each level above one for each block of the level below
    firsts: Indices
    points: Singles  # (BLOCK * blocks,) sixteen x, y, z each
    boxes: Singles  # (AROUND * blocks of all levels,)
    numbers: Singles  # (NUMBERS,)
    # (columns * rows * layers,) distances; 0 where none has been asked for yet; written by the kernels
    cells: SinglesOut


BATCH_CLOUD = numba_type(BatchCloud)
CLOUD_TABLES = pointed(BATCH_CLOUD)

cloud_of = unpacked(BATCH_CLOUD)  # makes a cloud of its words


@intrinsic
def words_at(typing: Any, address: Any) -> Any:
    """Words by their address, a whole number."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], context.get_value_type(INTEGER_POINTER))

    return INTEGER_POINTER(types.int64), generate


@intrinsic
def _only(typing: Any, mask: Any, value: Any, otherwise: Any) -> Any:
    """Return `value` in the lanes of a mask, `otherwise` in the others."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.trunc(args[0], ir.IntType(LANES))
        return builder.select(builder.bitcast(bits, ir.VectorType(ir.IntType(1), LANES)), args[1], args[2])

    return f32x16(types.int64, f32x16, f32x16), generate


@vector_part
def _box_gaps(boxes: Floats32, block: int, x: float, y: float, z: float) -> Vector:
    """Squares of the distances of a point to sixteen boxes [m^2]."""
    zero = splat(0.0)
    low_x, low_y, low_z = points_at(boxes, block * AROUND)
    high_x, high_y, high_z = points_at(boxes, block * AROUND + BLOCK)
    dx = largest_of(largest_of(low_x - x, x - high_x), zero)
    dy = largest_of(largest_of(low_y - y, y - high_y), zero)
    dz = largest_of(largest_of(low_z - z, z - high_z), zero)
    return dx * dx + dy * dy + dz * dz


@vector_part
def point_gaps(points: Floats32, block: int, x: float, y: float, z: float) -> Vector:
    """Return the squared distances of a point to the sixteen points of a block, (BLOCK * blocks,) [m^2]."""
    px, py, pz = points_at(points, block * BLOCK)
    dx, dy, dz = px - x, py - y, pz - z
    return dx * dx + dy * dy + dz * dz


@vector_step(int64(CLOUD_TABLES, int64, float64, float64, float64, float64))
def next_block(cloud: BatchCloud, after: int, x: float, y: float, z: float, reach: float) -> int:
    """Return the next sixteen points after some, -1 at first, with any within reach of a point [m].

    -1 if there are none.
    """
    square = splat(reach * reach)
    # sixteen bits for each level: boxes of the block that was entered there that have not been visited yet
    level, block, masks = cloud.levels, 0, 0
    if after < 0:
        masks = below(_box_gaps(cloud.boxes, cloud.firsts[level], x, y, z), square) << (16 * (level - 1))
    else:
        for above in range(1, cloud.levels + 1):
            here = after >> (4 * (above - 1))
            later = (ALL_LANES << 1) << (here & 15) & ALL_LANES
            if later:
                near = below(_box_gaps(cloud.boxes, cloud.firsts[above] + (here >> 4), x, y, z), square)
                masks |= (near & later) << (16 * (above - 1))
        level, block = 1, after >> 4
    while True:
        shift = 16 * (level - 1)
        mask = (masks >> shift) & ALL_LANES
        if mask == 0:
            if level == cloud.levels:
                return -1
            level += 1
            block >>= 4
            continue
        block = block * LANES + first_lane(mask)
        masks &= ~((mask & -mask) << shift)
        if level > 1:
            level -= 1
            masks |= below(_box_gaps(cloud.boxes, cloud.firsts[level] + block, x, y, z), square) << (shift - 16)
            continue
        if below(point_gaps(cloud.points, block, x, y, z), square):
            return int(block)
        block >>= 4


@vector_step(int64(CLOUD_TABLES, float64, float64, float64, float64))
def nearest_point(cloud: BatchCloud, x: float, y: float, z: float, cutoff: float) -> int:
    """The point of the cloud nearest to a point: where its x stands in `points`; -1 if none is nearer than a cutoff.

    Args:
        x: The point [m], with y and z.
        cutoff: Distance beyond which nothing is searched for [m]; at most 1e15.
    """
    best, far, found = cutoff * cutoff, splat(1e30), -1
    # sixteen bits for each level: boxes of the block that was entered there that have not been visited yet
    level, block, masks = cloud.levels, 0, ALL_LANES << (16 * (cloud.levels - 1))
    while True:
        shift = 16 * (level - 1)
        gaps = _only(masks >> shift, _box_gaps(cloud.boxes, cloud.firsts[level] + block, x, y, z), far)
        least = smallest_lane(gaps)
        if least >= best:
            masks &= ~(ALL_LANES << shift)
            if level == cloud.levels:
                return found
            level += 1
            block >>= 4
            continue
        chosen = first_lane(ALL_LANES & ~below(splat(least), gaps))
        masks &= ~(1 << (shift + chosen))
        child = block * LANES + chosen
        if level > 1:
            level, block = level - 1, child
            masks |= ALL_LANES << (shift - 16)
            continue
        gaps = point_gaps(cloud.points, child, x, y, z)
        least = smallest_lane(gaps)
        if least < best:
            best, found = least, child * BLOCK + first_lane(ALL_LANES & ~below(splat(least), gaps))


@vector_step(float64(CLOUD_TABLES, float64, float64, float64))
def nearest_distance(cloud: BatchCloud, x: float, y: float, z: float) -> float:
    """Return the distance of a point to the nearest of the cloud's [m]."""
    px, py, pz = point_at(cloud.points, nearest_point(cloud, x, y, z, 1e15))
    dx, dy, dz = x - px, y - py, z - pz
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@vector_step(boolean(CLOUD_TABLES, float64, float64, float64, float64))
def _beyond(cloud: BatchCloud, x: float, y: float, z: float, reach: float) -> bool:
    """Tell if a point is farther than a reach from all points of a cloud, by its cell of the grid."""
    n = cloud.numbers
    size, per = float(n[CELL]), float(n[PER_LENGTH])
    i = min(max(int((x - n[0]) * per + 0.5), 0), cloud.columns - 1)
    j = min(max(int((y - n[1]) * per + 0.5), 0), cloud.rows - 1)
    k = min(max(int((z - n[2]) * per + 0.5), 0), cloud.layers - 1)
    place = (i * cloud.rows + j) * cloud.layers + k
    u, v, w = i * size + n[0], j * size + n[1], k * size + n[2]
    known = float(cloud.cells[place])
    if known == 0.0:
        known = max(nearest_distance(cloud, u, v, w), 1e-20)
        cloud.cells[place] = np.float32(known)
    off = math.sqrt((x - u) * (x - u) + (y - v) * (y - v) + (z - w) * (z - w))
    return bool(known - off > reach + 1e-6)


@vector_step(boolean(int64, float64, float64, float64, float64))
def cloud_beyond(address: int, x: float, y: float, z: float, reach: float) -> bool:
    """Tell if a point in a cloud's frame is certain to be farther than a reach from all its balls [m]."""
    cloud = cloud_of(words_at(address))
    return bool(_beyond(cloud, x, y, z, reach + cloud.numbers[RADIUS]))


@vector_step(types.UniTuple(float64, 4)(int64, float64, float64, float64, float64))
def cloud_distance(address: int, x: float, y: float, z: float, cutoff: float) -> tuple[float, float, float, float]:
    """Return the signed distance of a point to the nearest ball of a cloud [m], and the vector along which it grows.

    The point is in the cloud's frame. Points are in float32, of which the nearest may be missed by another that is as
    near to a micrometre. Infinite and zero beyond the cutoff, which may be infinite or negative [m].
    """
    cloud = cloud_of(words_at(address))
    radius = float(cloud.numbers[RADIUS])
    reach = min(max(cutoff + radius, 0.0), 1e15)
    if _beyond(cloud, x, y, z, reach):
        return math.inf, 0.0, 0.0, 0.0
    at = nearest_point(cloud, x, y, z, reach)
    if at < 0:
        return math.inf, 0.0, 0.0, 0.0
    dx, dy, dz = x - cloud.points[at], y - cloud.points[at + 16], z - cloud.points[at + 32]
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if distance < 1e-12:
        return distance - radius, 0.0, 0.0, 1.0
    over = 1.0 / distance
    return distance - radius, over * dx, over * dy, over * dz
