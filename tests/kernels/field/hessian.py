"""Second derivatives of the potential of charged triangles, algebraic once the potential is known.

With F of kernels/field/faces.py, y = 4 A h, N = F^2 + y^2, a_i the vectors to the corners, l_i their lengths,
e_i = a_i/l_i, S = sum l_i, E = sum e_i, F_i = (l_i + S)(S - l_i) - L_i^2 and sigma the sign of the height

    Hess F = (sum F_i/l_i) 1 - sum (2 l_i + F_i/l_i) e_i e_i^T + 2 S E E^T
    Hess Phi = Phi_FF gF gF^T + sigma Phi_Fh (gF n^T + n gF^T) + Phi_hh n n^T + Phi_F Hess F

An oracle for what kernels make of first derivatives: one triangle at a time, as Python runs it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from guidefield.kernels.field.faces import PLANE_ROWS, arctangent_tail, sliver_part
from guidefield.kernels.field.field_tables import CHARGE_PER_AREA, FieldTables
from guidefield.kernels.jit.arrays import Floats, Vector3

_SMALL = math.tan(math.pi / 8) ** 2


def hessian_at_points(tables: FieldTables, points: Floats) -> Floats:
    """Second derivatives of the potential of triangles at points that are not on them.

    Args:
        tables: What is charged: triangles and nothing else.
        points: Shape (n, 3) [m].

    Returns:
        Symmetric matrices, shape (n, 3, 3) [1/m^3].

    Raises:
        ValueError: if something else than triangles is charged, or `points` has another shape.
    """
    if any(len(getattr(tables, kind)) for kind in ("boxes", "quads", "spheres", "capsules", "planes", "cloud")):
        raise ValueError("second derivatives are those of triangles only")
    points = np.ascontiguousarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"`points` must have shape (n, 3), got {points.shape}")
    hessian = np.zeros((len(points), 3, 3))
    with np.errstate(divide="ignore", invalid="ignore"):  # of a selection both sides are worked out
        _add_hessians(tables, points, hessian)
    return hessian


def _slopes(A: float, F: float, h: float) -> tuple[float, float, float, float]:
    """Phi_F, Phi_FF, Phi_Fh and Phi_hh of Phi = (2/h) atan2(4 A h, F)."""
    y = 4.0 * A * h
    N = F * F + y * y
    cube = 256.0 * A * A * A
    if F > 0.0 and y * y < _SMALL * F * F:
        u = (y / F) * (y / F)
        share = 1.0 / (1.0 + u)
        hh = cube / (F * F * F) * (arctangent_tail(u) + share - share * share)
    else:
        over_h = (8.0 * A * F / N - 2.0 / h * math.atan2(y, F)) / (h * h)
        hh = -2.0 * over_h - cube * F / (N * N)
    return -8.0 * A / N, 16.0 * A * F / (N * N), cube * h / (N * N), hh


def _add_hessian(a1: Vector3, a2: Vector3, a3: Vector3, charge: float, row: Any, out: Floats) -> None:
    """Add one triangle's; its row is that of kernels/field/faces.py."""
    corners = (a1, a2, a3)
    l1 = math.sqrt(a1[0] ** 2 + a1[1] ** 2 + a1[2] ** 2)
    l2 = math.sqrt(a2[0] ** 2 + a2[1] ** 2 + a2[2] ** 2)
    l3 = math.sqrt(a3[0] ** 2 + a3[1] ** 2 + a3[2] ** 2)
    n, half = row[3:PLANE_ROWS], row[PLANE_ROWS:]
    F = sliver_part(a1, l1, l2, l3, half)
    height = -(a1[0] * n[0] + a1[1] * n[1] + a1[2] * n[2])
    F_slope, FF, Fh, hh = _slopes(0.25 * half[0], F, max(abs(height), 1e-15))
    Fh = Fh if height >= 0.0 else -Fh
    lengths = (l1, l2, l3)
    S = l1 + l2 + l3
    gradient, E = np.zeros(3), np.zeros(3)
    for i in range(3):
        li = lengths[i]
        others = S - li
        # (l_j + l_k)^2 - L_i^2 over l_i, and F_i
        square = half[3 + i]
        weight = 2.0 * others + (others * others - square) / li
        Fi = (li + S) * others - square
        for r in range(3):
            e = corners[i][r] / li
            E[r] += e
            gradient[r] -= weight * corners[i][r]
            out[r, r] += charge * F_slope * Fi / li
            for c in range(3):
                out[r, c] -= charge * F_slope * (2.0 * li + Fi / li) * e * corners[i][c] / li
    for r in range(3):
        for c in range(3):
            mixed = Fh * (gradient[r] * n[c] + n[r] * gradient[c])
            value = FF * gradient[r] * gradient[c] + mixed + hh * n[r] * n[c] + 2.0 * S * F_slope * E[r] * E[c]
            out[r, c] += charge * value


def _add_hessians(t: Any, points: Floats, hessian_out: Floats) -> None:
    for i in range(points.shape[0]):
        p = points[i]
        for m in range(t.links.shape[0]):
            link = t.links[m]
            for k in range(link[3], link[5]):
                corners = t.triangle_corners[k]
                v1, v2 = t.vertices[link[1] + corners[0]], t.vertices[link[1] + corners[1]]
                v3 = t.vertices[link[1] + corners[2]]
                _add_hessian(
                    (v1[0] - p[0], v1[1] - p[1], v1[2] - p[2]),
                    (v2[0] - p[0], v2[1] - p[1], v2[2] - p[2]),
                    (v3[0] - p[0], v3[1] - p[1], v3[2] - p[2]),
                    t.nodes[m, CHARGE_PER_AREA],
                    t.triangles[k],
                    hessian_out[i],
                )
