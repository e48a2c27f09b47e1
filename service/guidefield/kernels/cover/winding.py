"""How often a closed surface winds around a point, by solid angles: every triangle is looked at, no tree is needed."""

from __future__ import annotations

import math

from guidefield.kernels.cover.signed_volume import TOGETHER
from guidefield.kernels.jit.signatures import INDEX_MATRIX, MATRIX, SCALAR, Floats, Integers, exact_kernel
from guidefield.kernels.linalg.small_systems import cross, dot


@exact_kernel(SCALAR(SCALAR, SCALAR, SCALAR, MATRIX, INDEX_MATRIX))
def winding_by_angles(x: float, y: float, z: float, vertices: Floats, triangles: Integers) -> float:
    """Sum the triangles' solid angles over 4 pi: whole numbers for a closed surface, 0 outside.

    Source: A. van Oosterom and J. Strackee, IEEE Trans. Biomedical Engineering 30(2), 1983.

    Args:
        x: Point in the frame of the surface [m], with y and z.
        y: See x.
        z: See x.
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
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
