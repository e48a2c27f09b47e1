"""How far a place is from a surface that no tree is made of."""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.distance.triangle_distance import nearest_of
from guidefield.kernels.jit.signatures import INDEX_MATRIX, MATRIX, SCALAR, Floats, Integers, compiled


@compiled(SCALAR(SCALAR, SCALAR, SCALAR, MATRIX, INDEX_MATRIX))
def distance_to_triangles(x: float, y: float, z: float, vertices: Floats, triangles: Integers) -> float:
    """Distance of a point to the nearest of triangles [m]; infinite without one.

    Args:
        x: Point in the frame of the vertices [m], with y and z.
        y: See x.
        z: See x.
        vertices: Shape (v, 3) [m].
        triangles: Those with an area, shape (t, 3).
    """
    best, row = math.inf, np.empty((1, 9))
    for t in range(triangles.shape[0]):
        for k in range(3):
            a = vertices[triangles[t, 0], k]
            row[0, k], row[0, 3 + k], row[0, 6 + k] = (
                a,
                vertices[triangles[t, 1], k] - a,
                vertices[triangles[t, 2], k] - a,
            )
        best = nearest_of((x, y, z), row, 0, 1, best, 0)[0]
    return math.sqrt(best)
