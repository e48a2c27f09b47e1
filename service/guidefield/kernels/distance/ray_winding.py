"""Winding number of a closed surface of triangles about a point: its crossings with a ray, counted with their sign.

If only the part of the surface in a ball is known, a segment to an anchor takes the ray's place: a place in the ball
whose winding number is known (`scene/crop.py`).

Exact, also where pieces overlap or lie in one another: a ray that grazes an edge or a corner as closely as rounding
isn't counted, and another direction is tried. For a surface whose triangles agree about the outside it is 1 within a
solid, 2 where two solids overlap, 0 outside and in hollows.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.distance.triangle_distance import LEAF, Span, SurfaceTables
from guidefield.kernels.jit.arrays import Floats, Rows, Vector3
from guidefield.kernels.jit.decorators import inlined, inner_kernel, kernel
from guidefield.kernels.linalg.small_systems import cross, dot

RAYS = 64  # directions that are tried, at most: with fewer a point counts as outside, or as unsure, more often
GRAZING = 1e-12  # an edge is grazed if the ray passes it closer than this, over the lengths involved; may only grow
GRAZED = 1 << 40  # marks a ray that grazes an edge in a sum of crossings: more than there are

_STACK = 64  # nodes that wait, at most
_FLAT = 1e-12  # least part of a direction along an axis, where boxes are met: smaller ones count as this

BALL, REACH, PLACE, ROOM, TURNS, ANCHOR = 0, 3, 4, 7, 8, 9
"""Columns of anchors: centre and radius of the ball in which all of the surface is there; a place, how far about it is
free of the surface and in the ball [m], and how often the surface winds around it; then how many there are."""


@inlined
def ray_direction(k: int) -> Vector3:
    """The k-th of many unit vectors spread over the sphere, none along an axis or a plane of symmetry."""
    z = 1.0 - 2.0 * ((0.3819 + 0.7548776662466927 * k) % 1.0)
    angle = 2.0 * math.pi * ((0.1234 + 0.5698402909980532 * k) % 1.0)
    rho = math.sqrt(max(0.0, 1.0 - z * z))
    return rho * math.cos(angle), rho * math.sin(angle), z


@inlined
def _meets_box(p: Vector3, inverse: Vector3, length: float, boxes: Floats, i: int) -> bool:
    """Tell if the way from p meets a box; `inverse` is one over its direction."""
    x0, x1 = (boxes[i, 0] - p[0]) * inverse[0], (boxes[i, 3] - p[0]) * inverse[0]
    y0, y1 = (boxes[i, 1] - p[1]) * inverse[1], (boxes[i, 4] - p[1]) * inverse[1]
    z0, z1 = (boxes[i, 2] - p[2]) * inverse[2], (boxes[i, 5] - p[2]) * inverse[2]
    enter = max(min(x0, x1), min(y0, y1), min(z0, z1), 0.0)
    leave = min(max(x0, x1), max(y0, y1), max(z0, z1), length)
    # a flat box that the ray lies in must not be missed by rounding
    meets: bool = boxes[i, 0] <= boxes[i, 3] and enter <= leave + 1e-9 * (abs(enter) + abs(leave))
    return meets


@inlined
def _crossing(p: Vector3, u: Vector3, length: float, corners: Floats, i: int) -> int:
    """1 if the way from p along u leaves through triangle i, -1 if it enters, 0 if it misses; `GRAZED` if in doubt."""
    ab = (corners[i, 3], corners[i, 4], corners[i, 5])
    ac = (corners[i, 6], corners[i, 7], corners[i, 8])
    a = (corners[i, 0] - p[0], corners[i, 1] - p[1], corners[i, 2] - p[2])
    b = (a[0] + ab[0], a[1] + ab[1], a[2] + ab[2])
    c = (a[0] + ac[0], a[1] + ac[1], a[2] + ac[2])
    # volumes spanned by the ray and each edge; their signs agree where the line meets the triangle
    x, y, z = cross(a, b), cross(b, c), cross(c, a)
    f, g, h = dot(u, x), dot(u, y), dot(u, z)
    size = max(dot(a, a), dot(b, b), dot(c, c))
    slack = GRAZING * size
    if (f > slack or g > slack or h > slack) and (f < -slack or g < -slack or h < -slack):
        return 0
    normal = cross(ab, ac)
    height = dot(normal, a)
    if abs(f) <= slack or abs(g) <= slack or abs(h) <= slack:
        # only a triangle that may lie ahead matters, and not behind the end
        along, beside, beyond = dot(u, a), dot(u, b), dot(u, c)
        if along < 0.0 and beside < 0.0 and beyond < 0.0:
            return 0
        return 0 if along > length and beside > length and beyond > length else GRAZED
    facing = f > 0.0
    # the line meets the plane ahead if the ray and the height run the same way
    if (height > 0.0) != facing or abs(height) > length * abs(dot(normal, u)):
        return 0
    return 1 if facing else -1


@inlined
def _over(x: float) -> float:
    """One over a part of a direction; large where that is next to nothing, for what is infinite is no number."""
    return 1.0 / (math.copysign(_FLAT, x) if abs(x) < _FLAT else x)


@inlined
def _crossings(p: Vector3, u: Vector3, length: float, surfaces: SurfaceTables, span: Span) -> int:
    """Sum of the crossings of the way from p along a unit vector u, or something above `GRAZED` / 2."""
    root, leaves, first, count = span
    inverse = (_over(u[0]), _over(u[1]), _over(u[2]))
    waiting = np.empty(_STACK, np.int64)
    waiting[0] = 0
    top = 1
    total = 0
    while top > 0:
        top -= 1
        node = waiting[top]
        if not _meets_box(p, inverse, length, surfaces.nodes, root + node):
            continue
        leaf = node - (leaves - 1)
        if leaf < 0:
            waiting[top], waiting[top + 1] = 2 * node + 1, 2 * node + 2
            top += 2
            continue
        for i in range(first + leaf * LEAF, first + min(count, (leaf + 1) * LEAF)):
            total += _crossing(p, u, length, surfaces.corners, i)
            if total > GRAZED // 2:
                return total
    return total


@inlined
def _winding(x: float, y: float, z: float, surfaces: SurfaceTables, span: Span) -> int:
    """The winding number around a point, or something above `GRAZED` / 2 if each of `RAYS` rays grazes an edge."""
    box = span[0]
    nodes = surfaces.nodes
    if not (nodes[box, 0] <= x <= nodes[box, 3] and nodes[box, 1] <= y <= nodes[box, 4]):
        return 0
    if not nodes[box, 2] <= z <= nodes[box, 5]:
        return 0
    total = GRAZED
    for k in range(RAYS):
        total = _crossings((x, y, z), ray_direction(k), math.inf, surfaces, span)
        if total <= GRAZED // 2:
            return total
    return total


@kernel
def ray_winding(x: float, y: float, z: float, surfaces: SurfaceTables, span: Span) -> int:
    """Return the winding number of a closed surface around a point not on it.

    0 where each of `RAYS` rays grazes an edge.
    """
    total = _winding(x, y, z, surfaces, span)
    return total if total <= GRAZED // 2 else 0


@inner_kernel
def surely_outside(x: float, y: float, z: float, surfaces: SurfaceTables, span: Span) -> bool:
    """Tell if a closed surface is certain not to wind around a point that is not on it."""
    return _winding(x, y, z, surfaces, span) == 0


@inner_kernel
def surely_outside_seen(
    x: float, y: float, z: float, surfaces: SurfaceTables, span: Span, anchors: Rows, row: int
) -> bool:
    """`surely_outside` of a closed surface of which only the part that meets a ball is known; `anchors` (k, ANCHOR).

    A segment between two places in the ball is in it, so that all triangles that it crosses are known.
    """
    dx, dy, dz = x - anchors[row, BALL], y - anchors[row, BALL + 1], z - anchors[row, BALL + 2]
    if not (dx * dx + dy * dy + dz * dz <= anchors[row, REACH] ** 2 and anchors[row, ROOM] > 0.0):
        return False
    for k in range(RAYS):
        u, room = ray_direction(k), anchors[row, ROOM]
        ex, ey = anchors[row, PLACE] + room * u[0] - x, anchors[row, PLACE + 1] + room * u[1] - y
        ez = anchors[row, PLACE + 2] + room * u[2] - z
        length = math.sqrt(ex * ex + ey * ey + ez * ez)
        if length > 0.0:
            way = (ex / length, ey / length, ez / length)
            total = _crossings((x, y, z), way, length, surfaces, span)
            if total <= GRAZED // 2:
                outside: bool = total + anchors[row, TURNS] == 0.0
                return outside
    return False
