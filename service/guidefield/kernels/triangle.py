"""Charged triangles at a point: the potential int dS / |p - r|^3, its gradient, its curvature, the winding number.

One arctangent a triangle and selects instead of branches, so that the compiler evaluates several triangles at once.
Source: J.-H. Chuang, Potential-based modeling of three-dimensional workspace for obstacle avoidance, IEEE Trans.
Robotics and Automation, 1998. With Omega the solid angle of the triangle, h its height under the point, A its area,
`a_i` the vector from the point to corner i, `l_i` its length and `L_i` the length of the edge opposite to corner i:

    Phi = Omega / h = (2/h) atan2(4 A h, F),   F = (l1+l2)(l2+l3)(l3+l1) - L1^2 l1 - L2^2 l2 - L3^2 l3

F (`_denominator`), Phi and its derivatives (`_potential`) are evaluated in forms that do not cancel: beside the edges
of slivers, in the plane of the triangle, far away. Where K is the largest distance to a corner over the distance to
the triangle, potential and gradient are good to a few eps K: what a last digit in a corner would change.

What depends on the triangle alone stands in a table, one row per quantity, `ROWS` in all:

    0-8  corners 1, 2, 3, the longest edge from 1 to 2     17-19  unit normal
    9-11 t, unit vector along that edge                    20     4 A
    12   its length                                        21-23  L_i^2
    13   tau = (corner 3 - corner 1).t                     24     charge per area
    14-16 e = (corner 3 - corner 1) - tau t

A column of zeros contributes exactly nothing. Lengths [m], of 1e-6 to 1e6 with room to spare.
"""

from __future__ import annotations

import math

from guidefield.kernels.signatures import MATRIX, SCALAR, SIX_SCALARS, Floats, Six, Vector3, compiled, inlined

ROWS = 25
"""Rows of a triangle table."""

H_MIN = 1e-30
"""Least height and least distance to a corner [m]: keeps points on the surface finite, changes nothing else."""

_H_MIN_SQUARED = H_MIN * H_MIN
_TAN_1 = math.tan(math.pi / 8)
_TAN_3 = math.tan(3 * math.pi / 8)
_QUARTER = math.pi / 4
_HALF = math.pi / 2


@inlined
def _dot(a: Vector3, b: Vector3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _norm(a: Vector3) -> float:
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + _H_MIN_SQUARED)


@inlined
def _arctangent_tail(u: float) -> float:
    """P in atan(x)/x = 1 + u P(u), u = x^2 <= tan^2(pi/8): Chebyshev interpolation, off by less than 2e-18."""
    p = 0.016285756855221028
    p = p * u - 0.034570561981427744
    p = p * u + 0.04551593220626549
    p = p * u - 0.05230454270650244
    p = p * u + 0.05878928997834775
    p = p * u - 0.06666424885738255
    p = p * u + 0.07692296375032143
    p = p * u - 0.09090908753500877
    p = p * u + 0.11111111105155447
    p = p * u - 0.14285714285659828
    p = p * u + 0.19999999999999804
    return p * u - 0.3333333333333333


@inlined
def _weights(l1: float, l2: float, l3: float, squared1: float, squared2: float, squared3: float) -> Vector3:
    """The w_i in grad F = -sum w_i a_i; all are positive, so that nothing cancels far away."""
    over = 1.0 / (l1 * l2 * l3)
    l23, l31, l12 = l2 + l3, l3 + l1, l1 + l2
    w1 = 2.0 * l23 + (l23 * l23 - squared1) * (l2 * l3 * over)
    w2 = 2.0 * l31 + (l31 * l31 - squared2) * (l3 * l1 * over)
    w3 = 2.0 * l12 + (l12 * l12 - squared3) * (l1 * l2 * over)
    return w1, w2, w3


@inlined
def _potential(h: float, four_areas: float, F: float) -> tuple[float, float, float, float]:
    """Phi, -2 Phi_h/h, -Phi_F and half the solid angle, from y = 4 A h and F."""
    y = four_areas * h
    size = abs(F)
    steep = y > _TAN_3 * size
    middle = y > _TAN_1 * size
    flat = (not middle) and F > 0.0
    # atan(y/|F|) = offset + atan(x), |x| <= tan(pi/8).
    numerator = -size if steep else (y - size if middle else y)
    inverse = 1.0 / (y if steep else (y + size if middle else size))
    offset = _HALF if steep else (_QUARTER if middle else 0.0)
    x = numerator * inverse
    u = x * x
    tail = _arctangent_tail(u)
    half = offset + (x + x * u * tail)
    half = math.pi - half if F < 0.0 else half
    over_square = 1.0 / (F * F + y * y)
    slope = 2.0 * four_areas * over_square
    # Flat: no division by h, which may vanish. Else h is not small against Omega, and nothing cancels either.
    q = four_areas * inverse
    phi_flat = 2.0 * q * (1.0 + u * tail)
    curvature_flat = 4.0 * q * q * q * (tail + F * F * over_square)
    over_h = 1.0 / h
    phi_else = 2.0 * half * over_h
    curvature_else = 2.0 * (phi_else - slope * F) * over_h * over_h
    return phi_flat if flat else phi_else, curvature_flat if flat else curvature_else, slope, half


@inlined
def _denominator(a1: Vector3, lengths: Vector3, t: Vector3, length: float, tau: float, e: Vector3) -> float:
    """F from coordinates along the longest edge (s) and across it (w), where all terms that could cancel don't."""
    l1, l2, l3 = lengths
    s1 = _dot(a1, t)
    s2 = s1 + length
    s3 = s1 + tau
    w = (a1[0] - s1 * t[0], a1[1] - s1 * t[1], a1[2] - s1 * t[2])
    ww = _dot(w, w)
    cross1 = l1 * s2
    cross2 = l2 * s1
    along = s1 * s2
    between = along < 0.0
    # Between its ends, k = l1 l2 + s1 s2 + ww and m = l1 s2 + l2 s1 are made rational: one division for both.
    k_conjugate = l1 * l2 - along
    m_conjugate = cross1 - cross2
    r = ww / (k_conjugate * m_conjugate)
    k = ww + (r * m_conjugate * (s1 * s1 + s2 * s2 + ww) if between else l1 * l2 + along)
    m = r * k_conjugate * length * (s1 + s2) if between else cross1 + cross2
    return 2.0 * (l3 * k + s3 * m + (l1 + l2) * (ww + _dot(e, w)))


@compiled(SIX_SCALARS(SCALAR, SCALAR, SCALAR, MATRIX))
def triangles_at(x: float, y: float, z: float, triangles: Floats) -> Six:
    """Field of charged triangles at a point.

    Args:
        x: Point [m], with y and z.
        y: See x.
        z: See x.
        triangles: Table of the module's docstring, shape (ROWS, n), in the frame of the point.

    Returns:
        Sums over the triangles: potential [1/m], gradient (3) [1/m^2], curvature -2 Phi_h/h [1/m^3] (never negative),
        each times the charge; winding number of the triangles, whatever their charge.
    """
    # Rows as arrays of their own: with computed offsets the compiler gathers element by element.
    x1, y1, z1 = triangles[0], triangles[1], triangles[2]
    x2, y2, z2 = triangles[3], triangles[4], triangles[5]
    x3, y3, z3 = triangles[6], triangles[7], triangles[8]
    tx, ty, tz = triangles[9], triangles[10], triangles[11]
    length, tau = triangles[12], triangles[13]
    ex, ey, ez = triangles[14], triangles[15], triangles[16]
    nx, ny, nz = triangles[17], triangles[18], triangles[19]
    four_areas, charge = triangles[20], triangles[24]
    squared1, squared2, squared3 = triangles[21], triangles[22], triangles[23]
    potential = gx = gy = gz = curvature = half_angle = 0.0
    for i in range(triangles.shape[1]):
        corner1 = (x1[i] - x, y1[i] - y, z1[i] - z)
        corner2 = (x2[i] - x, y2[i] - y, z2[i] - z)
        corner3 = (x3[i] - x, y3[i] - y, z3[i] - z)
        l1, l2, l3 = _norm(corner1), _norm(corner2), _norm(corner3)
        F = _denominator(corner1, (l1, l2, l3), (tx[i], ty[i], tz[i]), length[i], tau[i], (ex[i], ey[i], ez[i]))
        height = -_dot((nx[i], ny[i], nz[i]), corner1)
        phi, k, slope, half = _potential(max(abs(height), H_MIN), four_areas[i], F)
        w1, w2, w3 = _weights(l1, l2, l3, squared1[i], squared2[i], squared3[i])
        slope *= charge[i]
        k *= charge[i]
        normal = -0.5 * k * height
        potential += charge[i] * phi
        gx += slope * (w1 * corner1[0] + w2 * corner2[0] + w3 * corner3[0]) + normal * nx[i]
        gy += slope * (w1 * corner1[1] + w2 * corner2[1] + w3 * corner3[1]) + normal * ny[i]
        gz += slope * (w1 * corner1[2] + w2 * corner2[2] + w3 * corner3[2]) + normal * nz[i]
        curvature += k
        half_angle += half if height > 0.0 else (-half if height < 0.0 else 0.0)
    return potential, gx, gy, gz, curvature, -half_angle / (2.0 * math.pi)
