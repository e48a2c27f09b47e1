"""Potential and curvature of flat polygons from half their solid angle, given as a complex number; in lanes.

A triangle of area A_k has half the solid angle arg(D_k + i a_k h), with a_k = 2 A_k and the D_k of kernels/faces.py.
That of two triangles in one plane is the argument of the product, so one arctangent serves both. With the product
R + i h B

    Phi = (2/h) atan2(h B, R),      curvature -2 Phi_h/h = 2 (Phi - 2 Q)/h^2,    Q = sum_k a_k D_k / (D_k^2 + a_k^2 h^2)

where Phi_h is the derivative with the height h at constant D_k: the part of the gradient along the normal. Where h B is
small against R both are written without division by h, which may vanish.
"""

from __future__ import annotations

import math
from typing import Any

from guidefield.kernels.point_lanes import is_double, magnitude, select, smallest_gap
from guidefield.kernels.signatures import inlined

_TAN_1 = math.tan(math.pi / 8)
_TAN_3 = math.tan(3 * math.pi / 8)


@inlined
def arctangent_tail(u: Any) -> Any:
    """P in atan(x)/x = 1 + u P(u), u = x^2 <= tan^2(pi/8): Chebyshev interpolation to 2e-18, or 2e-8 in single."""
    if is_double(u):
        # Estrin's scheme: half as deep as Horner's, which the faces of a box would wait for.
        v = u * u
        w = v * v
        low = (0.19999999999999804 * u - 0.3333333333333333) + v * (0.11111111105155447 * u - 0.14285714285659828)
        middle = (0.07692296375032143 * u - 0.09090908753500877) + v * (0.05878928997834775 * u - 0.06666424885738255)
        high = (0.04551593220626549 * u - 0.05230454270650244) + v * (0.016285756855221028 * u - 0.034570561981427744)
        p = low + w * (middle + w * high)
    else:
        p = -0.06451928206172591 * u + 0.10743731490136961
        p = p * u - 0.1426395559791531
        p = p * u + 0.19999540483646502
        p = p * u - 0.333333317611685
    return p


@inlined
def _angle(h: Any, B: Any, R: Any) -> tuple[Any, Any, Any, Any, Any]:
    """Phi, whether it is that of the form without 1/h, that form's t = B/R, the tail of its arctangent, and 1/h."""
    y = h * B
    size = magnitude(R)
    low = y <= _TAN_1 * size
    steep = y > _TAN_3 * size
    # atan(y/|R|) = offset + atan(x), |x| <= tan(pi/8).
    numerator = select(steep, -size, select(low, y, y - size))
    denominator = select(steep, y, select(low, size, y + size))
    both = 1.0 / (denominator * h)
    inverse = both * h
    over_h = both * denominator
    x = numerator * inverse
    u = x * x
    tail = arctangent_tail(u)
    angle = x + x * (u * tail) + select(low, 0.0 * x, select(steep, math.pi / 2, math.pi / 4 + 0.0 * x))
    angle = select(R < 0.0, math.pi - angle, angle)
    flat = low & (R > 0.0)
    t = B * inverse
    return 2.0 * select(flat, t + t * (u * tail), angle * over_h), flat, t, tail, over_h


@inlined
def positive(signed: Any) -> Any:
    """The height that the formulas divide by."""
    h = magnitude(signed)
    gap = smallest_gap(h)
    return select(h > gap, h, gap)


@inlined
def pair_field(h: Any, D1: Any, D2: Any, a1: Any, a2: Any) -> tuple[Any, Any, Any, Any]:
    """Of two triangles in a plane: Phi, its curvature, and -Phi_D = 2 a/(D^2 + a^2 h^2) of each."""
    hh = h * h
    aa = a1 * a2
    Q = aa * hh
    product = D1 * D2
    R = product - Q
    B = a1 * D2 + a2 * D1
    N1 = D1 * D1 + (a1 * a1) * hh
    N2 = D2 * D2 + (a2 * a2) * hh
    over = 1.0 / (N1 * N2)
    phi, flat, t, tail, over_h = _angle(h, B, R)
    first = select(flat, t * t * tail, phi)
    second = select(flat, R, -2.0 * B)
    third = select(flat, B * t - 2.0 * aa, product + Q)
    curvature = select(flat, 4.0 * t, 2.0 * over_h * over_h) * (first + over * second * third)
    return phi, curvature, 2.0 * a1 * over * N2, 2.0 * a2 * over * N1


@inlined
def single_field(h: Any, D: Any, a: Any) -> tuple[Any, Any, Any]:
    """Of one triangle: Phi, its curvature, and -Phi_D = 2 a/(D^2 + a^2 h^2)."""
    phi, flat, t, tail, over_h = _angle(h, a, D)
    slope = 2.0 * a / (D * D + (a * a) * (h * h))
    first = select(flat, t * t * tail, phi)
    third = select(flat, 0.5 * a, -D)
    curvature = select(flat, 4.0 * t, 2.0 * over_h * over_h) * (first + slope * third)
    return phi, curvature, slope
