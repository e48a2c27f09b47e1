"""Choose the triangles or points that can be the nearest to some place in a ball; drop those that can't.

Neighbours go together, in voxels; the ball is cut into cells. In a cell, the nearest point is no farther than a corner
in some voxel: voxels that are farther from the cell are dropped, and so are those that are farther than this corner
from each place in the cell. `scene/crop.py` crops obstacles with it: distances in the ball stay the same.
`VOXELS`, `COARSE` and `FINE`, each at least 1, trade time, and memory of `VOXELS`^3 numbers, for what is dropped.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.distance.triangle_distance import nearest_of
from guidefield.kernels.jit.arrays import Floats, IndexRows, IndicesOut, Integers, Row, Rows, RowsOut, TruthsOut
from guidefield.kernels.jit.decorators import inlined, inner_kernel, kernel


@kernel
def distance_to_triangles(x: float, y: float, z: float, vertices: Rows, triangles: IndexRows) -> float:
    """Return the distance of a point to the nearest of `triangles` (t, 3) of `vertices` (v, 3) [m].

    Each triangle has an area; without any the distance is infinite.
    """
    best, row = math.inf, np.empty((1, 9))
    for t in range(triangles.shape[0]):
        for k in range(3):
            a = vertices[triangles[t, 0], k]
            row[0, k], row[0, 3 + k], row[0, 6 + k] = (
                a,
                vertices[triangles[t, 1], k] - a,
                vertices[triangles[t, 2], k] - a,
            )
        best = nearest_of((x, y, z), row, 0, 1, best, 0)[0]
    return math.sqrt(best)


VOXELS = 64  # voxels along the longest side of what is within reach of the ball
COARSE, FINE = 8, 4  # cells along each axis of the box about the ball, and smaller ones along each axis of one of those
ROUNDING = 1e-9  # by how much distances are widened, of the largest length in the question: it may grow, not shrink


@inlined
def _box_of(vertices: Floats, corners: Integers, i: int, box_out: Floats) -> None:
    """Write the box about one of the parts: lower, then upper corner."""
    for k in range(3):
        box_out[k], box_out[3 + k] = math.inf, -math.inf
        for c in range(corners.shape[1]):
            x = vertices[corners[i, c], k]
            box_out[k] = min(box_out[k], x)
            box_out[3 + k] = max(box_out[3 + k], x)


@inlined
def _gap_squared(low: Floats, high: Floats, box: Floats) -> float:
    """Square of the distance of a box given by its corners from another one [m^2]."""
    square = 0.0
    for k in range(3):
        gap = max(box[k] - high[k], low[k] - box[3 + k], 0.0)
        square += gap * gap
    return square


@inlined
def _is_outside(low: Floats, high: Floats, centre: Floats, radius: float) -> bool:
    square = 0.0
    for k in range(3):
        gap = max(low[k] - centre[k], centre[k] - high[k], 0.0)
        square += gap * gap
    return square > radius * radius


@inlined
def _nearest(low: Floats, high: Floats, corners: Floats, some: Integers, count: int) -> int:
    """Index of the corner, of some of (m, 3), nearest to the middle of a cell."""
    best, nearest = math.inf, -1
    for at in range(count):
        square = 0.0
        for k in range(3):
            gap = 0.5 * (low[k] + high[k]) - corners[some[at], k]
            square += gap * gap
        if square < best:
            best, nearest = square, some[at]
    return nearest


@inlined
def _farthest(low: Floats, high: Floats, corner: Floats, slack: float) -> float:
    """Largest distance of a place in a cell from a corner (3,), or more [m]."""
    away = half = 0.0
    for k in range(3):
        away += (0.5 * (low[k] + high[k]) - corner[k]) ** 2
        half += 0.25 * (high[k] - low[k]) ** 2
    return math.sqrt(away) + math.sqrt(half) + slack


@inlined
def _is_beyond(low: Floats, high: Floats, corner: Floats, box: Floats, slack: float) -> bool:
    """Tell if a box is farther than a corner (3,) from each place in a cell.

    What squares of distances from a place x of the cell differ by, |x - q|^2 - |x - p|^2 for q in the box and the
    corner p, is linear in x. Its least over the cell, of middle c and half sides h, is the sum over the axes of (q -
    c)^2 - 2 h |q - p| - (p - c)^2, which is least at an end of the box, at p, or at c + h or c - h.
    """
    margin = 0.0
    for k in range(3):
        middle, half, p = 0.5 * (low[k] + high[k]), 0.5 * (high[k] - low[k]), corner[k]
        least = math.inf
        for place in (box[k], box[3 + k], p, middle + half, middle - half):
            q = min(max(place, box[k]), box[3 + k])
            least = min(least, (q - middle) ** 2 - 2.0 * half * abs(q - p))
        margin += least - (p - middle) ** 2
    return margin > slack


@inner_kernel
def _from_corners(vertices: Rows, corners: IndexRows, centre: Row) -> float:
    """Distance of a place from the nearest of some corners [m]."""
    least = math.inf
    for i in range(corners.shape[0]):
        square = 0.0
        for k in range(3):
            gap = vertices[corners[i, 0], k] - centre[k]
            square += gap * gap
        least = min(least, square)
    return math.sqrt(least)


@inner_kernel
def _voxels(
    vertices: Rows, corners: IndexRows, low: Row, high: Row, chosen: TruthsOut, voxel_out: IndicesOut
) -> tuple[RowsOut, RowsOut]:
    """Put the `chosen` parts (n,) together by their boxes' middles, all between the corners `low` and `high` (3,) [m].

    Returns of each voxel that holds any a box about all (m, 6), and a corner in it (m, 3); writes the voxel of each
    part.
    """
    n, box, sizes, count = corners.shape[0], np.empty(6), np.empty(3, np.int64), 0
    side = max(high[0] - low[0], high[1] - low[1], high[2] - low[2], 1e-9) / VOXELS
    for k in range(3):
        sizes[k] = int((high[k] - low[k]) / side) + 1
    places = np.full(sizes[0] * sizes[1] * sizes[2], -1, np.int64)
    for i in range(n):
        if not chosen[i]:
            continue
        _box_of(vertices, corners, i, box)
        at = 0
        for k in range(3):
            cell = int((0.5 * (box[k] + box[3 + k]) - low[k]) / side)
            at = at * sizes[k] + min(max(cell, 0), sizes[k] - 1)
        if places[at] < 0:
            places[at] = count
            count += 1
        voxel_out[i] = places[at]
    boxes, ends = np.empty((count, 6)), np.empty((count, 3))
    boxes[:, :3], boxes[:, 3:] = math.inf, -math.inf
    for i in range(n):
        if chosen[i]:
            _box_of(vertices, corners, i, box)
            m = voxel_out[i]
            for k in range(3):
                boxes[m, k], boxes[m, 3 + k] = min(boxes[m, k], box[k]), max(boxes[m, 3 + k], box[3 + k])
                ends[m, k] = vertices[corners[i, 0], k]
    return boxes, ends


@inner_kernel
def _find_needed(boxes: Rows, ends: Rows, centre: Row, radius: float, slack: float) -> TruthsOut:
    """Tell which voxels may hold what is nearest to a place in a ball, shape (m,), by what `_voxels` returns."""
    count = boxes.shape[0]
    needed, every, some = np.zeros(count, np.bool_), np.arange(count), np.empty(count, np.int64)
    coarse, fine = 2.0 * radius / COARSE, 2.0 * radius / (COARSE * FINE)
    low, high, a, b = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for cell in range(COARSE**3):
        for k in range(3):
            low[k] = centre[k] - radius + coarse * (cell // COARSE**k % COARSE) - slack
            high[k] = low[k] + coarse + 2.0 * slack
        if _is_outside(low, high, centre, radius):
            continue
        reach, found = _farthest(low, high, ends[_nearest(low, high, ends, every, count)], slack), 0
        for m in range(count):
            if _gap_squared(low, high, boxes[m]) <= reach * reach:
                some[found] = m
                found += 1
        for part in range(FINE**3):
            for k in range(3):
                a[k] = low[k] + fine * (part // FINE**k % FINE)
                b[k] = a[k] + fine + 2.0 * slack
            if _is_outside(a, b, centre, radius):
                continue
            nearest = ends[_nearest(a, b, ends, some, found)]
            reach = _farthest(a, b, nearest, slack)
            for at in range(found):
                box = boxes[some[at]]
                if needed[some[at]] or _gap_squared(a, b, box) > reach * reach:
                    continue
                needed[some[at]] = not _is_beyond(a, b, nearest, box, slack * reach)
    return needed


@kernel
def crop_to_ball(vertices: Rows, corners: IndexRows, centre: Row, radius: float, chosen_out: TruthsOut) -> None:
    """Choose the parts of a surface or cloud that may be the nearest of all to some place in a ball, shape (n,).

    `corners` (n, k) are the vertices of each part among `vertices` (v, 3) [m], three of a triangle, one of a point; n
    >= 1.
    """
    n, box, low, high = corners.shape[0], np.empty(6), np.full(3, math.inf), np.full(3, -math.inf)
    least = _from_corners(vertices, corners, centre)
    slack = ROUNDING * (1.0 + least + radius + abs(centre[0]) + abs(centre[1]) + abs(centre[2]))
    # what is nearest to a place in the ball is no farther from the centre than some corner and twice the radius
    within = least + 2.0 * radius + slack
    for i in range(n):
        _box_of(vertices, corners, i, box)
        chosen_out[i] = not _is_outside(box[:3], box[3:], centre, within)
        if chosen_out[i]:
            for k in range(3):
                low[k] = min(low[k], 0.5 * (box[k] + box[3 + k]))
                high[k] = max(high[k], 0.5 * (box[k] + box[3 + k]))
    voxel_of = np.empty(n, np.int64)
    boxes, ends = _voxels(vertices, corners, low, high, chosen_out, voxel_of)
    needed = _find_needed(boxes, ends, centre, radius, slack)
    for i in range(n):
        chosen_out[i] = chosen_out[i] and needed[voxel_of[i]]
