"""The field of everything charged at a point: triangles, spheres, capsules and planes summed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import void

from guidefield.kernels.primitives import charged_capsule_at, plane_at, sphere_at
from guidefield.kernels.signatures import (
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    SIX_SCALARS,
    VECTOR_OUT,
    Floats,
    Six,
    compiled,
    inlined,
)
from guidefield.kernels.triangle import triangles_at


class FieldTables(NamedTuple):
    """What is charged, as the kernels read it: one row per quantity, one column per primitive; all C-contiguous.

    Attributes:
        triangles: Table of kernels/triangle.py, shape (ROWS, n), padded with columns of zeros.
        spheres: Rows x, y, z, radius [m], charge; shape (5, m).
        capsules: Rows x0, y0, z0, x1, y1, z1, radius [m], charge; shape (8, c).
        planes: Rows of the unit normal (3), offset [m], charge; shape (5, p).
    """

    triangles: Floats
    spheres: Floats
    capsules: Floats
    planes: Floats


def potential_at_points(tables: FieldTables, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Field of all that is charged at many points.

    Args:
        tables: What is charged.
        points: Points in the frame of the tables [m], shape (n, 3).

    Returns:
        Potential [1/m], shape (n,); its gradient [1/m^2], shape (n, 3); winding number, shape (n,).

    Raises:
        ValueError: if `points` is not of shape (n, 3) or not finite.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"`points` must have shape (n, 3), got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(f"`points` must be finite, got {points[~np.isfinite(points).all(axis=1)][0]}")
    potential, gradient, winding = np.zeros(len(points)), np.zeros((len(points), 3)), np.zeros(len(points))
    _field_at_points(points, *tables, potential, gradient, winding)
    return potential, gradient, winding


@inlined
def _plus(total: Six, charge: float, term: Six) -> Six:
    """Sum of fields; the winding number counts surfaces whatever their charge."""
    return (
        total[0] + charge * term[0],
        total[1] + charge * term[1],
        total[2] + charge * term[2],
        total[3] + charge * term[3],
        total[4] + charge * term[4],
        total[5] + term[5],
    )


@compiled(SIX_SCALARS(SCALAR, SCALAR, SCALAR, MATRIX, MATRIX, MATRIX, MATRIX))
def field_at(x: float, y: float, z: float, triangles: Floats, spheres: Floats, capsules: Floats, planes: Floats) -> Six:
    """Field of all that is charged at a point, in the frame of the tables.

    Args:
        x: Point [m], with y and z.
        y: See x.
        z: See x.
        triangles: As in `FieldTables`, shape (ROWS, n).
        spheres: As in `FieldTables`, shape (5, m).
        capsules: As in `FieldTables`, shape (8, c).
        planes: As in `FieldTables`, shape (5, p).

    Returns:
        Potential [1/m]; its gradient (3) [1/m^2], minus the force on a unit charge; curvature of the nearby
        surfaces [1/m^3], never negative; winding number, the count of closed surfaces around the point. All are
        finite everywhere, on the surfaces too. Inside a solid they do not tell the way out.
    """
    p = (x, y, z)
    total = triangles_at(x, y, z, triangles)
    for i in range(spheres.shape[1]):
        centre = (spheres[0, i], spheres[1, i], spheres[2, i])
        total = _plus(total, spheres[4, i], sphere_at(p, centre, spheres[3, i]))
    for i in range(capsules.shape[1]):
        end0 = (capsules[0, i], capsules[1, i], capsules[2, i])
        end1 = (capsules[3, i], capsules[4, i], capsules[5, i])
        total = _plus(total, capsules[7, i], charged_capsule_at(p, end0, end1, capsules[6, i]))
    for i in range(planes.shape[1]):
        normal = (planes[0, i], planes[1, i], planes[2, i])
        total = _plus(total, planes[4, i], plane_at(p, normal, planes[3, i]))
    return total


@compiled(void(MATRIX, MATRIX, MATRIX, MATRIX, MATRIX, VECTOR_OUT, MATRIX_OUT, VECTOR_OUT))
def _field_at_points(
    points: Floats,
    triangles: Floats,
    spheres: Floats,
    capsules: Floats,
    planes: Floats,
    potential_out: Floats,
    gradient_out: Floats,
    winding_out: Floats,
) -> None:
    """`field_at` for every row of `points`."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        phi, gx, gy, gz, _, winding = field_at(x, y, z, triangles, spheres, capsules, planes)
        potential_out[i] = phi
        gradient_out[i, 0] = gx
        gradient_out[i, 1] = gy
        gradient_out[i, 2] = gz
        winding_out[i] = winding
