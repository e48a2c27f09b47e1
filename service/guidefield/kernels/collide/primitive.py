"""Primitives for lanes: what they are as numbers, which of sixteen points are near one, and axes away from it."""

from __future__ import annotations

from guidefield.kernels.jit.signatures import Floats32, Vector3, lane_part
from guidefield.kernels.simd.vector import Vector, below, largest_of, magnitude, root, smallest_of, splat

BOX, CYLINDER, CAPSULE, HALF_SPACE = range(4)
"""Kinds of primitives; a ball is a capsule of no length."""

AXES, CENTRE, HALVES, ROUND, PRIMITIVE = 0, 9, 12, 15, 16
"""Numbers of a primitive: three axes (rows of the rotation from the world), centre, half extents, radius; then how many
numbers there are.

A box has three half extents; a cylinder (flat ends) and a capsule have the half length of the axis as third and a
radius; of a half-space the third axis is the normal, and the centre is a point of its boundary.
"""

HALF_LENGTH = HALVES + 2
"""Place of the half length of a cylinder or a capsule."""


@lane_part
def _three(primitives: Floats32, at: int) -> Vector3:
    """Three numbers that stand together."""
    return primitives[at], primitives[at + 1], primitives[at + 2]


@lane_part
def _axis(primitives: Floats32, at: int, k: int) -> Vector3:
    """An axis of a primitive whose numbers begin there, by its number."""
    return _three(primitives, at + AXES + 3 * k)


@lane_part
def _beyond(value: Vector, half: float) -> Vector:
    """By how much a value is beyond +-half, with its sign; 0 within."""
    return value - largest_of(smallest_of(value, splat(half)), splat(-half))


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
    cx, cy, cz = _three(primitives, at + CENTRE)
    ax, ay, az = _axis(primitives, at, 2)
    dx, dy, dz = x - cx, y - cy, z - cz
    w = dx * ax + dy * ay + dz * az
    if kind == HALF_SPACE:
        return int(below(w, splat(reach)))
    zero = splat(0.0)
    if kind == BOX:
        ux, uy, uz = _axis(primitives, at, 0)
        vx, vy, vz = _axis(primitives, at, 1)
        hu, hv, hw = _three(primitives, at + HALVES)
        u = largest_of(magnitude(dx * ux + dy * uy + dz * uz) - hu, zero)
        v = largest_of(magnitude(dx * vx + dy * vy + dz * vz) - hv, zero)
        w = largest_of(magnitude(w) - hw, zero)
        return int(below(u * u + v * v + w * w, splat(reach * reach)))
    half, radius = primitives[at + HALF_LENGTH], primitives[at + ROUND]
    along = w
    if kind == CAPSULE:
        along = largest_of(smallest_of(w, splat(half)), splat(-half))
        reach += radius
    px, py, pz = dx - along * ax, dy - along * ay, dz - along * az
    across = px * px + py * py + pz * pz
    if kind == CAPSULE:
        return int(below(across, splat(reach * reach)))
    out = largest_of(root(across) - radius, zero)
    beyond = largest_of(magnitude(w) - half, zero)
    return int(below(out * out + beyond * beyond, splat(reach * reach)))


@lane_part
def away_from_primitive(
    kind: int, primitives: Floats32, at: int, x: Vector, y: Vector, z: Vector
) -> tuple[Vector, Vector, Vector, Vector]:
    """Axes that point from a primitive to points, and how far it reaches along them; arguments as `near_primitive`.

    Returns:
        The axes n in the world, of any length, 0 from points in a box or cylinder; the largest n.p over the points p of
        the primitive.
    """
    cx, cy, cz = _three(primitives, at + CENTRE)
    ax, ay, az = _axis(primitives, at, 2)
    dx, dy, dz = x - cx, y - cy, z - cz
    w = dx * ax + dy * ay + dz * az
    if kind == HALF_SPACE:
        one = splat(1.0)
        nx, ny, nz, reach = one * ax, one * ay, one * az, splat(0.0)
    elif kind == BOX:
        ux, uy, uz = _axis(primitives, at, 0)
        vx, vy, vz = _axis(primitives, at, 1)
        hu, hv, hw = _three(primitives, at + HALVES)
        u = _beyond(dx * ux + dy * uy + dz * uz, hu)
        v = _beyond(dx * vx + dy * vy + dz * vz, hv)
        w = _beyond(w, hw)
        nx, ny, nz = u * ux + v * vx + w * ax, u * uy + v * vy + w * ay, u * uz + v * vz + w * az
        reach = magnitude(u) * hu + magnitude(v) * hv + magnitude(w) * hw
    else:
        half, radius = primitives[at + HALF_LENGTH], primitives[at + ROUND]
        beyond = _beyond(w, half)
        along = w - beyond if kind == CAPSULE else w
        nx, ny, nz = dx - along * ax, dy - along * ay, dz - along * az
        off = nx * ax + ny * ay + nz * az  # what rounding leaves along the axis, which counts `half` times
        if kind == CAPSULE:
            beyond = off
        else:
            nx, ny, nz = nx - off * ax, ny - off * ay, nz - off * az
        length = root(nx * nx + ny * ny + nz * nz)
        reach = magnitude(beyond) * half + length * radius
        if kind != CAPSULE:  # a cylinder: all times `length`
            out = largest_of(length - radius, splat(0.0))
            beyond = beyond * length
            nx, ny, nz = nx * out + beyond * ax, ny * out + beyond * ay, nz * out + beyond * az
            reach = magnitude(beyond) * half + length * out * radius
    return nx, ny, nz, reach + nx * cx + ny * cy + nz * cz
