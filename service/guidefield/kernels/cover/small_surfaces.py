"""Many small surfaces at once: axes in which each is thin, and its rows for the distance kernels.

Also Morton order of points, and numbers of edges with how often they are run through. A surface's tree is that of
`geometry/distance_bodies.py` `node_count`: nodes and rows have to be laid out alike there and in `kernels/distance`.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.distance.bvh import boxes_of_pairs, middles_within
from guidefield.kernels.distance.triangle_distance import LEAF
from guidefield.kernels.distance.triangle_rows import corners_and_edges, summed_normals, triangle_boxes
from guidefield.kernels.jit.arrays import (
    BlocksOut,
    Floats,
    IndexRows,
    IndexRowsOut,
    Indices,
    IndicesOut,
    Integers,
    Row,
    Rows,
    RowsOut,
)
from guidefield.kernels.jit.decorators import exact_kernel, inlined, kernel, lane_part
from guidefield.kernels.linalg.small_systems import write_stable_order


@lane_part
def _spread_bits(cell: int) -> int:
    cell = (cell | cell << 32) & 0x001F00000000FFFF
    cell = (cell | cell << 16) & 0x001F0000FF0000FF
    cell = (cell | cell << 8) & 0x100F00F00F00F00F
    cell = (cell | cell << 4) & 0x10C30C30C30C30C3
    return (cell | cell << 2) & 0x1249249249249249


@exact_kernel
def curve_places(points: Rows, least: Row, size: float, most: int, places: IndicesOut) -> None:
    """Write the places of `points` (n, 3) along the Morton curve: the bits of their coordinates' cells in turn, (n,).

    The cube has its least corner at `least` (3,) and the side `size`; `most` is the last cell along a side, below 2^21.
    """
    for i in range(points.shape[0]):
        x = int((points[i, 0] - least[0]) / size * most)
        y = int((points[i, 1] - least[1]) / size * most)
        z = int((points[i, 2] - least[2]) / size * most)
        places[i] = _spread_bits(x) | _spread_bits(y) << 1 | _spread_bits(z) << 2


@exact_kernel
def changed_order(
    order: Indices,
    places: Indices,
    now: Indices,
    fresh: Indices,
    fresh_places: Indices,
    order_out: IndicesOut,
    places_out: IndicesOut,
    runs_out: IndexRowsOut,
) -> int:
    """Merge the points that are left of an order with `fresh` ones (k,); those of one place go by their numbers.

    `order` and `places` (m,) are those before, `now` has the number that each has now, -1 of those that are gone; those
    left keep their order. Writes the order and its places (n,), and in `runs_out` (r, 2) where runs that stand as
    before began and their lengths, -1 and the length of runs of fresh ones. Returns the number of runs.
    """
    at = others = runs = 0
    last = -2  # where in the order the last one stood, -1 of another
    for i in range(order.shape[0] + 1):
        end = i == order.shape[0]
        point = -1 if end else now[order[i]]
        if point < 0 and not end:
            continue
        while others < fresh.shape[0] and (
            end or fresh_places[others] < places[i] or (fresh_places[others] == places[i] and fresh[others] < point)
        ):
            order_out[at], places_out[at] = fresh[others], fresh_places[others]
            if last == -1:
                runs_out[runs - 1, 1] += 1
            else:
                runs_out[runs, 0], runs_out[runs, 1] = -1, 1
                runs += 1
            last = -1
            at, others = at + 1, others + 1
        if end:
            break
        order_out[at], places_out[at] = point, places[i]
        if last >= 0 and last == i - 1:
            runs_out[runs - 1, 1] += 1
        else:
            runs_out[runs, 0], runs_out[runs, 1] = i, 1
            runs += 1
        last = i
        at += 1
    return runs


FEW = 32  # this many numbers are sorted by insertion; a vertex of a surface seldom has more edges


@inlined
def _insert(keys: Integers, members: Integers, begin: int, end: int) -> None:
    for i in range(begin + 1, end):
        key, member, j = keys[i], members[i], i
        while j > begin and keys[j - 1] > key:
            keys[j], members[j] = keys[j - 1], members[j - 1]
            j -= 1
        keys[j], members[j] = key, member


@kernel
def number_edges(triangles: IndexRows, vertices: int, numbers_out: IndicesOut) -> int:
    """Number the edges of `triangles` (t, 3) by their lower vertex, then by the other one; return their count.

    `numbers_out` (3 t,) gets the numbers of each triangle's edges ab, bc, ca.
    """
    sides = 3 * triangles.shape[0]
    starts = np.zeros(vertices + 1, np.int64)
    for side in range(sides):
        a, b = triangles[side // 3, side % 3], triangles[side // 3, (side + 1) % 3]
        starts[min(a, b) + 1] += 1
    for vertex in range(vertices):
        starts[vertex + 1] += starts[vertex]
    others, members, ends = np.empty(sides, np.int64), np.empty(sides, np.int64), starts[:-1].copy()
    for side in range(sides):
        a, b = triangles[side // 3, side % 3], triangles[side // 3, (side + 1) % 3]
        low, at = min(a, b), ends[min(a, b)]
        others[at], members[at] = max(a, b), side
        ends[low] = at + 1
    count = 0
    for vertex in range(vertices):
        begin, end = starts[vertex], starts[vertex + 1]
        if end - begin <= FEW:
            _insert(others, members, begin, end)
        else:
            keys, sides_of, order = others[begin:end].copy(), members[begin:end].copy(), np.empty(end - begin, np.int64)
            write_stable_order(keys, order)
            for k in range(end - begin):
                others[begin + k], members[begin + k] = keys[order[k]], sides_of[order[k]]
        for at in range(begin, end):
            if at > begin and others[at] != others[at - 1]:
                count += 1
            numbers_out[members[at]] = count
        if end > begin:
            count += 1
    return count


@kernel
def count_ways(triangles: IndexRows, numbers: Indices, up_out: IndicesOut, down_out: IndicesOut) -> None:
    """Count how often edges are run through upwards, and downwards; all zero before, shape (edges,).

    `triangles` (t, 3) and the `numbers` (3 t,) of their edges are as in `number_edges`; upwards is from the lower
    vertex to the other one.
    """
    for side in range(numbers.shape[0]):
        if triangles[side // 3, side % 3] < triangles[side // 3, (side + 1) % 3]:
            up_out[numbers[side]] += 1
        else:
            down_out[numbers[side]] += 1


FLAT = 1e-9  # share of its size within which a surface is flat
FINEST = 21  # bits of one coordinate of a place on the Morton curve, as in `geometry/curve_order.py`: three fit into 63


@inlined
def _order(boxes: Floats, count: int, places: Integers, order: Integers) -> None:
    """Find the order of boxes along the Morton curve through the cube about their middles, as `curve_order` has it."""
    within, middles = np.empty(6), np.empty((count, 3))
    middles_within(boxes, within)
    size = max(within[3] - within[0], within[4] - within[1], within[5] - within[2], 1e-300)
    for i in range(count):
        for k in range(3):
            middles[i, k] = 0.5 * (boxes[i, k] + boxes[i, 3 + k])
    curve_places(middles, within[:3], size, 2**FINEST - 1, places)
    for i in range(count):  # by insertion, which keeps those of the same place in their order
        j = i
        while j > 0 and places[order[j - 1]] > places[i]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i


@kernel
def small_surfaces(
    vertices: Rows,
    triangles: IndexRows,
    starts: IndexRows,
    bounds_out: RowsOut,
    nodes_out: RowsOut,
    corners_out: RowsOut,
    normals_out: RowsOut,
) -> None:
    """Write the rows of surfaces of few triangles, all of which have an area, as `SurfaceTables` has them.

    Vertices (v, 3) [m] stand surface by surface, triangles (t, 3) index those of their own one; `starts` (n + 1, 3) has
    the first vertex, triangle and node of each, then the numbers of all. Writes boxes (n, 6), nodes (m, 6), corners (t,
    9), normals (t, 21).
    """
    for surface in range(starts.shape[0] - 1):
        own = vertices[starts[surface, 0] : starts[surface + 1, 0]]
        begin, end = starts[surface, 1], starts[surface + 1, 1]
        some, count = triangles[begin:end], end - begin
        boxes, ordered = np.empty((count, 6)), np.empty((count, 6))
        places, order, edges = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(3 * count, np.int64)
        triangle_boxes(own, some, boxes)
        _order(boxes, count, places, order)
        for row in range(count):
            ordered[row] = boxes[order[row]]
        nodes = nodes_out[starts[surface, 2] : starts[surface + 1, 2]]
        boxes_of_pairs(ordered, LEAF, nodes)
        bounds_out[surface] = nodes[0]
        corners_and_edges(own, some, order, corners_out[begin:end])
        n_edges = number_edges(some, own.shape[0], edges)
        summed_normals(own, some, edges, n_edges, order, normals_out[begin:end])


@inlined
def _squared(vertices: Floats, a: int, b: int) -> float:
    square = 0.0
    for k in range(3):
        square += (vertices[b, k] - vertices[a, k]) ** 2
    return square


@inlined
def _reach(vertices: Floats, triangles: Integers, first: int, begin: int, end: int, along: Floats) -> float:
    """Extent of some triangles along a direction, shape (3,) [m]."""
    low, high = math.inf, -math.inf
    for t in range(begin, end):
        for corner in range(3):
            vertex = first + triangles[t, corner]
            at = vertices[vertex, 0] * along[0] + vertices[vertex, 1] * along[1] + vertices[vertex, 2] * along[2]
            low, high = min(low, at), max(high, at)
    return high - low


@inlined
def _area(vertices: Floats, triangles: Integers, first: int, begin: int, end: int, area: Floats) -> float:
    """Write twice the area vector of some triangles, shape (3,) [m^2]; return the square of the longest side [m^2]."""
    longest = 0.0
    area[:] = 0.0
    for t in range(begin, end):
        a, b, c = first + triangles[t, 0], first + triangles[t, 1], first + triangles[t, 2]
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            to = (vertices[b, i] - vertices[a, i]) * (vertices[c, j] - vertices[a, j])
            area[k] += to - (vertices[b, j] - vertices[a, j]) * (vertices[c, i] - vertices[a, i])
        longest = max(longest, _squared(vertices, a, b), _squared(vertices, b, c), _squared(vertices, c, a))
    return longest


@inlined
def _to_side(vertices: Floats, a: int, b: int, normal: Floats, along: Floats, beside: Floats) -> None:
    """Write the direction from one vertex to another across a normal, and the one beside it, shapes (3,)."""
    across = length = 0.0
    for k in range(3):
        across += (vertices[b, k] - vertices[a, k]) * normal[k]
    for k in range(3):
        along[k] = vertices[b, k] - vertices[a, k] - across * normal[k]
        length += along[k] ** 2
    for k in range(3):
        along[k] /= math.sqrt(length)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        beside[k] = normal[i] * along[j] - normal[j] * along[i]


@kernel
def flat_frames(vertices: Rows, triangles: IndexRows, starts: IndexRows, axes_out: BlocksOut) -> None:
    """Find axes (n, 3, 3), as columns, in which the box about each surface is thin if that is flat; else unit axes.

    Surfaces are as in `small_surfaces`; the last axis is across a flat one.
    """
    normal, along, beside, unit = np.empty(3), np.empty(3), np.empty(3), np.eye(3)
    for surface in range(starts.shape[0] - 1):
        first, begin, end = starts[surface, 0], starts[surface, 1], starts[surface + 1, 1]
        axes, extent = axes_out[surface], 0.0
        for k in range(3):
            axes[k] = unit[k]
            extent = max(extent, _reach(vertices, triangles, first, begin, end, unit[k]))
        longest = _area(vertices, triangles, first, begin, end, normal)
        size = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        if size == 0.0:
            continue
        for k in range(3):
            normal[k] /= size
        if _reach(vertices, triangles, first, begin, end, normal) > FLAT * extent:
            continue
        smallest = math.inf
        for way in range(3):
            for t in range(begin, end):
                a, b = first + triangles[t, way], first + triangles[t, (way + 1) % 3]
                if _squared(vertices, a, b) <= FLAT**2 * longest:
                    continue
                _to_side(vertices, a, b, normal, along, beside)
                box = _reach(vertices, triangles, first, begin, end, along)
                box *= _reach(vertices, triangles, first, begin, end, beside)
                if box < smallest:
                    smallest = box
                    for k in range(3):
                        axes[k, 0], axes[k, 1], axes[k, 2] = along[k], beside[k], normal[k]
