"""Fields of charged boxes, capsules, spheres and planes in closed form, at SIMD batches of points.

A box is six rectangles that share eight distances, one arctangent each. Where all lanes are `FAR` all faces are flat to
them and nothing can cancel, so that the shorter forms serve.
"""

from __future__ import annotations

import math
from typing import Any

from guidefield.kernels.field.faces import flat_pair, pair_field, positive
from guidefield.kernels.jit.arrays import Six, Vector3
from guidefield.kernels.jit.decorators import inlined
from guidefield.kernels.simd.vector import every, inverse_root, is_double, root, select, smallest_gap

CAPSULE_SHELL = 0.01
"""A point nearer to a capsule than this part of its radius, or inside it, has the field of this distance: above 0."""

_ON_AXIS = 1e-24
_ON_AXIS_SINGLE = 1e-10
"""Square of the distance from a capsule's axis, over its size and the point's distance, that counts as none."""

Numeric = Any  # a number, or a vector of them


@inlined
def winding_behind(height: Numeric) -> Numeric:
    """Winding number of a closed surface at a signed distance from it: 1 inside, 1/2 on it, 0 outside."""
    return select(height < 0.0, 1.0, select(height > 0.0, 0.0, 0.5 + 0.0 * height))


@inlined
def _across(u: Vector3) -> Vector3:
    """A vector across the unit vector u, at least 0.7 long; (1, 0, 0) if u is zero."""
    along_x = u[0] * u[0] > 0.5
    none = u[0] == 0.0 and u[1] == 0.0 and u[2] == 0.0
    return (1.0 if none else (u[2] if along_x else 0.0), 0.0 if along_x else -u[2], -u[0] if along_x else u[1])


@inlined
def _tube(
    z1: Numeric, z2: Numeric, b2: Numeric, i1: Numeric, i2: Numeric, R1: Numeric, R2: Numeric, radius: float
) -> tuple[Numeric, Numeric, Numeric]:
    """Tube with ends at axial coordinates z1 <= z2 from the point: potential, axial slope, radial slope over rho.

    With b2 = rho^2 - a^2, R_i^2 = z_i^2 + b2 and i_i = 1/R_i the potential is (2 pi a/b2) (z2/R2 - z1/R1). Beyond an
    end, where the difference cancels and b2 may be negative, it is made rational with q = z2 R1 + z1 R2.
    """
    charge = 2.0 * math.pi * radius
    beyond = z1 * z2 > 0.0
    sum_of_roots = R1 + R2
    denominator = select(beyond, z2 * R1 + z1 * R2, b2)
    over = 1.0 / (denominator * sum_of_roots)
    inverse = over * sum_of_roots
    # (z2 - z1) (z2 + z1) = R2^2 - R1^2
    imbalance = charge * (z2 - z1) * (z1 + z2) * (i1 * i2)
    rational = imbalance * inverse
    radial_beyond = -rational * (i1 * i1 + i2 * i2 + (z2 * i1 + z1 * i2) * inverse)
    f1 = z1 * i1
    f2 = z2 * i2
    radial_beside = -charge * inverse * inverse * (f2 * (2.0 + b2 * i2 * i2) - f1 * (2.0 + b2 * i1 * i1))
    axial = imbalance * (i1 * i1 + i1 * i2 + i2 * i2) * (over * denominator)
    potential = select(beyond, rational, charge * inverse * (f2 - f1))
    return potential, axial, select(beyond, radial_beyond, radial_beside)


@inlined
def _half_sphere(rr: Numeric, i: Numeric, radius: float) -> tuple[Numeric, Numeric]:
    """Half a charged sphere's field outside, from r^2 and i = 1/sqrt(r^2 - a^2): potential, slope over r."""
    j = inverse_root(rr)
    square = i * i * j * j
    potential = 2.0 * math.pi * radius * radius * (i * i * j)
    return potential, -potential * (3.0 * rr - radius * radius) * square


@inlined
def _capsule(
    p: tuple[Numeric, Numeric, Numeric], p0: Vector3, p1: Vector3, radius: float
) -> tuple[Numeric, Numeric, Numeric, Numeric, Numeric]:
    """Potential, gradient (3) and the distance from the axis segment."""
    ax, ay, az = p1[0] - p0[0], p1[1] - p0[1], p1[2] - p0[2]
    length = math.sqrt(ax * ax + ay * ay + az * az)
    over = 1.0 / length if length > 0.0 else 0.0 * length
    u = (ax * over, ay * over, az * over)
    dx, dy, dz = p[0] - p0[0], p[1] - p0[1], p[2] - p0[2]
    s = dx * u[0] + dy * u[1] + dz * u[2]
    excess = s - select(s < 0.0, 0.0 * s, select(s > length, length, s))
    wx, wy, wz = dx - s * u[0], dy - s * u[1], dz - s * u[2]
    square = wx * wx + wy * wy + wz * wz + excess * excess
    # So near that rounding would choose the direction, which then need not be across the axis.
    tolerance = _ON_AXIS if is_double(s) else _ON_AXIS_SINGLE
    on_axis = square <= tolerance * (dx * dx + dy * dy + dz * dz + length * length)
    vx, vy, vz = _across(u)
    wx, wy, wz = select(on_axis, vx, wx), select(on_axis, vy, wy), select(on_axis, vz, wz)
    used = select(on_axis, vx * vx + vy * vy + vz * vz, square)
    nearness = inverse_root(used)
    distance = used * nearness
    # Out to the shell, away from the nearest point of the axis.
    shell = (1.0 + CAPSULE_SHELL) * radius
    scale = select(on_axis | (distance < shell), shell * nearness, 1.0)
    s += (scale - 1.0) * excess
    wx, wy, wz = scale * wx, scale * wy, scale * wz
    across_square = wx * wx + wy * wy + wz * wz
    rr1 = s * s + across_square
    rr2 = (length - s) * (length - s) + across_square
    b2 = across_square - radius * radius
    b1 = s * s + b2
    b3 = (length - s) * (length - s) + b2
    i1 = inverse_root(b1)
    i2 = inverse_root(b3)
    tube, axial, radial = _tube(-s, length - s, b2, i1, i2, b1 * i1, b3 * i2, radius)
    cap1, slope1 = _half_sphere(rr1, i1, radius)
    cap2, slope2 = _half_sphere(rr2, i2, radius)
    across = radial + slope1 + slope2
    along = axial + slope1 * s + slope2 * (s - length)
    gx, gy, gz = across * wx + along * u[0], across * wy + along * u[1], across * wz + along * u[2]
    return tube + cap1 + cap2, gx, gy, gz, select(on_axis, 0.0, distance)


@inlined
def charged_capsule_at(p: Any, p0: Vector3, p1: Vector3, radius: float) -> Six:
    """Return the field of a capsule of unit charge per area: `capsule_at`, curvature and winding number.

    The curvature is that of the law c/d with this potential and this slope, 2 |grad Phi|^2 / Phi, which the capsule
    follows near its surface; it is never negative.
    """
    potential, gx, gy, gz, distance = _capsule(p, p0, p1, radius)
    curvature = 2.0 * (gx * gx + gy * gy + gz * gz) / potential
    return potential, gx, gy, gz, curvature, winding_behind(distance - radius)


@inlined
def capsule_at(
    x: float, y: float, z: float, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float, radius: float
) -> tuple[float, float, float, float]:
    """Return potential [1/m] and gradient (3) [1/m^2] of a capsule of unit charge per area; its ends may be the same.

    Nearer than `CAPSULE_SHELL` radii to the surface, and inside, both are those at that distance from it, on the ray
    from the nearest point of the axis: finite, continuous except at the two ends of the axis, and pointing outwards (on
    the axis itself across it, in an arbitrary direction). There the gradient is not the derivative of the potential,
    which is constant along the ray.
    """
    potential, gx, gy, gz, _ = _capsule((x, y, z), (x0, y0, z0), (x1, y1, z1), radius)
    return potential, gx, gy, gz


@inlined
def sphere_at(p: Any, centre: Vector3, radius: float) -> Six:
    """Return the field of a sphere (a shell) of unit charge per area at a point, numbers or vectors [m].

    The potential is 4 pi a^2 / (r (r^2 - a^2)) outside and 4 pi a / (a^2 - r^2) inside, where the field is finite and
    pushes towards the centre, as that of a closed mesh does. The curvature is its second derivative along the radius,
    positive. The winding number is 1 inside, 1/2 on the sphere, else 0. On the sphere itself all are finite.
    """
    dx, dy, dz = p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]
    rr = dx * dx + dy * dy + dz * dz
    r = root(rr)
    aa = radius * radius
    outside = r >= radius
    far = select(outside, r, radius)
    over = 1.0 / (positive(r - radius) * (r + radius))
    inverse = 1.0 / far
    potential = 4.0 * math.pi * radius * over * (radius * inverse)
    square = inverse * inverse
    slope = potential * over * select(outside, -(3.0 - aa * square), 2.0)
    spread = select(outside, 12.0 * rr - 6.0 * aa + 2.0 * aa * aa * square, 2.0 * aa + 6.0 * rr)
    return potential, slope * dx, slope * dy, slope * dz, potential * (over * over) * spread, winding_behind(r - radius)


@inlined
def plane_at(p: Any, normal: Vector3, offset: float) -> Six:
    """Return the field of an infinite plane of unit charge per area, the boundary of the half-space behind it.

    The potential is 2 pi/h, h the distance from the plane, the curvature 4 pi/h^3. The winding number is that of the
    half-space: 1 behind the plane, 1/2 on it, else 0. On the plane itself all are finite.
    """
    height = normal[0] * p[0] + normal[1] * p[1] + normal[2] * p[2] - offset
    over = 1.0 / positive(height)
    potential = 2.0 * math.pi * over
    curvature = 2.0 * potential * (over * over)
    slope = -0.5 * curvature * height
    return potential, slope * normal[0], slope * normal[1], slope * normal[2], curvature, winding_behind(height)


FAR = 1.8
"""Distance from the centre, over half the diagonal, from which no face has half a solid angle of pi/8: it may grow,
which costs time; with less the shorter forms are wrong."""

CENTRE, AXES, HALVES, CHARGE, FAR_SQUARE, BOX_COLUMNS = 0, 3, 12, 15, 16, 17
"""Columns of a box: centre (3), unit axes from the longest side to the shortest (3 x 3), half sides (3) [m], charge,
the square of the distance from its centre that is `FAR` [m^2]; then how many columns there are."""


@inlined
def _along(box: Any, axis: int, dx: Any, dy: Any, dz: Any) -> Any:
    at = AXES + 3 * axis
    return dx * box[at] + dy * box[at + 1] + dz * box[at + 2]


@inlined
def _edges(far: bool, na: Any, fa: Any, r1: Any, l1n: Any, l1f: Any, r2: Any, l2n: Any, l2f: Any) -> tuple[Any, Any]:
    """Products l l' + a.a' of two parallel edges, a and a' vectors to their ends, good beside the edges too."""
    m = na * fa
    g1 = l1n * l1f
    g2 = l2n * l2f
    if far:
        k1, k2 = g1 + (m + r1), g2 + (m + r2)
    else:
        between = m < 0.0
        d1 = g1 - m
        d2 = g2 - m
        over = 1.0 / (d1 * d2)
        squares = na * na + fa * fa
        k1 = r1 + select(between, r1 * (squares + r1) * (over * d2), g1 + m)
        k2 = r2 + select(between, r2 * (squares + r2) * (over * d1), g2 + m)
    return k1, k2


@inlined
def _half(lC: Any, lY: Any, lZ: Any, k: Any, e: Any) -> Any:
    """D of a right triangle with the right angle at C, k of its longer leg C Y, e = (Z - C).C."""
    return k * (lC + lZ) + e * (lC + lY)


@inlined
def _face(
    far: bool, height: Any, u: Any, v: Any, a: Any, b: Any, lengths: Any, kn: Any, kf: Any, c: Any,
) -> tuple[Any, Any, tuple[Any, Any, Any, Any]]:  # fmt: skip
    """Phi, curvature and the sums c with a face's share added.

    u = (n, f) offsets along the longer side of length 2 a, v along the other of length 2 b; lengths: distances of the
    corners (n,n), (f,n), (n,f), (f,f); kn and kf: of the longer edges at vn and vf.
    """
    un, uf = u
    vn, vf = v
    nn, fn, nf, ff = lengths
    twice = b + b
    area = (a + a) * twice
    D1 = _half(nn, fn, nf, kn, twice * vn)
    D2 = _half(ff, nf, fn, kf, -twice * vf)
    hh = height * height
    if far:
        phi, curvature, slope1, slope2 = flat_pair(hh, D1, D2, area, area)
    else:
        phi, curvature, slope1, slope2 = pair_field(height, D1, D2, area, area)
    pu = hh + un * uf
    pv = vn * vf
    q1 = nn * (fn + nf) + fn * nf
    q2 = ff * (fn + nf) + fn * nf
    cnn = c[0] + slope1 * (q1 + pu + pv)
    cfn = c[1] + slope1 * (q1 + hh + un * un + pv) + slope2 * (q2 + pu + vf * vf)
    cnf = c[2] + slope1 * (q1 + pu + vn * vn) + slope2 * (q2 + hh + uf * uf + pv)
    cff = c[3] + slope2 * (q2 + pu + pv)
    return phi, curvature, (cnn, cfn, cnf, cff)


@inlined
def box_at(x: Any, y: Any, z: Any, box: Any) -> tuple[Any, Any, Any, Any, Any, Any]:  # noqa: PLR0915
    """Return the field of a box of unit charge per area, a row (BOX_COLUMNS,), at points: as `sphere_at`."""
    dx, dy, dz = x - box[CENTRE], y - box[CENTRE + 1], z - box[CENTRE + 2]
    p1, p2, p3 = _along(box, 0, dx, dy, dz), _along(box, 1, dx, dy, dz), _along(box, 2, dx, dy, dz)
    a1, a2, a3 = box[HALVES], box[HALVES + 1], box[HALVES + 2]
    far = every(p1 * p1 + p2 * p2 + p3 * p3 > box[FAR_SQUARE])
    n1, n2, n3 = p1 - a1, p2 - a2, p3 - a3
    f1, f2, f3 = p1 + a1, p2 + a2, p3 + a3
    N1, N2, N3 = n1 * n1, n2 * n2, n3 * n3
    F1, F2, F3 = f1 * f1, f2 * f2, f3 * f3
    NN, NF, FN, FF = N2 + N3, N2 + F3, F2 + N3, F2 + F3
    gap = smallest_gap(x)
    M1, G1 = N1 + gap * gap, F1 + gap * gap
    s = M1 + NN
    innn = inverse_root(s)
    lnnn = s * innn
    s = M1 + NF
    innf = inverse_root(s)
    lnnf = s * innf
    s = M1 + FN
    infn = inverse_root(s)
    lnfn = s * infn
    s = M1 + FF
    inff = inverse_root(s)
    lnff = s * inff
    s = G1 + NN
    ifnn = inverse_root(s)
    lfnn = s * ifnn
    s = G1 + NF
    ifnf = inverse_root(s)
    lfnf = s * ifnf
    s = G1 + FN
    iffn = inverse_root(s)
    lffn = s * iffn
    s = G1 + FF
    ifff = inverse_root(s)
    lfff = s * ifff
    knn, knf = _edges(far, n1, f1, NN, lnnn, lfnn, NF, lnnf, lfnf)
    kfn, kff = _edges(far, n1, f1, FN, lnfn, lffn, FF, lnff, lfff)
    o = 0.0 * x
    # faces across axis 3: (1, 2) near and far
    u1, u2, u3 = (n1, f1), (n2, f2), (n3, f3)
    phi, k3n, (cnnn, cfnn, cnfn, cffn) = _face(
        far, n3, u1, u2, a1, a2, (lnnn, lfnn, lnfn, lffn), knn, kfn, (o, o, o, o)
    )
    add, k3f, (cnnf, cfnf, cnff, cfff) = _face(
        far, f3, u1, u2, a1, a2, (lnnf, lfnf, lnff, lfff), knf, kff, (o, o, o, o)
    )
    phi = phi + add
    add, k2n, (cnnn, cfnn, cnnf, cfnf) = _face(
        far, n2, u1, u3, a1, a3, (lnnn, lfnn, lnnf, lfnf), knn, knf, (cnnn, cfnn, cnnf, cfnf)
    )
    phi = phi + add
    add, k2f, (cnfn, cffn, cnff, cfff) = _face(
        far, f2, u1, u3, a1, a3, (lnfn, lffn, lnff, lfff), kfn, kff, (cnfn, cffn, cnff, cfff)
    )
    phi = phi + add
    knn, knf = _edges(far, n2, f2, N1 + N3, lnnn, lnfn, N1 + F3, lnnf, lnff)
    kfn, kff = _edges(far, n2, f2, F1 + N3, lfnn, lffn, F1 + F3, lfnf, lfff)
    add, k1n, (cnnn, cnfn, cnnf, cnff) = _face(
        far, n1, u2, u3, a2, a3, (lnnn, lnfn, lnnf, lnff), knn, knf, (cnnn, cnfn, cnnf, cnff)
    )
    phi = phi + add
    add, k1f, (cfnn, cffn, cfnf, cfff) = _face(
        far, f1, u2, u3, a2, a3, (lfnn, lffn, lfnf, lfff), kfn, kff, (cfnn, cffn, cfnf, cfff)
    )
    phi = phi + add
    cnnn, cnnf, cnfn, cnff = cnnn * innn, cnnf * innf, cnfn * infn, cnff * inff
    cfnn, cfnf, cffn, cfff = cfnn * ifnn, cfnf * ifnf, cffn * iffn, cfff * ifff
    cn3, cf3 = cnnn + cfnn + cnfn + cffn, cnnf + cfnf + cnff + cfff
    cn2, cf2 = cnnn + cfnn + cnnf + cfnf, cnfn + cffn + cnff + cfff
    cn1, cf1 = cnnn + cnfn + cnnf + cnff, cfnn + cffn + cfnf + cfff
    g1 = -n1 * (cn1 + 0.5 * k1n) - f1 * (cf1 + 0.5 * k1f)
    g2 = -n2 * (cn2 + 0.5 * k2n) - f2 * (cf2 + 0.5 * k2f)
    g3 = -n3 * (cn3 + 0.5 * k3n) - f3 * (cf3 + 0.5 * k3f)
    gx = g1 * box[AXES] + g2 * box[AXES + 3] + g3 * box[AXES + 6]
    gy = g1 * box[AXES + 1] + g2 * box[AXES + 4] + g3 * box[AXES + 7]
    gz = g1 * box[AXES + 2] + g2 * box[AXES + 5] + g3 * box[AXES + 8]
    inside = winding_behind(n1) * winding_behind(-f1) * winding_behind(n2) * winding_behind(-f2)
    inside = inside * (winding_behind(n3) * winding_behind(-f3))
    return phi, gx, gy, gz, k1n + k1f + k2n + k2f + k3n + k3f, inside
