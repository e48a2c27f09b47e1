"""Winding numbers of closed surfaces of triangles about a point: by rays through a tree, by a line, by solid angles.

For a surface whose triangles agree about the outside the number is 1 within a solid, 2 where two solids overlap, 0
outside and in hollows. `ray_winding` is exact, also where pieces overlap or lie in one another: a ray that grazes an
edge or a corner as closely as rounding isn't counted, and another direction is tried. If only the part of the surface
in a ball is known, a segment to an anchor takes the ray's place: a place in the ball whose winding number is known
(`scene/crop.py`).

The others ask all triangles, without a tree. `winding_by_crossings` takes a fraction of the time; where it returns
`UNSURE`, `collision/solids.py` takes `winding_by_angles`. `signed_volume` sums over the triangles in the same way.
Error bounds may grow, not shrink: a wrong sign is a wrong inside.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.distance.triangle_distance import LEAF, Span, SurfaceTables
from guidefield.kernels.jit.arrays import Floats, IndexRows, Row, Rows, RowsOut, Vector3
from guidefield.kernels.jit.decorators import exact_kernel, exact_part, inlined, inner_kernel, kernel
from guidefield.kernels.linalg.small_systems import cross, dot

RAYS = 64  # directions that are tried, at most: with fewer a point counts as outside, or as unsure, more often
GRAZING = 1e-12  # a ray this near an edge, over lengths involved, grazes it; not less; with far more insides are lost
GRAZED = 1 << 40  # marks a ray that grazes an edge in a sum of crossings: more than there are

_STACK = 64  # nodes that wait, at most
_FLAT = 1e-12  # least part of a direction along an axis, where boxes are met: smaller ones count as this

BALL, REACH, PLACE, ROOM, TURNS, ANCHOR = 0, 3, 4, 7, 8, 9
"""Columns of anchors: centre and radius of the ball in which all of the surface is there; a place, how far about it is
free of the surface and in the ball [m], and how often the surface winds around it; then how many there are."""

RUN = 2048  # this many triangles, one behind the other, have a box: the line passes most of them by; for speed only
UNSURE = 1 << 40  # returned if the line meets a corner or an edge on both sides: more than a surface winds

_ALONG_X, _ALONG_Y = 0.3819660112501051, -0.2360679774997897
"""The line's direction is these and 1: along no axis, diagonal or side of what people build, where it is unsure."""

_ROUNDING, _WIDER = 1e-15, 1e-9
"""Error of an area as a share of its terms, eight times what rounding makes; widening of boxes, of a metre and of each
metre from the origin."""

TOGETHER = 1024  # this many are summed alone, so that rounding adds up over few numbers; it changes last bits


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


@exact_part
def _project(vertices: Floats, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Coordinates of a corner as seen from a point: two beside the line, and z, which grows along it."""
    w = vertices[i, 2] - z
    return (vertices[i, 0] - x) - _ALONG_X * w, (vertices[i, 1] - y) - _ALONG_Y * w, w


@exact_part
def _area(bu: float, bv: float, cu: float, cv: float) -> tuple[float, float]:
    """Twice the signed area that two points span with the line, seen along it, and a bound on its error."""
    return bu * cv - bv * cu, _ROUNDING * (abs(bu * cv) + abs(bv * cu))


@exact_kernel
def find_run_boxes(vertices: Rows, triangles: IndexRows, boxes_out: RowsOut) -> None:
    """Write the boxes (k, 4) about runs of `RUN` triangles (t, 3) of vertices (v, 3) [m], as seen along the line."""
    for run in range(boxes_out.shape[0]):
        low_u, low_v, high_u, high_v = 1e300, 1e300, -1e300, -1e300
        for t in range(run * RUN, min((run + 1) * RUN, triangles.shape[0])):
            for k in range(3):
                u, v, w = _project(vertices, triangles[t, k], 0.0, 0.0, 0.0)
                wider = _WIDER * (1.0 + abs(u) + abs(v) + abs(w))
                low_u, high_u = min(low_u, u - wider), max(high_u, u + wider)
                low_v, high_v = min(low_v, v - wider), max(high_v, v + wider)
        boxes_out[run, 0], boxes_out[run, 1], boxes_out[run, 2], boxes_out[run, 3] = low_u, low_v, high_u, high_v


@exact_kernel
def winding_by_crossings(x: float, y: float, z: float, vertices: Rows, triangles: IndexRows, boxes: Rows) -> int:
    """Return the winding number of a closed surface around a point that is not on it, or `UNSURE`.

    Vertices (v, 3) [m] and triangles (t, 3) agree about the outside, `boxes` (k, 4) are those of `find_run_boxes`. It
    is `UNSURE` where the line passes through a corner or an edge on both sides, or the surface isn't closed.
    """
    above, below, sure_above, sure_below = 0, 0, True, True
    at_u, at_v = x - _ALONG_X * z, y - _ALONG_Y * z
    for run in range(boxes.shape[0]):
        if not (boxes[run, 0] <= at_u <= boxes[run, 2] and boxes[run, 1] <= at_v <= boxes[run, 3]):
            continue
        for t in range(run * RUN, min((run + 1) * RUN, triangles.shape[0])):
            au, av, aw = _project(vertices, triangles[t, 0], x, y, z)
            bu, bv, bw = _project(vertices, triangles[t, 1], x, y, z)
            cu, cv, cw = _project(vertices, triangles[t, 2], x, y, z)
            if min(au, bu, cu) > 0.0 or max(au, bu, cu) < 0.0 or min(av, bv, cv) > 0.0 or max(av, bv, cv) < 0.0:
                continue
            f, df = _area(bu, bv, cu, cv)
            g, dg = _area(cu, cv, au, av)
            h, dh = _area(au, av, bu, bv)
            positive, negative = f > df or g > dg or h > dh, f < -df or g < -dg or h < -dh
            if positive and negative:
                continue
            height = f * aw + g * bw + h * cw
            off = (df + _ROUNDING * abs(f)) * abs(aw) + (dg + _ROUNDING * abs(g)) * abs(bw)
            off += (dh + _ROUNDING * abs(h)) * abs(cw)
            if abs(f) > df and abs(g) > dg and abs(h) > dh and abs(height) > off:
                sign = 1 if positive else -1
                if (height > 0.0) == positive:
                    above += sign
                else:
                    below += sign
                continue
            sure_above = sure_above and max(aw, bw, cw) < 0.0
            sure_below = sure_below and min(aw, bw, cw) > 0.0
    if sure_above and sure_below and above + below != 0:
        return UNSURE
    if sure_above:
        return above
    return -below if sure_below else UNSURE


@exact_kernel
def signed_volume(vertices: Rows, triangles: IndexRows, origin: Row) -> float:
    """Sum the volumes of the tetrahedra over triangles (t, 3) with a common corner [m^3].

    It is negative for triangles that run clockwise seen from outside; vertices (v, 3), the corner is `origin` (3,) [m].
    """
    total = 0.0
    for begin in range(0, triangles.shape[0], TOGETHER):
        some = 0.0
        for t in range(begin, min(begin + TOGETHER, triangles.shape[0])):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            for k in range(3):
                i, j = (k + 1) % 3, (k + 2) % 3
                across = (vertices[b, i] - origin[i]) * (vertices[c, j] - origin[j])
                across -= (vertices[b, j] - origin[j]) * (vertices[c, i] - origin[i])
                some += (vertices[a, k] - origin[k]) * across
        total += some
    return total / 6.0


@exact_kernel
def winding_by_angles(x: float, y: float, z: float, vertices: Rows, triangles: IndexRows) -> float:
    """Sum the solid angles of triangles (t, 3) of vertices (v, 3) [m] at a point over 4 pi: 0 outside if closed.

    Source: A. van Oosterom and J. Strackee, IEEE Trans. Biomedical Engineering 30(2), 1983.
    """
    total = 0.0
    for begin in range(0, triangles.shape[0], TOGETHER):
        some = 0.0
        for t in range(begin, min(begin + TOGETHER, triangles.shape[0])):
            i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            a = (vertices[i, 0] - x, vertices[i, 1] - y, vertices[i, 2] - z)
            b = (vertices[j, 0] - x, vertices[j, 1] - y, vertices[j, 2] - z)
            c = (vertices[k, 0] - x, vertices[k, 1] - y, vertices[k, 2] - z)
            to_a, to_b, to_c = math.sqrt(dot(a, a)), math.sqrt(dot(b, b)), math.sqrt(dot(c, c))
            real = to_a * to_b * to_c + dot(a, b) * to_c + dot(b, c) * to_a + dot(c, a) * to_b
            some += 2.0 * math.atan2(dot(a, cross(b, c)), real)
        total += some
    return total / (4.0 * math.pi)
