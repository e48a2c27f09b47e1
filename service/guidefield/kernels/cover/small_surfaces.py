"""Many small surfaces at once: axes in which each is thin, and its rows for the distance kernels."""

from __future__ import annotations

import math

import numpy as np
from numba import void

from guidefield.kernels.cover.curve_places import curve_places
from guidefield.kernels.cover.edge_numbers import number_edges
from guidefield.kernels.distance.bvh import boxes_of_pairs, middles_within
from guidefield.kernels.distance.pseudonormal_sums import summed_normals
from guidefield.kernels.distance.triangle_distance import LEAF
from guidefield.kernels.distance.triangle_rows import corners_and_edges, triangle_boxes
from guidefield.kernels.jit.signatures import (
    BLOCKS_OUT,
    INDEX_MATRIX,
    MATRIX,
    MATRIX_OUT,
    Floats,
    Integers,
    compiled,
    inlined,
)

FLAT = 1e-9
"""Share of its size within which a surface is flat."""

FINEST = 21
"""Bits of one coordinate of a place on the Morton curve: three fit into 63."""


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


@compiled(void(MATRIX, INDEX_MATRIX, INDEX_MATRIX, MATRIX_OUT, MATRIX_OUT, MATRIX_OUT, MATRIX_OUT))
def small_surfaces(
    vertices: Floats,
    triangles: Integers,
    starts: Integers,
    bounds_out: Floats,
    nodes_out: Floats,
    corners_out: Floats,
    normals_out: Floats,
) -> None:
    """Write the rows of surfaces of few triangles, all of which have an area, as `SurfaceTables` has them.

    Args:
        vertices: Of the surfaces, one behind the other, shape (v, 3) [m].
        triangles: Indices among the vertices of their own surface, shape (t, 3).
        starts: The first vertex, triangle and node of each surface, then the numbers of all, shape (n + 1, 3).
        bounds_out: Lower and upper corner of the box about each, shape (n, 6) [m].
        nodes_out: Shape (m, 6).
        corners_out: Shape (t, 9).
        normals_out: Shape (t, 21).
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
    """Square of the distance of two vertices [m^2]."""
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


@compiled(void(MATRIX, INDEX_MATRIX, INDEX_MATRIX, BLOCKS_OUT))
def flat_frames(vertices: Floats, triangles: Integers, starts: Integers, axes_out: Floats) -> None:
    """Find axes in which the box about each surface is as thin as the surface, if that is flat; else the given ones.

    Args:
        vertices: As `small_surfaces` takes them.
        triangles: As there.
        starts: As there; nodes aren't looked at.
        axes_out: The axes as columns, the last one across a flat surface, shape (n, 3, 3).
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
