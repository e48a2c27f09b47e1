"""Points and triangles against the planes of a convex part: none of what is in it is beyond one."""

from __future__ import annotations

import numpy as np
from numba import types, void

from guidefield.kernels.jit.signatures import MATRIX, SCALAR, Floats, compiled


@compiled(void(MATRIX, MATRIX, SCALAR, types.Array(types.boolean, 1, "C")))
def not_beyond(corners: Floats, planes: Floats, rounding: float, kept_out: np.ndarray) -> None:
    """Say of triangles whether none of some planes has all of one beyond it.

    Args:
        corners: Corners of the triangles one after the other, shape (3 t, 3) [m].
        planes: Unit normals n and offsets d, shape (m, 4): what is beyond has n.x > d.
        rounding: By how much a triangle has to be beyond a plane to count as beyond [m].
        kept_out: Shape (t,).
    """
    for t in range(kept_out.shape[0]):
        kept = True
        for m in range(planes.shape[0]):
            x, y, z, least = planes[m, 0], planes[m, 1], planes[m, 2], planes[m, 3] + rounding
            beyond = True
            for k in range(3 * t, 3 * t + 3):
                beyond &= corners[k, 0] * x + corners[k, 1] * y + corners[k, 2] * z > least
            if beyond:
                kept = False
                break
        kept_out[t] = kept


@compiled(void(MATRIX, MATRIX, SCALAR, types.Array(types.boolean, 1, "C")))
def beyond_any(points: Floats, planes: Floats, rounding: float, beyond_out: np.ndarray) -> None:
    """Say of points whether any of some planes has them beyond it.

    Args:
        points: Shape (n, 3) [m].
        planes: Unit normals n and offsets d, shape (m, 4): what is beyond has n.x > d.
        rounding: By how much a point has to be beyond a plane to count as beyond [m].
        beyond_out: Shape (n,).
    """
    for i in range(beyond_out.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        beyond = False
        for m in range(planes.shape[0]):
            if x * planes[m, 0] + y * planes[m, 1] + z * planes[m, 2] > planes[m, 3] + rounding:
                beyond = True
                break
        beyond_out[i] = beyond
