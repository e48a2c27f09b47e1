"""Charged triangles and convex quadrilaterals of a block of faces that share corners; lanes of points.

Source: J.-H. Chuang, Potential-based modeling of three-dimensional workspace for obstacle avoidance, IEEE Trans.
Robotics and Automation, 1998. With a_i the vector from the point to corner i of a triangle, l_i its length, L_i the
length of the edge opposite to corner i and a twice the area

    Phi = (2/h) atan2(a h, D),   2 D = (l1+l2)(l2+l3)(l3+l1) - L1^2 l1 - L2^2 l2 - L3^2 l3
    grad D = -sum_i (l1 l2 + l2 l3 + l3 l1 + a_j.a_k) a_i / l_i

In double precision D is evaluated along the longest edge, where nothing cancels beside the edges of slivers; potential
and gradient are then good to a few eps K, K the largest distance to a corner over the distance to the face. In single
precision it is evaluated as written, which is faster.

Every distance is computed once for all faces of a block that share the corner, and the gradient is gathered as one
number a corner: grad = sum_v c_v (v - p) / l_v + the parts along the normals.
"""

from __future__ import annotations

from typing import Any

from guidefield.kernels.point_lanes import inverse_root, is_double, load, select, smallest_gap, store
from guidefield.kernels.signatures import inlined
from guidefield.kernels.solid_angle import pair_field, positive, single_field

HALF_ROWS = 14
"""Numbers of a triangle: t (3), length, tau, e (3), a, L_i^2 / 2 (3), 2 unused."""

NORMAL, CHARGE = 0, 3
"""Where the unit normal and the charge stand in the four numbers of a face."""


@inlined
def _dot(a: Any, b: Any, at: int) -> Any:
    return a[0] * b[at] + a[1] * b[at + 1] + a[2] * b[at + 2]


@inlined
def robust_denominator(a1: Any, l1: Any, l2: Any, l3: Any, half: Any) -> Any:
    """D from coordinates along the longest edge (s) and across it (w), where all terms that could cancel don't."""
    s1 = _dot(a1, half, 0)
    s2 = s1 + half[3]
    s3 = s1 + half[4]
    wx, wy, wz = a1[0] - s1 * half[0], a1[1] - s1 * half[1], a1[2] - s1 * half[2]
    ww = wx * wx + wy * wy + wz * wz
    ew = wx * half[5] + wy * half[6] + wz * half[7]
    along = s1 * s2
    between = along < 0.0
    cross1 = l1 * s2
    cross2 = l2 * s1
    l12 = l1 * l2
    # Between its ends, k = l1 l2 + s1 s2 + ww and m = l1 s2 + l2 s1 are made rational: one division for both.
    k_conjugate = l12 - along
    m_conjugate = cross1 - cross2
    r = ww / (k_conjugate * m_conjugate)
    k = ww + select(between, r * m_conjugate * (s1 * s1 + s2 * s2 + ww), l12 + along)
    m = select(between, r * k_conjugate * half[3] * (s1 + s2), cross1 + cross2)
    return l3 * k + s3 * m + (l1 + l2) * (ww + ew)


@inlined
def _denominator(a1: Any, l1: Any, l2: Any, l3: Any, half: Any) -> Any:
    if is_double(l1):
        D = robust_denominator(a1, l1, l2, l3, half)
    else:
        D = 0.5 * ((l1 + l2) * ((l2 + l3) * (l3 + l1))) - (half[9] * l1 + half[10] * l2 + half[11] * l3)
    return D


@inlined
def _gather(
    scratch: Any, c: int, step: int, v1: int, v2: int, v3: int, s: Any, l1: Any, l2: Any, l3: Any, half: Any
) -> None:
    """Add s (l1 l2 + l2 l3 + l3 l1 + a_j.a_k) to the number of corner i; a_j.a_k = (l_j^2 + l_k^2 - L_i^2)/2."""
    q1, q2, q3 = l1 * l1, l2 * l2, l3 * l3
    q = s * (l1 * (l2 + l3) + l2 * l3)
    h = 0.5 * s
    store(scratch, c + v1 * step, load(scratch, c + v1 * step) + (q + h * (q2 + q3) - s * half[9]))
    store(scratch, c + v2 * step, load(scratch, c + v2 * step) + (q + h * (q3 + q1) - s * half[10]))
    store(scratch, c + v3 * step, load(scratch, c + v3 * step) + (q + h * (q1 + q2) - s * half[11]))


@inlined
def block_at(  # noqa: PLR0915 - corners, triangles, quads, corners
    p: Any, f: Any, scratch: Any, step: int, vertices: Any, first_triangle: int, past_triangle: int, first_quad: int,
    past_quad: int, triangle_corners: Any, triangles: Any, quad_corners: Any, quads: Any,
) -> Any:  # fmt: skip
    """Field of a block at points, added to f = (Phi, gradient (3), curvature, half the solid angles).

    Args:
        p: Points [m], three lanes.
        f: What to add to.
        scratch: At least 3 * step elements for every vertex of the block; holds nothing between calls.
        step: Lanes of a vector.
        vertices: Corners of this block, shape (v, 3) [m].
        first_triangle: The block's triangles, up to past_triangle.
        past_triangle: See first_triangle.
        first_quad: The block's quads, up to past_quad.
        past_quad: See first_quad.
        triangle_corners: Vertices of the block, longest edge from the first to the second, shape (t, 3).
        triangles: Face (4) and half (HALF_ROWS), shape (t, 4 + HALF_ROWS).
        quad_corners: Two triangles each, shape (q, 6).
        quads: Face (4) and two halves, shape (q, 4 + 2 HALF_ROWS).
    """
    x, y, z = p
    phi, gx, gy, gz, curvature, winding = f
    zero = 0.0 * x
    gap = smallest_gap(x)
    n = vertices.shape[0]
    c = n * step
    inverses = 2 * c
    for v in range(n):
        dx, dy, dz = vertices[v, 0] - x, vertices[v, 1] - y, vertices[v, 2] - z
        square = dx * dx + dy * dy + dz * dz + gap * gap
        inverse = inverse_root(square)
        store(scratch, v * step, square * inverse)
        store(scratch, c + v * step, zero)
        store(scratch, inverses + v * step, inverse)
    for t in range(first_triangle, past_triangle):
        row = triangles[t]
        half = row[4:]
        v1, v2, v3 = triangle_corners[t, 0], triangle_corners[t, 1], triangle_corners[t, 2]
        l1, l2, l3 = load(scratch, v1 * step), load(scratch, v2 * step), load(scratch, v3 * step)
        a1 = (vertices[v1, 0] - x, vertices[v1, 1] - y, vertices[v1, 2] - z)
        D = _denominator(a1, l1, l2, l3, half)
        height = -_dot(a1, row, NORMAL)
        term, k, slope = single_field(positive(height), D, half[8] + zero)
        _gather(scratch, c, step, v1, v2, v3, slope * row[CHARGE], l1, l2, l3, half)
        phi = phi + row[CHARGE] * term
        winding = winding + height * term
        k = k * (row[CHARGE])
        curvature = curvature + k
        k = k * (-0.5 * height)
        gx = gx + k * row[NORMAL]
        gy = gy + k * row[NORMAL + 1]
        gz = gz + k * row[NORMAL + 2]
    for t in range(first_quad, past_quad):
        row = quads[t]
        half1 = row[4:]
        half2 = row[4 + HALF_ROWS :]
        v1, v2, v3 = quad_corners[t, 0], quad_corners[t, 1], quad_corners[t, 2]
        v4, v5, v6 = quad_corners[t, 3], quad_corners[t, 4], quad_corners[t, 5]
        l1, l2, l3 = load(scratch, v1 * step), load(scratch, v2 * step), load(scratch, v3 * step)
        l4, l5, l6 = load(scratch, v4 * step), load(scratch, v5 * step), load(scratch, v6 * step)
        a1 = (vertices[v1, 0] - x, vertices[v1, 1] - y, vertices[v1, 2] - z)
        a4 = (vertices[v4, 0] - x, vertices[v4, 1] - y, vertices[v4, 2] - z)
        D1 = _denominator(a1, l1, l2, l3, half1)
        D2 = _denominator(a4, l4, l5, l6, half2)
        height = -_dot(a1, row, NORMAL)
        term, k, slope1, slope2 = pair_field(positive(height), D1, D2, half1[8] + zero, half2[8] + zero)
        _gather(scratch, c, step, v1, v2, v3, slope1 * row[CHARGE], l1, l2, l3, half1)
        _gather(scratch, c, step, v4, v5, v6, slope2 * row[CHARGE], l4, l5, l6, half2)
        phi = phi + row[CHARGE] * term
        winding = winding + height * term
        k = k * (row[CHARGE])
        curvature = curvature + k
        k = k * (-0.5 * height)
        gx = gx + k * row[NORMAL]
        gy = gy + k * row[NORMAL + 1]
        gz = gz + k * row[NORMAL + 2]
    for v in range(n):
        w = load(scratch, c + v * step) * load(scratch, inverses + v * step)
        gx = gx + w * (vertices[v, 0] - x)
        gy = gy + w * (vertices[v, 1] - y)
        gz = gz + w * (vertices[v, 2] - z)
    return phi, gx, gy, gz, curvature, winding


@inlined
def block_potential_at(
    p: Any, phi: Any, scratch: Any, step: int, vertices: Any, first_triangle: int, past_triangle: int, first_quad: int,
    past_quad: int, triangle_corners: Any, triangles: Any, quad_corners: Any, quads: Any,
) -> Any:  # fmt: skip
    """`block_at` for the potential alone."""
    x, y, z = p
    zero = 0.0 * x
    gap = smallest_gap(x)
    for v in range(vertices.shape[0]):
        dx, dy, dz = vertices[v, 0] - x, vertices[v, 1] - y, vertices[v, 2] - z
        square = dx * dx + dy * dy + dz * dz + gap * gap
        store(scratch, v * step, square * inverse_root(square))
    for t in range(first_triangle, past_triangle):
        row = triangles[t]
        half = row[4:]
        v1, v2, v3 = triangle_corners[t, 0], triangle_corners[t, 1], triangle_corners[t, 2]
        l1, l2, l3 = load(scratch, v1 * step), load(scratch, v2 * step), load(scratch, v3 * step)
        a1 = (vertices[v1, 0] - x, vertices[v1, 1] - y, vertices[v1, 2] - z)
        D = _denominator(a1, l1, l2, l3, half)
        phi = phi + row[CHARGE] * single_field(positive(_dot(a1, row, NORMAL)), D, half[8] + zero)[0]
    for t in range(first_quad, past_quad):
        row = quads[t]
        half1 = row[4:]
        half2 = row[4 + HALF_ROWS :]
        v1, v2, v3 = quad_corners[t, 0], quad_corners[t, 1], quad_corners[t, 2]
        v4, v5, v6 = quad_corners[t, 3], quad_corners[t, 4], quad_corners[t, 5]
        l1, l2, l3 = load(scratch, v1 * step), load(scratch, v2 * step), load(scratch, v3 * step)
        l4, l5, l6 = load(scratch, v4 * step), load(scratch, v5 * step), load(scratch, v6 * step)
        a1 = (vertices[v1, 0] - x, vertices[v1, 1] - y, vertices[v1, 2] - z)
        a4 = (vertices[v4, 0] - x, vertices[v4, 1] - y, vertices[v4, 2] - z)
        D1 = _denominator(a1, l1, l2, l3, half1)
        D2 = _denominator(a4, l4, l5, l6, half2)
        height = positive(_dot(a1, row, NORMAL))
        phi = phi + row[CHARGE] * pair_field(height, D1, D2, half1[8] + zero, half2[8] + zero)[0]
    return phi
