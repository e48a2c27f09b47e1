"""How far primitives are at least and at most from the places in a ball."""

from __future__ import annotations

import math

from numba import void

from guidefield.kernels.collide.primitive import BOX, CAPSULE, HALF_SPACE
from guidefield.kernels.jit.signatures import MATRIX, SCALAR, VECTOR, VECTOR_OUT, Floats, exact_kernel


@exact_kernel(void(MATRIX, VECTOR, SCALAR, VECTOR_OUT, VECTOR_OUT))
def gaps_from_ball(placed: Floats, ball: Floats, rounding: float, least: Floats, most: Floats) -> None:
    """Find the distances; of what is no primitive nothing is known.

    Args:
        placed: How primitives are declared, `PLACED` of each, shape (n, 12); all zero of what is none.
        ball: Centre and radius, shape (4,) [m].
        rounding: What distances are taken for wider, of a metre and of each metre that places are from the origin.
        least: Gets how far each is at least from any place in the ball, shape (n,) [m].
        most: Gets how far it is at most, shape (n,) [m].
    """
    middle_far = max(abs(ball[0]), abs(ball[1]), abs(ball[2]))
    for i in range(placed.shape[0]):
        row = placed[i]
        known = False
        for k in range(row.shape[0]):
            known = known or row[k] != 0.0
        if not known:
            least[i], most[i] = -math.inf, math.inf
            continue
        kind, radius = row[0], row[11]
        x, y, z, a, b, c = row[5], row[6], row[7], row[8], row[9], row[10]
        wider = rounding * (1.0 + max(abs(x), abs(y), abs(z)) + middle_far)
        if kind == HALF_SPACE:
            above = (ball[0] - x) * a + (ball[1] - y) * b + (ball[2] - z) * c
            least[i], most[i] = -math.inf, max(above + ball[3], 0.0) + wider
            continue
        apart = math.sqrt((x - ball[0]) ** 2 + (y - ball[1]) ** 2 + (z - ball[2]) ** 2)
        if kind == BOX:
            about, within = math.sqrt(a * a + b * b + c * c), min(a, b, c)
        elif kind == CAPSULE:
            about, within = c + radius, radius
        else:
            about, within = math.sqrt(c * c + radius * radius), min(c, radius)
        least[i] = apart - about - ball[3] - wider
        most[i] = max(apart - within + ball[3], 0.0) + wider
