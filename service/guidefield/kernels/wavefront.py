"""The tip's coarse way through a scene: a wavefront over a grid of points, along which clearance counts; and rays.

A way costs its length times 1 + (comfort / clearance)^2. Points touch a ball of their own clearance: two neighbours are
joined if their balls cover the way between them, so that no wall is too thin to stop the wave.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types, void

from guidefield.kernels.distance import INDICES_OUT, TABLES, DistanceTables, bodies_near, nearest_body
from guidefield.kernels.signatures import SCALAR, VECTOR, VECTOR_OUT, Floats, compiled, inlined
from guidefield.kernels.tree_kinematics import INDICES, Integers

CAP = 0.25
"""Clearance beyond this doesn't count [m]."""

_NEAR = 1e-3
"""A ray hits what is nearer than this [m]."""


CLEARANCES = types.Array(types.float32, 1, "C")


@inlined
def _clearance(x: float, y: float, z: float, tables: DistanceTables, cap: float, candidates: Integers) -> float:
    """Distance to the nearest obstacle, at most `cap`."""
    count = bodies_near(x, y, z, cap, tables, candidates)
    return min(nearest_body(x, y, z, candidates, count, tables, cap)[0], cap)


@compiled(void(TABLES, VECTOR, VECTOR, VECTOR, SCALAR, VECTOR_OUT))
def ray_lengths(
    tables: DistanceTables, centre: Floats, u: Floats, v: Floats, longest: float, lengths_out: Floats
) -> None:
    """How far rays in a plane get before they hit an obstacle [m].

    Args:
        tables: The obstacles.
        centre: Where they start, shape (3,) [m].
        u: Unit vector of the plane, shape (3,): the first ray.
        v: The unit vector of the plane across it.
        longest: No ray is followed farther [m].
        lengths_out: One for each ray, evenly spread.
    """
    candidates = np.empty(tables.kinds.shape[0], np.int64)
    rays = lengths_out.shape[0]
    for k in range(rays):
        angle = 2.0 * math.pi * k / rays
        c, s = math.cos(angle), math.sin(angle)
        dx, dy, dz = c * u[0] + s * v[0], c * u[1] + s * v[1], c * u[2] + s * v[2]
        t = 0.0
        while t < longest:
            free = _clearance(centre[0] + t * dx, centre[1] + t * dy, centre[2] + t * dz, tables, longest, candidates)
            if free < _NEAR:
                break
            t += free
        lengths_out[k] = min(t, longest)


@inlined
def _push(heap: Floats, cells: Integers, size: int, cost: float, cell: int) -> None:
    """Put an entry into a binary heap of `size` entries."""
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
    """Take the first entry out of a binary heap of `size` entries."""
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
    there: int, x: float, y: float, z: float, tables: DistanceTables, centre: Floats, reach: float,
    candidates: Integers, free_out: np.ndarray,
) -> float:  # fmt: skip
    """Clearance at a point of the grid, remembered; -1 beyond reach."""
    if math.isnan(free_out[there]):
        beyond = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2 > reach * reach
        free_out[there] = -1.0 if beyond else _clearance(x, y, z, tables, CAP, candidates)
    return float(free_out[there])


@inlined
def _way_back(origin: Integers, last: int, way_out: Integers) -> int:
    """The points from the last back to the first, and how many they are."""
    n, cell = 0, last
    while cell >= 0 and n < way_out.shape[0]:
        way_out[n] = cell
        n += 1
        cell = origin[cell]
    return n


@compiled(
    types.int64(
        *(TABLES, VECTOR, SCALAR, INDICES, INDICES, INDICES, SCALAR, SCALAR, VECTOR, SCALAR, CLEARANCES, INDICES_OUT)
    )
)
def wavefront(
    tables: DistanceTables, low: Floats, spacing: float, counts: Integers, start: Integers, goal: Integers,
    comfort: float, floor: float, centre: Floats, reach: float, free_out: np.ndarray, way_out: Integers,
) -> int:  # fmt: skip
    """The cheapest way over a grid between two of its points (A*, the straight way at its best is the estimate).

    Args:
        tables: The obstacles.
        low: Lower corner of the grid, shape (3,) [m].
        spacing: Between neighbours [m].
        counts: Points along each axis, shape (3,).
        start: Indices of the first point, shape (3,).
        goal: Indices of the last, shape (3,).
        comfort: Clearance at which a way costs twice its length [m].
        floor: Points nearer to an obstacle are out of bounds [m].
        centre: Points farther than `reach` from here are out of bounds, shape (3,) [m].
        reach: See `centre` [m]; may be infinite.
        free_out: Clearance of each point where it is known [m], else NaN; -1 beyond reach. What is found out is added.
        way_out: Gets flat indices of the way's points, from the goal back to the start.

    Returns:
        How many points the way has; 0 if there is none.
    """
    nx, ny, nz = counts[0], counts[1], counts[2]
    total = nx * ny * nz
    cost = np.full(total, np.inf, np.float32)
    free = free_out
    origin = np.full(total, -1, np.int32)
    done = np.zeros(total, np.bool_)
    candidates = np.empty(tables.kinds.shape[0], np.int64)
    room = 1 << 14
    heap, cells = np.empty(room), np.empty(room, np.int64)
    least = 1.0 + (comfort / CAP) ** 2
    first = (start[0] * ny + start[1]) * nz + start[2]
    last = (goal[0] * ny + goal[1]) * nz + goal[2]
    cost[first], size = 0.0, 1
    x, y, z = low[0] + spacing * start[0], low[1] + spacing * start[1], low[2] + spacing * start[2]
    _free_at(first, x, y, z, tables, centre, math.inf, candidates, free)
    heap[0], cells[0] = 0.0, first
    while size > 0:
        cell = cells[0]
        _pop(heap, cells, size)
        size -= 1
        if done[cell]:
            continue
        done[cell] = True
        if cell == last:
            break
        k, j, i = cell % nz, (cell // nz) % ny, cell // (nz * ny)
        for a in range(max(i - 1, 0), min(i + 2, nx)):
            for b in range(max(j - 1, 0), min(j + 2, ny)):
                for c in range(max(k - 1, 0), min(k + 2, nz)):
                    there = (a * ny + b) * nz + c
                    if done[there]:
                        continue
                    x, y, z = low[0] + spacing * a, low[1] + spacing * b, low[2] + spacing * c
                    clear = _free_at(there, x, y, z, tables, centre, reach, candidates, free)
                    step = spacing * math.sqrt((a - i) ** 2 + (b - j) ** 2 + (c - k) ** 2)
                    new = cost[cell] + step * (1.0 + (2.0 * comfort / (clear + free[cell])) ** 2)
                    if clear <= floor or clear + free[cell] <= step or new >= cost[there]:
                        continue
                    cost[there], origin[there] = new, cell
                    away = math.sqrt((a - goal[0]) ** 2 + (b - goal[1]) ** 2 + (c - goal[2]) ** 2)
                    if size == room:
                        heap, cells = np.concatenate((heap, heap)), np.concatenate((cells, cells))
                        room *= 2
                    _push(heap, cells, size, new + least * spacing * away, there)
                    size += 1
    return _way_back(origin, last, way_out) if done[last] else 0
