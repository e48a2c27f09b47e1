"""Winding numbers of a closed surface around a point, by crossings of a line or by solid angles, and its volume.

All triangles are asked, without a tree. `winding_by_crossings` takes a fraction of the time; where it returns `UNSURE`,
`collision/solids.py` takes `winding_by_angles`. Error bounds may grow, not shrink: a wrong sign is a wrong inside.
"""

from __future__ import annotations

import math

from guidefield.kernels.jit.arrays import Floats, IndexRows, Row, Rows, RowsOut
from guidefield.kernels.jit.decorators import exact_kernel, exact_part
from guidefield.kernels.linalg.small_systems import cross, dot

RUN = 2048  # this many triangles, one behind the other, have a box: the line passes most of them by
UNSURE = 1 << 40  # returned if the line meets a corner or an edge on both sides: more than a surface winds

_ALONG_X, _ALONG_Y = 0.3819660112501051, -0.2360679774997897
"""The line's direction is these and 1: along no axis, diagonal or side of what people build."""

_ROUNDING, _WIDER = 1e-15, 1e-9
"""Error of an area as a share of its terms, eight times what rounding makes; widening of boxes, of a metre and of each
metre from the origin."""


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


TOGETHER = 1024  # this many are summed alone, so that rounding adds up over few numbers


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
