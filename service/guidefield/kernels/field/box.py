"""Charged boxes at points: six rectangles that share eight distances, one arctangent each; lanes of points.

Where all lanes are `FAR` all faces are flat to them and nothing can cancel, so that the shorter forms serve.
"""

from __future__ import annotations

from typing import Any

from guidefield.kernels.field.primitives import winding_behind
from guidefield.kernels.field.solid_angle import flat_pair, pair_field
from guidefield.kernels.jit.signatures import inlined
from guidefield.kernels.simd.vector import every, inverse_root, select, smallest_gap

FAR = 1.8
"""Distance from the centre, over half the diagonal, from which no face has half a solid angle of pi/8."""


CENTRE, AXES, HALVES, CHARGE, FAR_SQUARE, BOX_COLUMNS = 0, 3, 12, 15, 16, 17
"""Columns of a box: centre (3), unit axes from the longest side to the shortest (3 x 3), half sides (3) [m], charge,
the square of the distance from its centre that is `FAR` [m^2]; then how many columns there are."""


@inlined
def _along(box: Any, axis: int, dx: Any, dy: Any, dz: Any) -> Any:
    """An offset along one of a box's axes."""
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

    u = (n, f) offsets along the longer side of length 2 a, v along the other of length 2 b; lengths: distances
    of the corners (n,n), (f,n), (n,f), (f,f); kn and kf: of the longer edges at vn and vf.
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
    """Field of a box of unit charge per area at points, in the world: as `primitives.sphere_at`.

    Args:
        x: Points [m], with y and z.
        y: See x.
        z: See x.
        box: Row of a table, shape (BOX_COLUMNS,).
    """
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
