"""Overlaps of two convex shapes along candidate directions; the least one is mostly their penetration depth.

`collision/narrow_phase.py` checks Coal's depth by it; where they differ, it descends from the best directions. Each
overlap is right for its direction: further directions can only lower the least. They cost time, and need room there
(`MOST_OTHERS`): nothing checks it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from guidefield.kernels.jit.arrays import Row, RowOut, Rows, RowsOut, Vector3
from guidefield.kernels.jit.decorators import kernel, uncounted

BOX, CYLINDER, HULL, CAPSULE = range(4)
"""Kinds of shapes; a sphere is a capsule without length."""
SHORTEST = 1e-9  # vectors no longer than its square tell no direction: with more, the least overlap may be missed


class ConvexShape(NamedTuple):
    """A convex shape in its own frame."""

    kind: int  # one of those above
    sizes: Row  # half extents of a box; radius and half length of a cylinder or capsule [m], shape (3,)
    rounding: float  # by how much the shape is larger all around [m]
    points: Rows  # corners of a hull, shape (n, 3) [m]
    normals: Rows  # normals of its faces, or its principal axes, shape (m, 3)


class Placed(NamedTuple):
    """Two shapes as they stand."""

    first: ConvexShape
    second: ConvexShape
    here: Rows  # rotations of their frames, shape (3, 3)
    there: Rows
    apart: Row  # from the origin of the first frame to that of the second, shape (3,) [m, world]


@uncounted
def _reach(shape: ConvexShape, rotation: Rows, x: float, y: float, z: float) -> float:
    """Return how far a rotated shape reaches along a unit direction [m]."""
    u = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
    v = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
    w = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
    sizes, reach = shape.sizes, shape.rounding
    if shape.kind == BOX:
        reach += abs(u) * sizes[0] + abs(v) * sizes[1] + abs(w) * sizes[2]
    elif shape.kind == CYLINDER:
        reach += abs(w) * sizes[1] + sizes[0] * math.hypot(u, v)
    elif shape.kind == CAPSULE:
        reach += abs(w) * sizes[1] + sizes[0]
    else:
        most = -math.inf
        for k in range(shape.points.shape[0]):
            most = max(most, shape.points[k, 0] * u + shape.points[k, 1] * v + shape.points[k, 2] * w)
        reach += most
    return reach


@uncounted
def _overlap(placed: Placed, x: float, y: float, z: float) -> float:
    overlap: float = _reach(placed.first, placed.here, x, y, z) + _reach(placed.second, placed.there, -x, -y, -z)
    overlap -= placed.apart[0] * x + placed.apart[1] * y + placed.apart[2] * z
    return overlap


@uncounted
def _try(
    placed: Placed, x: float, y: float, z: float, count: int, directions_out: RowsOut, overlaps_out: RowOut
) -> int:
    """Write a direction of both signs with its overlaps; return how many there are then."""
    most = max(abs(x), abs(y), abs(z), SHORTEST)  # the line between closest points may be of any length
    x, y, z = x / most, y / most, z / most
    length = math.sqrt(x * x + y * y + z * z)
    if not length > SHORTEST:
        return count
    for sign in (1.0 / length, -1.0 / length):
        directions_out[count, 0], directions_out[count, 1], directions_out[count, 2] = sign * x, sign * y, sign * z
        overlaps_out[count] = _overlap(placed, sign * x, sign * y, sign * z)
        count += 1
    return count


@uncounted
def _cross(here: Rows, i: int, there: Rows, j: int) -> Vector3:
    """Return the cross product of two axes, columns of rotations."""
    return (
        here[1, i] * there[2, j] - here[2, i] * there[1, j],
        here[2, i] * there[0, j] - here[0, i] * there[2, j],
        here[0, i] * there[1, j] - here[1, i] * there[0, j],
    )


@kernel
def try_directions(placed: Placed, between: Row, directions_out: RowsOut, overlaps_out: RowOut) -> int:
    """Find by how much shapes overlap along the directions among which the least overlap mostly is, of both signs.

    They are the shapes' axes and faces, cross products of axes, the line between the shapes, and one that is given,
    shape (3,). Writes unit directions (n, 3) [world] and overlaps (n,) [m]; returns how many.
    """
    count = 0
    for shape, rotation in ((placed.first, placed.here), (placed.second, placed.there)):
        for k in range(3):
            count = _try(placed, rotation[0, k], rotation[1, k], rotation[2, k], count, directions_out, overlaps_out)
        for k in range(shape.normals.shape[0]):
            x, y, z = shape.normals[k, 0], shape.normals[k, 1], shape.normals[k, 2]
            count = _try(
                placed,
                rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
                rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
                rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
                count,
                directions_out,
                overlaps_out,
            )
    for i in range(3):
        for j in range(3):
            x, y, z = _cross(placed.here, i, placed.there, j)
            count = _try(placed, x, y, z, count, directions_out, overlaps_out)
    for vector in (placed.apart, between):
        count = _try(placed, vector[0], vector[1], vector[2], count, directions_out, overlaps_out)
    return count


@kernel
def overlap_along(placed: Placed, direction: Row) -> float:
    """Return by how much shapes overlap along a unit direction (3,) [m]."""
    return _overlap(placed, direction[0], direction[1], direction[2])
