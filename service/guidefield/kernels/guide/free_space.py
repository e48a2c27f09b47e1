"""Free space about the tip: a coarse path through a grid of points, and the free part of a plane about a point.

`planner/guide/auto_planes.py` lays guide planes along the path and makes them of the parts: they guide, they are no
motion of the robot, and nothing is proven by them. `CAP`, `_HASTE` and `_NEAR` change which planes are found,
`_HEAP_CAPACITY` only time.

The path is a weighted A*'s. It costs its length times 1 + (comfort / clearance)^2, clearance up to what is ample.
Points touch a ball of their own clearance: two neighbours are joined if their balls cover the path between them, so
that no wall is too thin. Of a plane rays go in all directions until they hit; between them obstacles may be missed.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.distance.distance import DistanceTables, bodies_near, nearest_body
from guidefield.kernels.jit.arrays import (
    Blocks,
    Floats,
    Indices,
    IndicesOut,
    Integers,
    Row,
    RowOut,
    Rows,
    RowsOut,
    SinglesOut,
)
from guidefield.kernels.jit.decorators import inlined, kernel
from guidefield.kernels.linalg.small_systems import write_stable_order

CAP = 0.25  # clearance beyond this doesn't count [m], at size 1: `auto_planes.py` tells mouths of passages by it, too

_HASTE = 1.1
"""But for what `arm` leaves out a path costs at most this many times the cheapest: the estimate is larger by it."""

_CHOSEN = -1.0  # cost of a point that is settled or out of bounds
_HEAP_CAPACITY = 1 << 14  # entries of the heap at first, at least 1


_NEAR = 0.0025  # a ray hits what is nearer than this, as a share of the longest; above 0, or it never ends


@inlined
def _clearance(x: float, y: float, z: float, tables: DistanceTables, cap: float, candidates: Integers) -> float:
    count = bodies_near(x, y, z, cap, tables, candidates)
    return min(nearest_body(x, y, z, candidates, count, tables, cap)[0], cap)


@inlined
def _distance(x: float, y: float, z: float, centre: Floats) -> float:
    return math.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2)


@inlined
def _push(heap: Floats, cells: Integers, size: int, cost: float, cell: int) -> None:
    i = size
    while i > 0:
        up = (i - 1) // 2
        if heap[up] <= cost:
            break
        heap[i], cells[i] = heap[up], cells[up]
        i = up
    heap[i], cells[i] = cost, cell


@inlined
def _pop(heap: Floats, cells: Integers, size: int) -> None:
    cost, cell = heap[size - 1], cells[size - 1]
    i, last = 0, size - 1
    while True:
        down = 2 * i + 1
        if down >= last:
            break
        if down + 1 < last and heap[down + 1] < heap[down]:
            down += 1
        if heap[down] >= cost:
            break
        heap[i], cells[i] = heap[down], cells[down]
        i = down
    heap[i], cells[i] = cost, cell


@inlined
def _free_at(
    there: int, x: float, y: float, z: float, tables: DistanceTables, centre: Floats, reach: float, cap: float,
    candidates: Integers, free_out: np.ndarray,
) -> float:  # fmt: skip
    """Clearance at a point of the grid, remembered; -1 beyond reach."""
    if math.isnan(free_out[there]):
        beyond = _distance(x, y, z, centre) > reach
        free_out[there] = -1.0 if beyond else _clearance(x, y, z, tables, cap, candidates)
    return float(free_out[there])


@inlined
def _neighbours(spacing: float) -> tuple[Integers, Floats]:
    """Steps to a point's 26 neighbours along the axes of the grid, and their lengths [m]."""
    offsets, lengths = np.empty((26, 3), np.int64), np.empty(26)
    for n in range(26):
        m = n if n < 13 else n + 1
        offsets[n, 0], offsets[n, 1], offsets[n, 2] = m // 9 - 1, (m // 3) % 3 - 1, m % 3 - 1
        lengths[n] = spacing * math.sqrt(offsets[n, 0] ** 2 + offsets[n, 1] ** 2 + offsets[n, 2] ** 2)
    return offsets, lengths


@inlined
def _trace_back(origin: Integers, last: int, path_out: Integers) -> int:
    """The points from the last back to the first, and how many they are."""
    n, cell = 0, last
    while cell >= 0 and n < path_out.shape[0]:
        path_out[n] = cell
        n += 1
        cell = origin[cell]
    return n


@kernel
def wavefront(
    tables: DistanceTables, low: Row, spacing: float, counts: Indices, start: Indices, goal: Indices,
    cap: float, comfort: float, ample: float, floor: float, centre: Row, reach: float, arm: float,
    free_out: SinglesOut, path_out: IndicesOut,
) -> int:  # fmt: skip
    """Find a cheap path over a grid between two of its points; return its count of points, 0 if there is none.

    Weighted A*: the estimate is the straight path at its best, times `_HASTE` (I. Pohl, Heuristic search viewed as path
    finding in a graph, 1970). The grid has its lower corner at `low` (3,), `counts` (3,) points along axes, `spacing`
    apart [m]; start and goal are indices (3,). Clearance beyond `cap` doesn't count; at `comfort` a path costs twice
    its length; more than `ample`, at most the cap, makes none cheaper; points nearer than `floor` to an obstacle, or
    farther than `reach` from `centre` (3,), are out of bounds [m]. An arm from the centre that lies along the path,
    from the point of it that suits best, is no longer than `arm`, as far as the cheapest paths to its points tell [m].
    `free_out` has the clearance of each point where it is known, else NaN, -1 beyond reach; what is found is added.
    `path_out` gets flat indices, from the goal back to the start.
    """
    nx, ny, nz = counts[0], counts[1], counts[2]
    cost = np.full(nx * ny * nz, np.inf, np.float32)  # negative where it is settled, or never will be
    origin, along = np.full(cost.shape[0], -1, np.int32), np.empty(cost.shape[0], np.float32)
    candidates = np.empty(tables.kinds.shape[0], np.int64)
    heap, cells = np.empty(_HEAP_CAPACITY), np.empty(_HEAP_CAPACITY, np.int64)
    offsets, steps = _neighbours(spacing)
    least = _HASTE * spacing * (1.0 + (comfort / ample) ** 2)
    first = (start[0] * ny + start[1]) * nz + start[2]
    last = (goal[0] * ny + goal[1]) * nz + goal[2]
    cost[first], size = 0.0, 1
    x, y, z = low[0] + spacing * start[0], low[1] + spacing * start[1], low[2] + spacing * start[2]
    _free_at(first, x, y, z, tables, centre, math.inf, cap, candidates, free_out)
    along[first] = _distance(x, y, z, centre)
    heap[0], cells[0] = 0.0, first
    while size > 0:
        cell = cells[0]
        _pop(heap, cells, size)
        size -= 1
        here = float(cost[cell])
        if here < 0.0:
            continue
        cost[cell] = _CHOSEN
        if cell == last:
            return _trace_back(origin, last, path_out)
        roomy = min(float(free_out[cell]), ample)
        at_best = 1.0 + (2.0 * comfort / (ample + roomy)) ** 2
        k, j, i = cell % nz, (cell // nz) % ny, cell // (nz * ny)
        for n in range(offsets.shape[0]):
            a, b, c = i + offsets[n, 0], j + offsets[n, 1], k + offsets[n, 2]
            if a < 0 or a >= nx or b < 0 or b >= ny or c < 0 or c >= nz:
                continue
            there, step = (a * ny + b) * nz + c, steps[n]
            if here + step * at_best >= cost[there]:
                continue
            x, y, z = low[0] + spacing * a, low[1] + spacing * b, low[2] + spacing * c
            clear = _free_at(there, x, y, z, tables, centre, reach, cap, candidates, free_out)
            if clear <= floor:
                cost[there] = _CHOSEN
                continue
            new = here + step * (1.0 + (2.0 * comfort / (min(clear, ample) + roomy)) ** 2)
            if clear + free_out[cell] <= step or new >= cost[there]:
                continue
            away = math.sqrt((a - goal[0]) ** 2 + (b - goal[1]) ** 2 + (c - goal[2]) ** 2)
            needed = min(_distance(x, y, z, centre), along[cell] + step)
            if needed + spacing * away > arm:
                continue
            cost[there], origin[there], along[there] = new, cell, needed
            if size == heap.shape[0]:
                heap, cells = np.concatenate((heap, heap)), np.concatenate((cells, cells))
            _push(heap, cells, size, new + least * away, there)
            size += 1
    return 0


@inlined
def _ray_length(
    tables: DistanceTables, centre: Floats, u: Floats, v: Floats, angle: float, longest: float, candidates: Integers,
    count: int,
) -> float:  # fmt: skip
    """Return the length of a ray in a plane before it hits one of some obstacles [m]."""
    c, s = math.cos(angle), math.sin(angle)
    dx, dy, dz = c * u[0] + s * v[0], c * u[1] + s * v[1], c * u[2] + s * v[2]
    t = 0.0
    while t < longest:
        x, y, z = centre[0] + t * dx, centre[1] + t * dy, centre[2] + t * dz
        free = nearest_body(x, y, z, candidates, count, tables, longest)[0]
        if free < _NEAR * longest:
            return t
        t += free
    return longest


@inlined
def _ray_lengths(
    tables: DistanceTables, centre: Floats, u: Floats, v: Floats, longest: float, candidates: Integers, lengths: Floats
) -> None:
    """Write the lengths of evenly spread rays in a plane before they hit an obstacle [m]."""
    count = bodies_near(centre[0], centre[1], centre[2], longest, tables, candidates)  # nothing else can be hit
    rays = lengths.shape[0]
    for k in range(rays):
        lengths[k] = _ray_length(tables, centre, u, v, 2.0 * math.pi * k / rays, longest, candidates, count)


@kernel
def is_enclosed(tables: DistanceTables, centre: Row, axes: Blocks, longest: float, rays: int) -> bool:
    """Tell if in one of some planes through a point (3,) each of `rays` rays hits an obstacle within `longest` [m].

    `axes` (n, 2, 3) are two unit vectors of each plane, across each other.
    """
    candidates = np.empty(tables.kinds.shape[0], np.int64)
    count = bodies_near(centre[0], centre[1], centre[2], longest, tables, candidates)
    for i in range(axes.shape[0]):
        k = 0
        while k < rays:
            angle = 2.0 * math.pi * k / rays
            if _ray_length(tables, centre, axes[i, 0], axes[i, 1], angle, longest, candidates, count) >= longest:
                break
            k += 1
        if k == rays:
            return True
    return False


@kernel
def open_areas(
    tables: DistanceTables, centres: Rows, axes: Blocks, longest: float, rays: int, areas_out: RowOut
) -> None:
    """Write how much (n,) of planes about points (n, 3) is seen from there by rays no longer than `longest` [m^2].

    `axes` (n, 2, 3) are two unit vectors of each plane, across each other.
    """
    candidates, lengths = np.empty(tables.kinds.shape[0], np.int64), np.empty(rays)
    for i in range(centres.shape[0]):
        _ray_lengths(tables, centres[i], axes[i, 0], axes[i, 1], longest, candidates, lengths)
        total = 0.0
        for k in range(rays):
            total += lengths[k - 1] * lengths[k]
        areas_out[i] = 0.5 * math.sin(2.0 * math.pi / rays) * total


@inlined
def _cut(corners: Floats, count: int, nx: float, ny: float, offset: float, cut: Floats) -> int:
    """Cut a convex polygon by a half-plane ``n . x <= offset`` that reaches into it; return its count of corners."""
    kept = 0
    bx, by = corners[count - 1, 0], corners[count - 1, 1]
    before = nx * bx + ny * by - offset
    for k in range(count):
        x, y = corners[k, 0], corners[k, 1]
        here = nx * x + ny * y - offset
        if before * here < 0.0:
            share = before / (before - here)
            cut[kept, 0], cut[kept, 1] = bx + share * (x - bx), by + share * (y - by)
            kept += 1
        if here <= 0.0:
            cut[kept, 0], cut[kept, 1] = x, y
            kept += 1
        bx, by, before = x, y, here
    for k in range(kept):
        corners[k, 0], corners[k, 1] = cut[k, 0], cut[k, 1]
    return kept


@kernel
def free_section(tables: DistanceTables, centre: Row, axes: Rows, longest: float, corners_out: RowsOut) -> int:
    """Cut a convex polygon about a point (3,) that is free as far as rays tell: what all their hits leave.

    Returns the count of corners, which are in the plane's unit vectors `axes` (2, 3), counter-clockwise [m];
    `corners_out` (2 rays, 2); no ray exceeds `longest` [m].
    """
    rays = corners_out.shape[0] // 2
    candidates, lengths = np.empty(tables.kinds.shape[0], np.int64), np.empty(rays)
    cut = np.empty((2 * rays, 2))
    _ray_lengths(tables, centre, axes[0], axes[1], longest, candidates, lengths)
    for k in range(rays):
        angle = 2.0 * math.pi * k / rays
        corners_out[k, 0], corners_out[k, 1] = longest * math.cos(angle), longest * math.sin(angle)
    count = rays
    order = np.empty(rays, np.int64)
    write_stable_order(lengths, order)
    for k in order:
        if lengths[k] < longest:
            angle = 2.0 * math.pi * k / rays
            count = _cut(corners_out, count, math.cos(angle), math.sin(angle), lengths[k], cut)
    return int(count)
