"""Distance of a point to a surface of triangles, signed where it is closed; a tree of boxes finds the nearest triangle.

The sign is that of (p - c).n, c the closest point of the surface and n the pseudonormal of the face, edge or corner
that c lies on: the face's normal, the sum of the normals of the edge's faces, the sum of those of the corner's faces
weighted by their angles there. Right everywhere for a closed surface without self-contact. Source: J. A. Baerentzen
and H. Aanaes, "Signed distance computation using the angle weighted pseudonormal", IEEE Transactions on Visualization
and Computer Graphics 11(3), 2005. The closest point: C. Ericson, Real-Time Collision Detection, 2005, section 5.1.5.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import Floats, Rows, Vector3
from guidefield.kernels.jit.decorators import inlined, inner_kernel, kernel

LEAF = 4  # boxes in a leaf of a tree: time, and which of equally near faces counts; builders and searches read it here
ON_SURFACE = 1e-12  # nearer than this the direction from the surface is the pseudonormal [m]
_STACK = 64  # more nodes than ever wait: a tree of a million leaves is 20 levels deep

FACE, EDGE_AB, EDGE_BC, EDGE_CA, CORNER_A, CORNER_B, CORNER_C = range(7)
"""Parts of a triangle, as columns of its pseudonormals."""


class SurfaceTables(NamedTuple):
    """Triangles of several surfaces, each surface's in the order of its tree.

    A tree is a complete binary tree of boxes in an array: the children of node i are 2 i + 1 and 2 i + 2, its last
    `leaves` nodes hold `LEAF` triangles each. Boxes without triangles are empty, from plus to minus infinity.
    """

    nodes: Rows  # boxes, lower then upper corner, shape (m, 6) [m]
    corners: Rows  # corner a, edges b - a and c - a, shape (t, 9) [m]
    normals: Rows  # unit pseudonormals in the order of the parts, shape (t, 21)


Span = tuple[int, int, int, int]
"""Place of a tree: its first node, its number of leaves, its first triangle, its number of triangles."""


@inlined
def box_gap_squared(x: float, y: float, z: float, boxes: Floats, i: int) -> float:
    """Return the squared distance from a point to one of boxes (n, 6), 0 inside; infinite for an empty box [m^2]."""
    dx = max(boxes[i, 0] - x, x - boxes[i, 3], 0.0)
    dy = max(boxes[i, 1] - y, y - boxes[i, 4], 0.0)
    dz = max(boxes[i, 2] - z, z - boxes[i, 5], 0.0)
    square: float = dx * dx + dy * dy + dz * dz
    return square


@inlined
def _closest(p: Vector3, corners: Floats, i: int) -> tuple[float, float, int]:  # noqa: PLR0911 - one for each part
    """The point of triangle i that is closest to p: shares of its edges b - a and c - a, and the part it lies on."""
    ax, ay, az = p[0] - corners[i, 0], p[1] - corners[i, 1], p[2] - corners[i, 2]
    ux, uy, uz = corners[i, 3], corners[i, 4], corners[i, 5]
    wx, wy, wz = corners[i, 6], corners[i, 7], corners[i, 8]
    uu = ux * ux + uy * uy + uz * uz
    uw = ux * wx + uy * wy + uz * wz
    ww = wx * wx + wy * wy + wz * wz
    # along each edge as seen from corners a, b and c
    a1, a2 = ux * ax + uy * ay + uz * az, wx * ax + wy * ay + wz * az
    b1, b2 = a1 - uu, a2 - uw
    c1, c2 = a1 - uw, a2 - ww
    if a1 <= 0.0 and a2 <= 0.0:
        return 0.0, 0.0, CORNER_A
    if b1 >= 0.0 and b2 <= b1:
        return 1.0, 0.0, CORNER_B
    if c2 >= 0.0 and c1 <= c2:
        return 0.0, 1.0, CORNER_C
    # shares of the corners c, b and a, up to a common factor
    gamma = a1 * b2 - b1 * a2
    if gamma <= 0.0 and a1 >= 0.0 and b1 <= 0.0:
        return a1 / uu, 0.0, EDGE_AB
    beta = c1 * a2 - a1 * c2
    if beta <= 0.0 and a2 >= 0.0 and c2 <= 0.0:
        return 0.0, a2 / ww, EDGE_CA
    alpha = b1 * c2 - c1 * b2
    if alpha <= 0.0 and b2 >= b1 and c1 >= c2:
        share = (b2 - b1) / ((b2 - b1) + (c1 - c2))
        return 1.0 - share, share, EDGE_BC
    total = alpha + beta + gamma
    return beta / total, gamma / total, FACE


@inlined
def _away(p: Vector3, corners: Floats, i: int, s: float, t: float) -> Vector3:
    """From the point of triangle i with shares s and t of its edges to p."""
    return (
        p[0] - corners[i, 0] - s * corners[i, 3] - t * corners[i, 6],
        p[1] - corners[i, 1] - s * corners[i, 4] - t * corners[i, 7],
        p[2] - corners[i, 2] - s * corners[i, 5] - t * corners[i, 8],
    )


@inlined
def nearest_of(p: Vector3, corners: Floats, begin: int, end: int, best: float, found: int) -> tuple[float, int]:
    """Return the squared distance to the nearest of triangles `begin` to `end` - 1, rows (t, 9), and its index.

    If none is nearer than what was found, `best` [m^2] and `found`, those are returned.
    """
    for i in range(begin, end):
        s, t, _ = _closest(p, corners, i)
        dx, dy, dz = _away(p, corners, i, s, t)
        square = dx * dx + dy * dy + dz * dz
        if square < best:
            best, found = square, i
    return best, found


@inlined
def _search(x: float, y: float, z: float, surfaces: SurfaceTables, span: Span, cutoff: float, any_of_them: bool) -> int:
    """The triangle that is nearest, or any that is nearer than the cutoff, as `nearest_triangle`."""
    root, leaves, first, count = span
    p = (x, y, z)
    if leaves == 1:
        return nearest_of(p, surfaces.corners, first, first + count, cutoff * cutoff, -1)[1]
    waiting, gaps = np.empty(_STACK, np.int64), np.empty(_STACK)
    waiting[0], gaps[0] = 0, box_gap_squared(x, y, z, surfaces.nodes, root)
    top = 1
    best, found = cutoff * cutoff, -1
    while top > 0:
        top -= 1
        node = waiting[top]
        if gaps[top] >= best:
            continue
        leaf = node - (leaves - 1)
        if leaf >= 0:
            begin, end = first + leaf * LEAF, first + min(count, (leaf + 1) * LEAF)
            best, found = nearest_of(p, surfaces.corners, begin, end, best, found)
            if found >= 0 and any_of_them:
                return found
            continue
        near, far = 2 * node + 1, 2 * node + 2
        to_near = box_gap_squared(x, y, z, surfaces.nodes, root + near)
        to_far = box_gap_squared(x, y, z, surfaces.nodes, root + far)
        if to_far < to_near:
            near, far, to_near, to_far = far, near, to_far, to_near
        if to_far < best:
            waiting[top], gaps[top] = far, to_far
            top += 1
        if to_near < best:  # on top: the nearer one is examined first
            waiting[top], gaps[top] = near, to_near
            top += 1
    return found


@kernel
def nearest_triangle(x: float, y: float, z: float, surfaces: SurfaceTables, span: Span, cutoff: float) -> int:
    """Return the row of the triangle of a tree that is nearest to a point and nearer than a cutoff [m], or -1."""
    return _search(x, y, z, surfaces, span, cutoff, False)


@kernel
def some_triangle_near(x: float, y: float, z: float, surfaces: SurfaceTables, span: Span, reach: float) -> bool:
    """Tell if any triangle of a tree is nearer to a point than a reach [m] >= 0: sooner told than the nearest."""
    return _search(x, y, z, surfaces, span, reach, True) >= 0


@inner_kernel
def signed_distance(
    x: float, y: float, z: float, surfaces: SurfaceTables, nearest: int, solid: bool
) -> tuple[float, float, float, float]:
    """Return the distance of a point to its nearest triangle and the vector along it, as `surface_distance`."""
    p = (x, y, z)
    s, t, part = _closest(p, surfaces.corners, nearest)
    dx, dy, dz = _away(p, surfaces.corners, nearest, s, t)
    nx = surfaces.normals[nearest, 3 * part]
    ny = surfaces.normals[nearest, 3 * part + 1]
    nz = surfaces.normals[nearest, 3 * part + 2]
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if distance <= ON_SURFACE:
        return distance, nx, ny, nz
    sign = -1.0 if solid and dx * nx + dy * ny + dz * nz < 0.0 else 1.0
    over = sign / distance
    return sign * distance, over * dx, over * dy, over * dz


@inner_kernel
def surface_distance(
    x: float, y: float, z: float, surfaces: SurfaceTables, span: Span, solid: bool, cutoff: float
) -> tuple[float, float, float, float]:
    """Return the distance of a point to a surface of triangles [m] and the unit vector along which it grows.

    Of a `solid` distances inside are negative; beyond the cutoff [m], inside or out, they are infinite and zero.
    """
    nearest = nearest_triangle(x, y, z, surfaces, span, cutoff)
    if nearest < 0:
        return math.inf, 0.0, 0.0, 0.0
    return signed_distance(x, y, z, surfaces, nearest, solid)
