"""Rows of triangles for the distance kernels: boxes, corners, pseudonormals; which have an area; edges that touch.

Columns are those of `triangle_distance.SurfaceTables`; edges that touch are those of outlines of planes and extrusions.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.jit.arrays import (
    Blocks,
    Floats,
    IndexRows,
    IndexRows32,
    IndexRowsOut,
    Indices,
    IndicesOut,
    Integers,
    Row,
    Rows,
    RowsOut,
    TruthsOut,
)
from guidefield.kernels.jit.decorators import exact_kernel, inlined, inner_kernel, kernel

NOTHING = 1e-14  # vectors shorter than this share of the longest are rounding
SHORTEST = 1e-300  # longest vectors shorter than this are none


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
def _from_segment(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    along_x, along_y = bx - ax, by - ay
    share = ((x - ax) * along_x + (y - ay) * along_y) / (along_x * along_x + along_y * along_y)
    share = min(max(share, 0.0), 1.0)
    return float(np.hypot(x - (ax + share * along_x), y - (ay + share * along_y)))


@inlined
def _turn(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Twice the signed area of the triangle a b c."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@inlined
def _touch(corners: Floats, i: int, j: int, gap: float) -> bool:
    """Tell if edges i and j cross or come that near."""
    count = corners.shape[0]
    ax, ay = corners[i]
    bx, by = corners[(i + 1) % count]
    cx, cy = corners[j]
    dx, dy = corners[(j + 1) % count]
    near = min(_from_segment(cx, cy, ax, ay, bx, by), _from_segment(dx, dy, ax, ay, bx, by))
    near = min(near, _from_segment(ax, ay, cx, cy, dx, dy), _from_segment(bx, by, cx, cy, dx, dy))
    if near <= gap:
        return True
    across = _turn(ax, ay, bx, by, cx, cy) * _turn(ax, ay, bx, by, dx, dy) < 0.0
    return bool(across and _turn(cx, cy, dx, dy, ax, ay) * _turn(cx, cy, dx, dy, bx, by) < 0.0)


@inner_kernel
def touching_edges(corners: Rows, boxes: Rows, order: Indices, gap: float) -> IndicesOut:
    """Return the first two edges that aren't neighbours and cross or come as near as `gap` [m]; twice k where none do.

    Edge i runs from corner i to i + 1 of (k, 2); `boxes` (k, 4) have its least x and y, and its largest, `order` (k,)
    is by least x. A sweep along x: an edge meets only those that begin before it ends. First is the least first edge,
    then the least other.
    """
    count = corners.shape[0]
    found = np.full(2, count)
    for at in range(count):
        one = order[at]
        for later in range(at + 1, count):
            other = order[later]
            if boxes[other, 0] > boxes[one, 2] + 2.0 * gap:
                break
            if boxes[other, 1] > boxes[one, 3] + 2.0 * gap or boxes[one, 1] > boxes[other, 3] + 2.0 * gap:
                continue
            i, j = min(one, other), max(one, other)
            if j - i < 2 or (i == 0 and j == count - 1) or (i, j) > (found[0], found[1]):
                continue
            if _touch(corners, i, j, gap):
                found[0], found[1] = i, j
    return found


@kernel
def touching_edges_of_each(
    corners: Blocks, boxes: Blocks, order: IndexRows, gaps: Row, found_out: IndexRowsOut
) -> None:
    """Write the first touching edges (n, 2) of each of n outlines (n, k, 2), row by row as `touching_edges` does."""
    for i in range(corners.shape[0]):
        found_out[i] = touching_edges(corners[i], boxes[i], order[i], gaps[i])
