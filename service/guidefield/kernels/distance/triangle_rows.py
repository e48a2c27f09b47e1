"""Rows of triangles for the distance kernels: boxes, corners, numbered edges, pseudonormals, trees of small surfaces.

Columns are those of `triangle_distance.SurfaceTables`. The tree of a small surface is that of
`geometry/distance_bodies.py` `node_count`: nodes and rows have to be laid out alike there. `FEW` is a matter of speed,
`FLAT` chooses the axes of boxes, which hold their surface in any. With a larger `NOTHING` thin triangles lose their
normals, which decide the signs of distances.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.distance.bvh import boxes_of_pairs, curve_places, middles_within
from guidefield.kernels.distance.triangle_distance import LEAF
from guidefield.kernels.jit.arrays import (
    BlocksOut,
    Floats,
    IndexRows,
    IndexRows32,
    Indices,
    IndicesOut,
    Integers,
    Rows,
    RowsOut,
    TruthsOut,
)
from guidefield.kernels.jit.decorators import exact_kernel, inlined, inner_kernel, kernel
from guidefield.kernels.linalg.small_systems import write_stable_order

NOTHING = 1e-14  # vectors shorter than this share of the longest are 0; more takes small faces' normals, insides' signs
SHORTEST = 1e-300  # longest vectors shorter than this are none

FEW = 32  # this many numbers are sorted by insertion, for speed only; a vertex of a surface seldom has more edges

FLAT = 1e-9  # share of its size within which a surface is flat: it chooses axes of boxes, which is time and last bits
FINEST = 21  # bits of one coordinate of a place on the Morton curve, as in `geometry/curve_order.py`: three fit into 63


@inner_kernel
def _to_unit(vectors: RowsOut) -> None:
    """Scale vectors, shape (n, 3), to length 1; those that are rounding to zero."""
    most = 0.0
    for i in range(vectors.shape[0]):
        most = max(most, vectors[i, 0] ** 2 + vectors[i, 1] ** 2 + vectors[i, 2] ** 2)
    least = NOTHING * max(math.sqrt(most), SHORTEST)
    for i in range(vectors.shape[0]):
        length = math.sqrt(vectors[i, 0] ** 2 + vectors[i, 1] ** 2 + vectors[i, 2] ** 2)
        for k in range(3):
            vectors[i, k] = vectors[i, k] / length if length > least else 0.0


@inlined
def _side(vertices: Floats, triangles: Integers, t: int, corner: int, k: int) -> float:
    """Along an axis, the side of a triangle that leaves a corner."""
    return float(vertices[triangles[t, (corner + 1) % 3], k] - vertices[triangles[t, corner], k])


@inlined
def _angle(sides: Floats, corner: int) -> float:
    """The angle at a triangle's corner, of unit sides, shape (3, 3): the one that leaves it and the one that comes."""
    leaving, coming = corner, (corner + 2) % 3
    x = sides[leaving, 1] * sides[coming, 2] - sides[leaving, 2] * sides[coming, 1]
    y = sides[leaving, 2] * sides[coming, 0] - sides[leaving, 0] * sides[coming, 2]
    z = sides[leaving, 0] * sides[coming, 1] - sides[leaving, 1] * sides[coming, 0]
    along = 0.0
    for k in range(3):
        along += sides[leaving, k] * sides[coming, k]
    return math.atan2(math.sqrt(x * x + y * y + z * z), -along)


@inner_kernel
def _faces(vertices: Rows, triangles: IndexRows, faces_out: RowsOut) -> float:
    """Write a normal of each triangle, not of unit length, shape (t, 3); the longest side [m]."""
    longest = 0.0
    for t in range(triangles.shape[0]):
        for corner in range(3):
            square = 0.0
            for k in range(3):
                square += _side(vertices, triangles, t, corner, k) ** 2
            longest = max(longest, square)
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            to = _side(vertices, triangles, t, 0, j) * _side(vertices, triangles, t, 2, i)
            faces_out[t, k] = to - _side(vertices, triangles, t, 0, i) * _side(vertices, triangles, t, 2, j)
    return math.sqrt(longest)


@kernel
def summed_normals(
    vertices: Rows, triangles: IndexRows, edges: Indices, n_edges: int, order: Indices, normals_out: RowsOut
) -> None:
    """Write unit pseudonormals (n, 21) of triangles (t, 3): of the face, of edges ab, bc, ca, of corners a, b, c.

    Vertices (v, 3) [m]; `edges` (3 t,) numbers the three of each triangle, `order` (n,) has those that are written.
    """
    faces, sides = np.empty((triangles.shape[0], 3)), np.empty((3, 3))
    least = NOTHING * max(_faces(vertices, triangles, faces), SHORTEST)
    _to_unit(faces)
    of_edges, of_corners = np.zeros((n_edges, 3)), np.zeros((vertices.shape[0], 3))
    for t in range(triangles.shape[0]):
        for corner in range(3):
            square = 0.0
            for k in range(3):
                sides[corner, k] = _side(vertices, triangles, t, corner, k)
                square += sides[corner, k] ** 2
            length = math.sqrt(square)
            for k in range(3):
                sides[corner, k] = sides[corner, k] / length if length > least else 0.0
        for part in range(3):
            edge, corner, angle = edges[3 * t + part], triangles[t, part], _angle(sides, part)
            for k in range(3):
                of_edges[edge, k] += faces[t, k]
                of_corners[corner, k] += angle * faces[t, k]
    _to_unit(of_edges)
    _to_unit(of_corners)
    for row in range(order.shape[0]):
        t = order[row]
        for k in range(3):
            normals_out[row, k] = faces[t, k]
            for part in range(3):
                normals_out[row, 3 + 3 * part + k] = of_edges[edges[3 * t + part], k]
                normals_out[row, 12 + 3 * part + k] = of_corners[triangles[t, part], k]


@exact_kernel
def triangle_boxes(vertices: Rows, triangles: IndexRows, boxes_out: RowsOut) -> None:
    """Write the boxes (t, 6) about triangles (t, 3) of vertices (v, 3) [m]."""
    for t in range(triangles.shape[0]):
        for k in range(3):
            a, b, c = vertices[triangles[t, 0], k], vertices[triangles[t, 1], k], vertices[triangles[t, 2], k]
            boxes_out[t, k], boxes_out[t, 3 + k] = min(a, b, c), max(a, b, c)


@exact_kernel
def corners_and_edges(vertices: Rows, triangles: IndexRows, order: Indices, rows_out: RowsOut) -> None:
    """Write corner a and edges b - a and c - a of triangles (t, 3), those of an order (n,), shape (n, 9) [m]."""
    for row in range(order.shape[0]):
        t = order[row]
        for k in range(3):
            a = vertices[triangles[t, 0], k]
            rows_out[row, k] = a
            rows_out[row, 3 + k] = vertices[triangles[t, 1], k] - a
            rows_out[row, 6 + k] = vertices[triangles[t, 2], k] - a


@exact_kernel
def corner_sums(vertices: Rows, triangles: IndexRows, sums_out: RowsOut) -> None:
    """Write the sums of the corners of triangles (t, 3), shape (t, 3) [m]."""
    for t in range(triangles.shape[0]):
        for k in range(3):
            sums_out[t, k] = vertices[triangles[t, 0], k] + vertices[triangles[t, 1], k] + vertices[triangles[t, 2], k]


@exact_kernel
def runs_of_triangles(
    vertices: Rows, triangles: IndexRows, order: Indices, size: int, triangles_out: IndexRows32, boxes_out: RowsOut
) -> None:
    """Write triangles (t, 3) in an order (t,), and the boxes (runs, 6) about runs of `size` of them [m]."""
    for run in range(boxes_out.shape[0]):
        boxes_out[run, :3], boxes_out[run, 3:] = math.inf, -math.inf
        for row in range(run * size, min(order.shape[0], (run + 1) * size)):
            for corner in range(3):
                vertex = triangles[order[row], corner]
                triangles_out[row, corner] = vertex
                for k in range(3):
                    boxes_out[run, k] = min(boxes_out[run, k], vertices[vertex, k])
                    boxes_out[run, 3 + k] = max(boxes_out[run, 3 + k], vertices[vertex, k])


@inlined
def _squared(vertices: Floats, a: int, b: int) -> float:
    square = 0.0
    for k in range(3):
        square += (vertices[b, k] - vertices[a, k]) ** 2
    return square


@kernel
def wide_triangles(vertices: Rows, triangles: IndexRows, thin: float, wide_out: TruthsOut) -> None:
    """Write which triangles (t, 3) have an area, (t,): twice it above `thin` times the longest edge squared."""
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        square = 0.0
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            across = (vertices[b, i] - vertices[a, i]) * (vertices[c, j] - vertices[a, j])
            across -= (vertices[b, j] - vertices[a, j]) * (vertices[c, i] - vertices[a, i])
            square += across * across
        longest = max(_squared(vertices, a, b), _squared(vertices, b, c), _squared(vertices, c, a))
        wide_out[t] = square > (thin * longest) ** 2


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
