"""The volume within a closed surface, as a sum of tetrahedra."""

from __future__ import annotations

from numba import types

from guidefield.kernels.jit.signatures import INDEX_MATRIX, MATRIX, VECTOR, Floats, Integers, exact_kernel

TOGETHER = 1024
"""So many are summed alone, so that rounding adds up over few numbers."""


@exact_kernel(types.float64(MATRIX, INDEX_MATRIX, VECTOR))
def signed_volume(vertices: Floats, triangles: Integers, origin: Floats) -> float:
    """Sum the volumes of the tetrahedra over triangles; negative for those that run clockwise seen from outside [m^3].

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
        origin: Their common corner, shape (3,) [m].
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
