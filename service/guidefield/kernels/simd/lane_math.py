"""Sine and cosine of sixteen angles, and which of sixteen points are near a primitive, on the lane type."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from guidefield.kernels.simd.f32x16 import (
    Vector,
    below,
    lane_part,
    largest_of,
    magnitude,
    rint,
    smallest_of,
    splat,
    sqrt,
)

Floats32 = NDArray[np.float32]

BOX, CYLINDER, CAPSULE, HALF_SPACE = range(4)
"""Kinds of primitives; a ball is a capsule of no length."""

PRIMITIVE = 16
"""Numbers of a primitive: three axes (rows of the rotation from the world), centre, half extents, radius.

A box has three half extents; a cylinder (flat ends) and a capsule have the half length of the axis as third and a
radius; of a half-space the third axis is the normal, and the centre is a point of its boundary.
"""

# 2 pi in two parts, the first with so few digits that small multiples are exact in float32 (Cody and Waite).
_TURN_HIGH = 6.28125
_TURN_LOW = 2.0 * math.pi - _TURN_HIGH
_PER_TURN = 1.0 / (2.0 * math.pi)


@lane_part
def _polynomials(u: Vector) -> tuple[Vector, Vector]:
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


@lane_part
def cosine_and_sine(angle: Vector) -> tuple[Vector, Vector]:
    """Cosine and sine [rad], each to 5e-7 for angles within 1000.

    With h half of the angle, reduced to [-pi/2, pi/2], sin = 2 sin h cos h and cos = 1 - 2 sin^2 h.
    """
    turns = rint(angle * _PER_TURN)
    half = (angle - turns * _TURN_HIGH - turns * _TURN_LOW) * 0.5
    u = half * half
    s, c = _polynomials(u)
    s = half + half * u * s
    return 1.0 - 2.0 * s * s, 2.0 * s * c


@lane_part
def quaternion_of(x: Vector, y: Vector, z: Vector) -> tuple[Vector, Vector, Vector, Vector]:
    """Unit quaternion (x, y, z, w) of rotation vectors up to a full turn long, each number to 5e-7.

    With k a quarter of the angle a, sin(a / 2) / a = sin k cos k / (2 k) and cos(a / 2) = 1 - 2 sin^2 k: no root and no
    division is needed.

    Args:
        x: The vectors' first numbers [rad], with y and z.
        y: See x.
        z: See x.
    """
    u = (x * x + y * y + z * z) * 0.0625
    s, c = _polynomials(u)
    s = s * u + 1.0
    scale = s * c * 0.5
    return x * scale, y * scale, z * scale, 1.0 - 2.0 * u * s * s


@lane_part
def near_primitive(kind: int, primitives: Floats32, at: int, x: Vector, y: Vector, z: Vector, reach: float) -> int:
    """Mask of the points closer than `reach` to a primitive, or in it.

    Args:
        kind: Of the primitive.
        primitives: Numbers of all primitives, shape (PRIMITIVE * n,).
        at: Where its numbers begin.
        x: Sixteen points in the world [m], with y and z.
        y: See x.
        z: See x.
        reach: Distance [m].
    """
    dx = x - primitives[at + 9]
    dy = y - primitives[at + 10]
    dz = z - primitives[at + 11]
    w = dx * primitives[at + 6] + dy * primitives[at + 7] + dz * primitives[at + 8]
    if kind == HALF_SPACE:
        return int(below(w, splat(reach)))
    zero = splat(0.0)
    if kind == BOX:
        u = dx * primitives[at] + dy * primitives[at + 1] + dz * primitives[at + 2]
        v = dx * primitives[at + 3] + dy * primitives[at + 4] + dz * primitives[at + 5]
        u = largest_of(magnitude(u) - primitives[at + 12], zero)
        v = largest_of(magnitude(v) - primitives[at + 13], zero)
        w = largest_of(magnitude(w) - primitives[at + 14], zero)
        return int(below(u * u + v * v + w * w, splat(reach * reach)))
    half, radius = primitives[at + 14], primitives[at + 15]
    along = w
    if kind == CAPSULE:
        along = largest_of(smallest_of(w, splat(half)), splat(-half))
        reach += radius
    px = dx - along * primitives[at + 6]
    py = dy - along * primitives[at + 7]
    pz = dz - along * primitives[at + 8]
    across = px * px + py * py + pz * pz
    if kind == CAPSULE:
        return int(below(across, splat(reach * reach)))
    out = largest_of(sqrt(across) - radius, zero)
    beyond = largest_of(magnitude(w) - half, zero)
    return int(below(out * out + beyond * beyond, splat(reach * reach)))
