"""Potential and curvature of flat polygons from half their solid angle, given as a complex number; in lanes.

A triangle of area A_k has half the solid angle arg(F_k + i a_k h), with the a_k = 4 A_k and F_k of `faces` (or
both halved). That of two triangles in one plane is the argument of the product, so one arctangent serves both. With the
product R + i h B

    Phi = (2/h) atan2(h B, R),      curvature -2 Phi_h/h = 2 (Phi - 2 Q)/h^2,    Q = sum_k a_k F_k / (F_k^2 + a_k^2 h^2)

where Phi_h is the derivative with the height h at constant F_k: the part of the gradient along the normal.

A face is flat to a point that sees half its solid angle under pi/8 at most, a triangle under pi/16. Where it is so to
all lanes, as mostly, the form without division by h serves, which needs neither an octant nor a choice; so the last
digits of a lane's numbers depend on the lanes beside it.
"""

from __future__ import annotations

import math
from typing import Any

from guidefield.kernels.jit.signatures import inlined
from guidefield.kernels.simd.vector import every, inverse_root, is_double, magnitude, select, smallest_gap

_TAN = math.tan(math.pi / 8)
FLAT = 1.0 / math.tan(math.pi / 16)
"""A triangle is flat to points where h a `FLAT` <= F."""


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
    """`pair_field` of any lanes, from a positive height."""
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
    """`pair_field` of lanes to which the face is flat, from the square of the height, which may vanish."""
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
    """Of two triangles in a plane: Phi, its curvature, and -Phi_F = 2 a/(F^2 + a^2 h^2) of each."""
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
    """Of one triangle, given a, a^2 and a `FLAT`: Phi, its curvature, and -Phi_F = 2 a/(F^2 + a^2 h^2)."""
    h = positive(height)
    return _flat_single(h * h, F, a, aa) if every(h * af <= F) else _steep_single(h, F, a, aa)
