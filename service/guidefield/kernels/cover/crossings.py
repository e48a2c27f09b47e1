"""How often a closed surface winds around a point: its crossings, counted with their sign, with a line through it.

The signs of the areas that two points of a triangle and the line span, seen along the line, tell whether it crosses the
triangle. They count where they are certain but for rounding: corners are rounded alike in all triangles, so that what
is closed stays so. Both sides of the line tell, and have to agree where both are certain.

Nothing is shared with the planner's distances: a certificate must not rely on them.
"""

from __future__ import annotations

from numba import types, void

from guidefield.kernels.jit.signatures import (
    INDEX_MATRIX,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    Floats,
    Integers,
    exact_kernel,
    exact_part,
)

RUN = 2048
"""So many triangles, one behind the other, have a box: the line passes most of them by."""

UNSURE = 1 << 40
"""What is returned where neither side of the line tells."""

_ALONG_X, _ALONG_Y = 0.3819660112501051, -0.2360679774997897
"""The line's direction is these and 1: along no axis, diagonal or side of what people build."""

_ROUNDING, _WIDER = 1e-15, 1e-9
"""Of an area's terms, eight times as much as rounding takes; of boxes, of a metre and of each from the origin."""


@exact_part
def _seen(vertices: Floats, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A corner from a point: beside the line, along two axes, and along it."""
    w = vertices[i, 2] - z
    return (vertices[i, 0] - x) - _ALONG_X * w, (vertices[i, 1] - y) - _ALONG_Y * w, w


@exact_part
def _area(bu: float, bv: float, cu: float, cv: float) -> tuple[float, float]:
    """Twice the area that two points and the line span, as it is seen along the line, and how far off it may be."""
    return bu * cv - bv * cu, _ROUNDING * (abs(bu * cv) + abs(bv * cu))


@exact_kernel(void(MATRIX, INDEX_MATRIX, MATRIX_OUT))
def find_run_boxes(vertices: Floats, triangles: Integers, boxes_out: Floats) -> None:
    """Write boxes about runs of `RUN` triangles as they are seen along the line.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
        boxes_out: Lower and upper corner of each, shape (k, 4) [m].
    """
    for run in range(boxes_out.shape[0]):
        low_u, low_v, high_u, high_v = 1e300, 1e300, -1e300, -1e300
        for t in range(run * RUN, min((run + 1) * RUN, triangles.shape[0])):
            for k in range(3):
                u, v, w = _seen(vertices, triangles[t, k], 0.0, 0.0, 0.0)
                wider = _WIDER * (1.0 + abs(u) + abs(v) + abs(w))
                low_u, high_u = min(low_u, u - wider), max(high_u, u + wider)
                low_v, high_v = min(low_v, v - wider), max(high_v, v + wider)
        boxes_out[run, 0], boxes_out[run, 1], boxes_out[run, 2], boxes_out[run, 3] = low_u, low_v, high_u, high_v


@exact_kernel(types.int64(SCALAR, SCALAR, SCALAR, MATRIX, INDEX_MATRIX, MATRIX))
def winding_by_crossings(x: float, y: float, z: float, vertices: Floats, triangles: Integers, boxes: Floats) -> int:
    """The winding number of a closed surface around a point that is not on it.

    Args:
        x: Point in the frame of the surface [m], with y and z.
        y: See x.
        z: See x.
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3); they agree about the outside.
        boxes: Of `find_run_boxes`, shape (k, 4) [m].

    Returns:
        The number, or `UNSURE`: the line passes through a corner or an edge on both sides, or the surface isn't closed.
    """
    above, below, sure_above, sure_below = 0, 0, True, True
    at_u, at_v = x - _ALONG_X * z, y - _ALONG_Y * z
    for run in range(boxes.shape[0]):
        if not (boxes[run, 0] <= at_u <= boxes[run, 2] and boxes[run, 1] <= at_v <= boxes[run, 3]):
            continue
        for t in range(run * RUN, min((run + 1) * RUN, triangles.shape[0])):
            au, av, aw = _seen(vertices, triangles[t, 0], x, y, z)
            bu, bv, bw = _seen(vertices, triangles[t, 1], x, y, z)
            cu, cv, cw = _seen(vertices, triangles[t, 2], x, y, z)
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
