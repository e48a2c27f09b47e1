"""Angles and rotations of SIMD batches: sine and cosine, rotation vectors from matrices and quaternions, and back.

What both precisions have is one function of two ways, of which the lanes' precision chooses when a kernel is compiled.
Collision tests rely on its accuracy in float32: placements may be off by `DECISION_BAND` of
`kernels/collide/layout.py`.
"""

from __future__ import annotations

import math
from typing import Any

from guidefield.kernels.jit.decorators import vector_part
from guidefield.kernels.simd.vector import is_double, magnitude, rint, root, select

_ROUNDING = 6755399441055744.0  # 1.5 * 2^52: what is added to it is rounded to a whole number, to even from the middle

# pi / 2 in three parts, the first two with few enough digits that small multiples are exact (Cody and Waite).
_QUARTER_HIGH = 1.5707963267341256
_QUARTER_MIDDLE = 6.077100506303966e-11
_QUARTER_LOW = 2.0222662487959506e-21
_PER_QUARTER = 2.0 / math.pi

# 2 pi in two parts, the first with so few digits that small multiples are exact in float32 (Cody and Waite).
_TURN_HIGH = 6.28125
_TURN_LOW = 2.0 * math.pi - _TURN_HIGH
_PER_TURN = 1.0 / (2.0 * math.pi)

_EIGHTH = math.tan(math.pi / 8.0)  # above this ratio an arctangent is reduced by an eighth of a turn
_SMALL = 1e-9  # below this sine or angle a quotient is its limit
_SMALL_ANGLE = 0.1  # below this angle a rate is its series [rad], to 1e-11; more is less exact, less loses digits


@vector_part
def _round(x: Any) -> Any:
    return (x + _ROUNDING) - _ROUNDING


@vector_part
def _cosine_and_sine_64(angle: Any) -> tuple[Any, Any]:
    """`cosine_and_sine` in double precision.

    The angle is reduced to an eighth of a turn about a multiple of a quarter; there sine and cosine are the Cephes
    library's polynomials (S. Moshier).
    """
    quarters = _round(angle * _PER_QUARTER)
    r = angle - quarters * _QUARTER_HIGH
    r = r - quarters * _QUARTER_MIDDLE
    r = r - quarters * _QUARTER_LOW
    u = r * r
    s = u * 1.58962301576546568060e-10 - 2.50507477628578072866e-8
    s = s * u + 2.75573136213857245213e-6
    s = s * u - 1.98412698295895385996e-4
    s = s * u + 8.33333333332211858878e-3
    s = s * u - 1.66666666666666307295e-1
    s = r + r * u * s
    c = u * -1.13585365213876817300e-11 + 2.08757008419747316778e-9
    c = c * u - 2.75573141792967388112e-7
    c = c * u + 2.48015872888517045348e-5
    c = c * u - 1.38888888888730564116e-3
    c = c * u + 4.16666666666665929218e-2
    c = 1.0 - 0.5 * u + u * u * c
    turned = quarters - 4.0 * _round(0.25 * quarters)
    odd, half = magnitude(turned) == 1.0, magnitude(turned) == 2.0
    sine, cosine = select(odd, c, s), select(odd, s, c)
    return (select(half | (turned == 1.0), -1.0 * cosine, cosine), select(half | (turned == -1.0), -1.0 * sine, sine))


@vector_part
def _polynomials(u: Any) -> tuple[Any, Any]:
    """(sin h - h) / h^3 and cos h for u = h^2, h within [-pi/2, pi/2].

    The polynomials of least greatest error there, to h^11 and h^10, give sin h to 2e-10 and cos h to 1e-9.
    """
    s = u * -2.4079801291588433e-08 + 2.7536450235908687e-06
    s = s * u - 0.00019841086446711044
    s = s * u + 0.008333332768635793
    s = s * u - 0.16666666663883803
    c = u * -2.629712856113701e-07 + 2.4774568152524807e-05
    c = c * u - 0.0013888651585786435
    c = c * u + 0.04166665936278864
    c = c * u - 0.49999999964019176
    return s, c * u + 1.0


@vector_part
def _cosine_and_sine_32(angle: Any) -> tuple[Any, Any]:
    """`cosine_and_sine` in single precision.

    With h half of the angle, reduced to [-pi/2, pi/2], sin = 2 sin h cos h and cos = 1 - 2 sin^2 h.
    """
    turns = rint(angle * _PER_TURN)
    half = (angle - turns * _TURN_HIGH - turns * _TURN_LOW) * 0.5
    u = half * half
    s, c = _polynomials(u)
    s = half + half * u * s
    return 1.0 - 2.0 * s * s, 2.0 * s * c


@vector_part
def cosine_and_sine(angle: Any) -> tuple[Any, Any]:
    """Cosine and sine [rad]: each to 2e-16 for angles within 1e5; in single precision to 5e-7 for such within 1000."""
    return _cosine_and_sine_64(angle) if is_double(angle) else _cosine_and_sine_32(angle)


@vector_part
def _angle_of(sine: Any, cosine: Any) -> Any:
    """The angle in [0, pi/2] whose sine and cosine, neither negative, have this ratio (arctangent as in Cephes)."""
    steep = sine > cosine
    ratio = select(steep, cosine, sine) / select(steep, sine, cosine)
    large = ratio > _EIGHTH
    x = select(large, (ratio - 1.0) / (ratio + 1.0), ratio)
    z = x * x
    p = z * -8.750608600031904122785e-1 - 1.615753718733365076637e1
    p = p * z - 7.500855792314704667340e1
    p = p * z - 1.228866684490136173410e2
    p = p * z - 6.485021904942025371773e1
    q = z + 2.485846490142306297962e1
    q = q * z + 1.650270098316988542046e2
    q = q * z + 4.328810604912902668951e2
    q = q * z + 4.853903996359136964868e2
    q = q * z + 1.945506571482613964425e2
    angle = x + x * (z * p / q)
    angle = select(large, angle + 0.25 * math.pi, angle)
    return select(steep, 0.5 * math.pi - angle, angle)


@vector_part
def vector_of_quaternion(x: Any, y: Any, z: Any, w: Any) -> tuple[Any, Any, Any, Any, Any]:
    """Rotation vector of a unit quaternion, at most pi long [rad], and what its rate needs.

    Returns:
        The vector v (3), its squared length, and (1 - |v|/2 cot(|v|/2)) / |v|^2, the last coefficient of the inverse
        left Jacobian of the exponential map, 1 - [v]/2 + that [v]^2.
    """
    back = w < 0.0
    x, y, z = select(back, -1.0 * x, x), select(back, -1.0 * y, y), select(back, -1.0 * z, z)
    w = magnitude(w)
    sine = root(x * x + y * y + z * z)
    angle = 2.0 * _angle_of(sine, w)
    scale = select(sine > _SMALL, angle / sine, 2.0 / w)
    square = angle * angle
    series = (square * (1.0 / 30240.0) + 1.0 / 720.0) * square + 1.0 / 12.0
    rate = select(angle > _SMALL_ANGLE, (1.0 - 0.5 * angle * w / sine) / square, series)
    return scale * x, scale * y, scale * z, square, rate


@vector_part
def _quaternion_64(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any, Any]:
    """`quaternion_of_vector` in double precision."""
    angle = root(x * x + y * y + z * z)
    c, s = cosine_and_sine(0.5 * angle)
    scale = select(angle > _SMALL, s / angle, 0.5)
    return scale * x, scale * y, scale * z, c


@vector_part
def _quaternion_32(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any, Any]:
    """`quaternion_of_vector` in single precision.

    With k a quarter of the angle a, sin(a / 2) / a = sin k cos k / (2 k) and cos(a / 2) = 1 - 2 sin^2 k: no root and no
    division is needed.
    """
    u = (x * x + y * y + z * z) * 0.0625
    s, c = _polynomials(u)
    s = s * u + 1.0
    scale = s * c * 0.5
    return x * scale, y * scale, z * scale, 1.0 - 2.0 * u * s * s


@vector_part
def quaternion_of_vector(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any, Any]:
    """Unit quaternion (x, y, z, w) of a rotation vector [rad]; in single precision to 5e-7, of up to a full turn."""
    return _quaternion_64(x, y, z) if is_double(x) else _quaternion_32(x, y, z)


@vector_part
def quaternion_product(a: Any, b: Any) -> tuple[Any, Any, Any, Any]:
    """Product of two quaternions (x, y, z, w): b is turned by a."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


@vector_part
def quaternion_of_matrix(m: Any) -> tuple[Any, Any, Any, Any]:
    """Unit quaternion (x, y, z, w) of a rotation matrix given row by row, from its largest component."""
    t = 1.0 + m[0] + m[4] + m[8]
    x, y, z, w = m[7] - m[5], m[2] - m[6], m[3] - m[1], t
    a, b, c = m[3] + m[1], m[2] + m[6], m[7] + m[5]
    tx = 1.0 + m[0] - m[4] - m[8]
    larger = tx > t
    t = select(larger, tx, t)
    x, y, z, w = select(larger, tx, x), select(larger, a, y), select(larger, b, z), select(larger, m[7] - m[5], w)
    ty = 1.0 - m[0] + m[4] - m[8]
    larger = ty > t
    t = select(larger, ty, t)
    x, y, z, w = select(larger, a, x), select(larger, ty, y), select(larger, c, z), select(larger, m[2] - m[6], w)
    tz = 1.0 - m[0] - m[4] + m[8]
    larger = tz > t
    t = select(larger, tz, t)
    x, y, z, w = select(larger, b, x), select(larger, c, y), select(larger, tz, z), select(larger, m[3] - m[1], w)
    scale = 0.5 / root(t)
    return scale * x, scale * y, scale * z, scale * w
