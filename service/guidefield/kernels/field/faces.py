"""Charged triangles and convex quadrilaterals of a block of faces that share corners; SIMD batches of points.

Source: J.-H. Chuang, Potential-based modeling of three-dimensional workspace for obstacle avoidance, IEEE Trans.
Robotics and Automation, 1998. With a_i the vector from the point to a triangle's corner i, l_i its length, S their sum,
L_i the length of the edge opposite to corner i and a four times the area

    Phi = (2/h) atan2(a h, F),   F = (l1+l2)(l2+l3)(l3+l1) - L1^2 l1 - L2^2 l2 - L3^2 l3
    grad F = -sum_i (S^2 - l_i^2 - L_i^2) a_i / l_i

Beside the edges of slivers F as written cancels; of these it is evaluated along the longest edge, where nothing does.
Potential and gradient are then good to a few eps K, K the largest distance to a corner over the distance to the face.

Every distance is computed once for all faces of a block that share the corner, and the gradient is gathered as one
number a corner: grad = sum_v c_v (v - p) / l_v + the parts along the normals.
"""

from __future__ import annotations

import math
from typing import Any

from guidefield.kernels.jit.decorators import inlined
from guidefield.kernels.simd.vector import every, inverse_root, is_double, load, magnitude, select, smallest_gap, store

_TAN = math.tan(math.pi / 8)
FLAT = 1.0 / math.tan(math.pi / 16)  # a triangle is flat to points where h a `FLAT` <= F; `_small_tail` is made for it


@inlined
def arctangent_tail(u: Any) -> Any:
    """P in atan(x)/x = 1 + u P(u), u = x^2 <= tan^2(pi/8): Chebyshev interpolation to 1e-16, or 5e-8 in single."""
    if is_double(u):
        # Estrin's scheme: half as deep as Horner's.
        v = u * u
        w = v * v
        low = (0.19999999999994625 * u - 0.3333333333333333) + v * (0.1111111100050614 * u - 0.14285714284481288)
        middle = (0.07692169546900175 * u - 0.09090903984842529) + v * (0.05856512682532068 * u - 0.0666432118906571)
        high = (0.03898919890871025 * u - 0.050769728123933586) - 0.018882896150653267 * v
        p = low + w * (middle + w * high)
    else:
        p = -0.06410238547562329 * u + 0.10731026485233348
        p = p * u - 0.1426276828736559
        p = p * u + 0.19999505867568435
        p = p * u - 0.3333333160902393
    return p


@inlined
def _arcsine(v: Any) -> tuple[Any, Any]:
    """A = asin(w)/w and 2 (A - sqrt(1 - v))/v, v = w^2 <= sin^2(pi/8): to 5e-9 and 4e-7, for single precision."""
    w = v * v
    p = (0.166665193694689 * v + 1.0) + w * (0.04060867763848105 * w + (0.043221772518643814 * v + 0.0750779166712051))
    q = (0.40010491465203524 * v + 1.3333328418277282) + w * (0.17399257135196683 * v + 0.21084200033758846)
    return p, q


@inlined
def _small_tail(u: Any) -> Any:
    """`arctangent_tail` for u <= tan^2(pi/16), to 3e-17; in double precision."""
    v = u * u
    low = (0.19999999999997098 * u - 0.3333333333333333) + v * (0.11111110804464902 * u - 0.1428571428418684)
    high = (0.07690678353379068 * u - 0.09090878804432526) + v * (0.05108690152239567 * u - 0.06617819710320852)
    return low + (v * v) * high


@inlined
def _small_arcsine(v: Any) -> tuple[Any, Any]:
    """`_arcsine` for v <= sin^2(pi/16), to 8e-8 and 2e-7."""
    p = (0.07765217367238127 * v + 0.16662811162033278) * v + 1.0
    q = (0.22254978623441846 * v + 0.39987981179782855) * v + 1.33333359040158
    return p, q


@inlined
def positive(signed: Any) -> Any:
    """The height that the formulas divide by."""
    h = magnitude(signed)
    gap = smallest_gap(h)
    return select(h > gap, h, gap)


@inlined
def _angle(h: Any, B: Any, R: Any) -> tuple[Any, Any, Any, Any]:
    """Half the solid angle, 1/h, and the parts of the angle and of R that count for the curvature.

    Phi - 2 Q is (2/h) angle - ... with the whole of the angle and -R, or, where the face is flat and the two would
    cancel, with the angle less x and u R, x = h B/R, u = x^2.
    """
    y = h * B
    size = magnitude(R)
    steep = y > size
    low = select(steep, size, y)
    high = select(steep, y, size)
    # atan(low/high) = pi/4 + atan((low - high)/(low + high)).
    middle = low > _TAN * high
    x = select(middle, low - high, low) / select(middle, low + high, high)
    u = x * x
    rest = x * (u * arctangent_tail(u))
    angle = x + rest
    angle = select(middle, angle + math.pi / 4, angle)
    angle = select(steep, math.pi / 2 - angle, angle)
    angle = select(R < 0.0, math.pi - angle, angle)
    flat = y <= _TAN * R
    return angle, 1.0 / h, select(flat, rest, angle), R * select(flat, u, -1.0)


@inlined
def steep_pair(h: Any, F1: Any, F2: Any, a1: Any, a2: Any) -> tuple[Any, Any, Any, Any]:
    """`pair_field` of any vectors, from a positive height."""
    aahh = (a1 * a2) * (h * h)
    B = a1 * F2 + a2 * F1
    N1 = F1 * F1 + (a1 * a1) * (h * h)
    N2 = F2 * F2 + (a2 * a2) * (h * h)
    over = 1.0 / (N1 * N2)
    angle, over_h, part, real = _angle(h, B, F1 * F2 - aahh)
    twice = over_h + over_h
    curvature = (twice * over_h) * (twice * part + ((B + B) * over) * (real - (aahh + aahh)))
    return twice * angle, curvature, (a1 + a1) * over * N2, (a2 + a2) * over * N1


@inlined
def flat_pair(hh: Any, F1: Any, F2: Any, a1: Any, a2: Any) -> tuple[Any, Any, Any, Any]:
    """`pair_field` of points to which the face is flat, from the square of the height, which may vanish."""
    aa = a1 * a2
    B = a1 * F2 + a2 * F1
    N1 = F1 * F1 + (a1 * a1) * hh
    N2 = F2 * F2 + (a2 * a2) * hh
    if is_double(hh):
        R = F1 * F2 - aa * hh
        over = 1.0 / (N1 * N2)
        t = B / R
        tt = t * t
        tail = arctangent_tail(hh * tt)
        twice = t + t
        phi = twice + twice * (hh * tt * tail)
        curvature = (twice + twice) * (tt * tail + (R * over) * (B * t - (aa + aa)))
    else:
        i = inverse_root(N1 * N2)
        over = i * i
        t = B * i
        tt = t * t
        p, q = _arcsine(hh * tt)
        twice = t + t
        phi = twice * p
        curvature = twice * (tt * q - ((aa + aa) + (aa + aa)) * i)
    return phi, curvature, (a1 + a1) * over * N2, (a2 + a2) * over * N1


@inlined
def pair_field(height: Any, F1: Any, F2: Any, a1: Any, a2: Any) -> tuple[Any, Any, Any, Any]:
    """Phi of two triangles in a plane, its curvature, and -Phi_F = 2 a/(F^2 + a^2 h^2) of each."""
    h = positive(height)
    R = F1 * F2 - (a1 * a2) * (h * h)
    if every(h * (a1 * F2 + a2 * F1) <= _TAN * R):
        field = flat_pair(h * h, F1, F2, a1, a2)
    else:
        field = steep_pair(h, F1, F2, a1, a2)
    return field


@inlined
def _flat_single(hh: Any, F: Any, a: Any, aa: Any) -> tuple[Any, Any, Any]:
    N = F * F + aa * hh
    if is_double(hh):
        t = a / F
        tt = t * t
        tail = _small_tail(hh * tt)
        twice = t + t
        phi = twice + twice * (hh * tt * tail)
        slope = (a + a) / N
        curvature = twice * ((tt + tt) * tail + a * slope)
    else:
        i = inverse_root(N)
        t = a * i
        tt = t * t
        p, q = _small_arcsine(hh * tt)
        twice = t + t
        phi = twice * p
        slope = twice * i
        curvature = (twice * tt) * q
    return phi, curvature, slope


@inlined
def _steep_single(h: Any, F: Any, a: Any, aa: Any) -> tuple[Any, Any, Any]:
    slope = (a + a) / (F * F + aa * (h * h))
    angle, over_h, part, real = _angle(h, a, F)
    twice = over_h + over_h
    return twice * angle, (twice * over_h) * (twice * part + slope * real), slope


@inlined
def single_field(height: Any, F: Any, a: Any, aa: Any, af: Any) -> tuple[Any, Any, Any]:
    """Phi of one triangle, given a, a^2 and a `FLAT`, its curvature, and -Phi_F = 2 a/(F^2 + a^2 h^2)."""
    h = positive(height)
    return _flat_single(h * h, F, a, aa) if every(h * af <= F) else _steep_single(h, F, a, aa)


POINT, NORMAL, PLANE_ROWS = 0, 3, 6
"""Leading columns of a face's row: a point of its plane (3), its unit normal (3); then how many there are."""

QUADRUPLE, SQUARED, FLATTENED, EDGES, LONGEST, LENGTH, TAU, THIRD, HALF_ROWS = 0, 1, 2, 3, 6, 9, 10, 11, 14
"""Columns of a triangle behind those, and of each half of a quadrilateral: a, a^2, a `FLAT`, L_i^2 (3); t, along the
longest edge (3), its length, tau, e (3); then how many there are. `geometry/charged.py` writes them."""

AFTER, FIRST_VERTEX, PAST_VERTEX, LINK_COLUMNS = 0, 1, 2, 12
"""Columns of a node's links: the node after all below it, a leaf's vertices; then how many columns there are."""

FIRST_TRIANGLE, FIRST_SLIVER, PAST_TRIANGLE = 3, 4, 5  # a leaf's triangles: the ordinary ones, then slivers

FIRST_QUAD, FIRST_SLIVER_QUAD, PAST_QUAD = 6, 7, 8
"""A leaf's quadrilaterals: the ordinary ones, then those with a sliver."""

FORM, FIRST_ROW, PAST_ROW = 9, 10, 11  # a leaf's closed forms: their kind, and the rows of its table
BOXES, SPHERES, CAPSULES, PLANES, POINTS = range(1, 6)  # kinds of closed forms; 0 is none
ORDINARY = 0.25  # triangles lower than this, over their longest edge, are slivers: less loses digits, more costs time


@inlined
def _dot(a: Any, b: Any, at: int) -> Any:
    return a[0] * b[at] + a[1] * b[at + 1] + a[2] * b[at + 2]


@inlined
def _height(p: Any, row: Any) -> Any:
    """Height of points over the plane of a face, on the side of its normal."""
    return (
        (p[0] - row[POINT]) * row[NORMAL]
        + (p[1] - row[POINT + 1]) * row[NORMAL + 1]
        + (p[2] - row[POINT + 2]) * row[NORMAL + 2]
    )


@inlined
def sliver_part(a1: Any, l1: Any, l2: Any, l3: Any, half: Any) -> Any:
    """F from coordinates along the longest edge (s) and across it (w), where all terms that could cancel don't.

    tau = (v3 - v1).t and e = (v3 - v1) - tau t place the third corner.
    """
    s1 = _dot(a1, half, LONGEST)
    s2 = s1 + half[LENGTH]
    s3 = s1 + half[TAU]
    tx, ty, tz = half[LONGEST], half[LONGEST + 1], half[LONGEST + 2]
    wx, wy, wz = a1[0] - s1 * tx, a1[1] - s1 * ty, a1[2] - s1 * tz
    ww = wx * wx + wy * wy + wz * wz
    ew = _dot((wx, wy, wz), half, THIRD)
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
    m = select(between, r * k_conjugate * half[LENGTH] * (s1 + s2), cross1 + cross2)
    part = l3 * k + s3 * m + (l1 + l2) * (ww + ew)
    return part + part


@inlined
def _part(ordinary: bool, p: Any, v1: Any, l1: Any, l2: Any, l3: Any, half: Any) -> Any:
    """F of a triangle whose first corner is v1."""
    if ordinary:
        F = (l1 + l2) * ((l2 + l3) * (l3 + l1)) - _dot((l1, l2, l3), half, EDGES)
    else:
        F = sliver_part((v1[0] - p[0], v1[1] - p[1], v1[2] - p[2]), l1, l2, l3, half)
    return F


@inlined
def _gather(
    scratch: Any, squares: int, step: int, v1: int, v2: int, v3: int, s: Any, l1: Any, l2: Any, l3: Any, half: Any
) -> None:
    """Add s (S^2 - l_i^2 - L_i^2) to the number of corner i."""
    S = l1 + l2 + l3
    whole = s * (S * S)
    c = 2 * squares
    q1, q2, q3 = (
        load(scratch, squares + v1 * step),
        load(scratch, squares + v2 * step),
        load(scratch, squares + v3 * step),
    )
    store(scratch, c + v1 * step, (load(scratch, c + v1 * step) + whole) - s * (q1 + half[EDGES]))
    store(scratch, c + v2 * step, (load(scratch, c + v2 * step) + whole) - s * (q2 + half[EDGES + 1]))
    store(scratch, c + v3 * step, (load(scratch, c + v3 * step) + whole) - s * (q3 + half[EDGES + 2]))


@inlined
def _corners(vertices: Any, at: int, scratch: Any, step: int) -> Any:
    """A triangle's three vertices, the row's entries from `at` on, and the distances of the points to them."""
    v1, v2, v3 = vertices[at], vertices[at + 1], vertices[at + 2]
    return (v1, v2, v3), (load(scratch, v1 * step), load(scratch, v2 * step), load(scratch, v3 * step))


@inlined
def block_at(  # noqa: PLR0915 - corners, triangles, quads, corners
    p: Any, scratch: Any, step: int, vertices: Any, link: Any, triangle_corners: Any, triangles: Any,
    quad_corners: Any, quads: Any,
) -> Any:  # fmt: skip
    """Return the field of a block of unit charge per area: Phi, gradient (3), curvature, half the solid angles.

    p are points in the frame of the tables [m], three lanes; `scratch` has 4 * step elements for every vertex (v, 3) of
    the block, `link` is its row of `FieldTables.links` (field.py). Triangles have vertices (t, 3), the longest
    edge from the first to the second, and rows of plane and half (t, 20); quads two triangles each (q, 6), and plane
    and two halves (q, 34).
    """
    x, y, z = p
    zero = 0.0 * x
    phi, gx, gy, gz, curvature, winding = zero, zero, zero, zero, zero, zero
    gap = smallest_gap(x)
    n = vertices.shape[0]
    squares = n * step
    c, inverses = 2 * squares, 3 * squares
    for v in range(n):
        dx, dy, dz = x - vertices[v, 0], y - vertices[v, 1], z - vertices[v, 2]
        square = dx * dx + dy * dy + (dz * dz + gap * gap)
        inverse = inverse_root(square)
        store(scratch, v * step, square * inverse)
        store(scratch, squares + v * step, square)
        store(scratch, c + v * step, zero)
        store(scratch, inverses + v * step, inverse)
    for t in range(link[FIRST_TRIANGLE], link[PAST_TRIANGLE]):
        row = triangles[t]
        half = row[PLANE_ROWS:]
        (v1, v2, v3), (l1, l2, l3) = _corners(triangle_corners[t], 0, scratch, step)
        F = _part(t < link[FIRST_SLIVER], p, vertices[v1], l1, l2, l3, half)
        height = _height(p, row)
        term, k, slope = single_field(height, F, half[QUADRUPLE], half[SQUARED], half[FLATTENED])
        _gather(scratch, squares, step, v1, v2, v3, slope, l1, l2, l3, half)
        phi = phi + term
        winding = winding + height * term
        curvature = curvature + k
        k = k * height
        gx = gx + k * row[NORMAL]
        gy = gy + k * row[NORMAL + 1]
        gz = gz + k * row[NORMAL + 2]
    for t in range(link[FIRST_QUAD], link[PAST_QUAD]):
        row = quads[t]
        half1 = row[PLANE_ROWS:]
        half2 = row[PLANE_ROWS + HALF_ROWS :]
        (v1, v2, v3), (l1, l2, l3) = _corners(quad_corners[t], 0, scratch, step)
        (v4, v5, v6), (l4, l5, l6) = _corners(quad_corners[t], 3, scratch, step)
        F1 = _part(t < link[FIRST_SLIVER_QUAD], p, vertices[v1], l1, l2, l3, half1)
        F2 = _part(t < link[FIRST_SLIVER_QUAD], p, vertices[v4], l4, l5, l6, half2)
        height = _height(p, row)
        term, k, slope1, slope2 = pair_field(height, F1, F2, half1[QUADRUPLE], half2[QUADRUPLE])
        _gather(scratch, squares, step, v1, v2, v3, slope1, l1, l2, l3, half1)
        _gather(scratch, squares, step, v4, v5, v6, slope2, l4, l5, l6, half2)
        phi = phi + term
        winding = winding + height * term
        curvature = curvature + k
        k = k * height
        gx = gx + k * row[NORMAL]
        gy = gy + k * row[NORMAL + 1]
        gz = gz + k * row[NORMAL + 2]
    gx, gy, gz = -0.5 * gx, -0.5 * gy, -0.5 * gz
    for v in range(n):
        w = load(scratch, c + v * step) * load(scratch, inverses + v * step)
        gx = gx - w * (x - vertices[v, 0])
        gy = gy - w * (y - vertices[v, 1])
        gz = gz - w * (z - vertices[v, 2])
    return phi, gx, gy, gz, curvature, winding


@inlined
def block_potential_at(
    p: Any, scratch: Any, step: int, vertices: Any, link: Any, triangle_corners: Any, triangles: Any,
    quad_corners: Any, quads: Any,
) -> Any:  # fmt: skip
    """`block_at` for the potential alone."""
    x, y, z = p
    zero = 0.0 * x
    phi = zero
    gap = smallest_gap(x)
    for v in range(vertices.shape[0]):
        dx, dy, dz = x - vertices[v, 0], y - vertices[v, 1], z - vertices[v, 2]
        square = dx * dx + dy * dy + (dz * dz + gap * gap)
        store(scratch, v * step, square * inverse_root(square))
    for t in range(link[FIRST_TRIANGLE], link[PAST_TRIANGLE]):
        row = triangles[t]
        half = row[PLANE_ROWS:]
        v, (l1, l2, l3) = _corners(triangle_corners[t], 0, scratch, step)
        F = _part(t < link[FIRST_SLIVER], p, vertices[v[0]], l1, l2, l3, half)
        phi = phi + single_field(_height(p, row), F, half[QUADRUPLE], half[SQUARED], half[FLATTENED])[0]
    for t in range(link[FIRST_QUAD], link[PAST_QUAD]):
        row = quads[t]
        half1 = row[PLANE_ROWS:]
        half2 = row[PLANE_ROWS + HALF_ROWS :]
        v, (l1, l2, l3) = _corners(quad_corners[t], 0, scratch, step)
        w, (l4, l5, l6) = _corners(quad_corners[t], 3, scratch, step)
        F1 = _part(t < link[FIRST_SLIVER_QUAD], p, vertices[v[0]], l1, l2, l3, half1)
        F2 = _part(t < link[FIRST_SLIVER_QUAD], p, vertices[w[0]], l4, l5, l6, half2)
        phi = phi + pair_field(_height(p, row), F1, F2, half1[QUADRUPLE], half2[QUADRUPLE])[0]
    return phi
