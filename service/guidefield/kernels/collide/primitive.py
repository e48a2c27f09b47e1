"""Primitives for lanes: what they are as numbers, and which of sixteen points are near one."""

from __future__ import annotations

from guidefield.kernels.jit.signatures import Floats32, lane_part
from guidefield.kernels.simd.vector import Vector, below, largest_of, magnitude, root, smallest_of, splat

BOX, CYLINDER, CAPSULE, HALF_SPACE = range(4)
"""Kinds of primitives; a ball is a capsule of no length."""

PRIMITIVE = 16
"""Numbers of a primitive: three axes (rows of the rotation from the world), centre, half extents, radius.

A box has three half extents; a cylinder (flat ends) and a capsule have the half length of the axis as third and a
radius; of a half-space the third axis is the normal, and the centre is a point of its boundary.
"""


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
    out = largest_of(root(across) - radius, zero)
    beyond = largest_of(magnitude(w) - half, zero)
    return int(below(out * out + beyond * beyond, splat(reach * reach)))
