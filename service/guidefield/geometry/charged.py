"""Charged surfaces as the tables that the kernels read: what depends on a surface alone is computed here, once."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.field import FieldTables
from guidefield.kernels.signatures import Floats
from guidefield.kernels.triangle import ROWS

__all__ = ["FieldTables", "field_tables"]

_LANES = 8
"""Columns come in multiples of it: what the widest vector unit evaluates at once."""

_PAGE = 512
"""Columns that fill a whole number of memory pages would have all rows compete for the same lines of the cache."""


def field_tables(
    triangles: Floats | None = None,
    triangle_charge: Floats | None = None,
    spheres: Floats | None = None,
    capsules: Floats | None = None,
    planes: Floats | None = None,
) -> FieldTables:
    """Tables of what is charged; all in one frame, lengths in m, charges per area.

    Triangles without area are left out: they have no charge.

    Args:
        triangles: Corners, counter-clockwise from outside, shape (n, 3, 3).
        triangle_charge: Charge of each triangle, shape (n,); 1 if not given.
        spheres: x, y, z, radius, charge; shape (m, 5).
        capsules: x0, y0, z0, x1, y1, z1, radius, charge; shape (c, 8).
        planes: Normal (3), offset, charge; shape (p, 5). The points with ``normal . x < offset`` are behind.

    Raises:
        ValueError: if an array has another shape, is not finite, a radius is not positive or a normal not a unit one.
    """
    corners = _checked("triangles", triangles, (3, 3))
    charge = np.ones(len(corners)) if triangle_charge is None else _checked("triangle_charge", triangle_charge, ())
    if len(charge) != len(corners):
        raise ValueError(f"`triangle_charge` must be as many as `triangles` ({len(corners)}), got {len(charge)}")
    balls = _checked("spheres", spheres, (5,))
    pills = _checked("capsules", capsules, (8,))
    walls = _checked("planes", planes, (5,))
    for name, radius in (("spheres", balls[:, 3]), ("capsules", pills[:, 6])):
        if (radius <= 0.0).any():
            raise ValueError(f"`{name}` must have positive radii, got {radius.min()}")
    if (np.abs(np.linalg.norm(walls[:, :3], axis=1) - 1.0) > 1e-9).any():
        raise ValueError("`planes` must have unit normals")
    return FieldTables(_triangle_table(corners, charge), *(_frozen(rows.T) for rows in (balls, pills, walls)))


def _triangle_table(corners: Floats, charge: Floats) -> Floats:
    """The table of kernels/triangle.py, shape (ROWS, n padded).

    In extended precision where the machine has it, and normal and area from the two shortest edges: from the others
    a sliver would lose its length over its width in digits.
    """
    v = _longest_edge_first(corners.astype(np.longdouble))
    edge = v[:, 1] - v[:, 0]
    arm = v[:, 2] - v[:, 0]
    across = np.cross(v[:, 0] - v[:, 2], v[:, 1] - v[:, 2])
    twice_area = _lengths(across)
    solid = twice_area > 0.0
    v, edge, arm, across, twice_area = v[solid], edge[solid], arm[solid], across[solid], twice_area[solid]
    length = _lengths(edge)
    t = edge / length[:, None]
    tau = (arm * t).sum(axis=1)
    e = arm - tau[:, None] * t
    normal = across / twice_area[:, None]
    squares = np.stack([_squares(v[:, (i + 2) % 3] - v[:, (i + 1) % 3]) for i in range(3)])
    rows = [v.reshape(-1, 9).T, t.T, length, tau, e.T, normal.T, 2.0 * twice_area, squares, charge[solid]]
    columns = _LANES * -(-len(v) // _LANES)
    columns += _LANES if columns and columns % _PAGE == 0 else 0
    table = np.zeros((ROWS, columns))
    table[:, : len(v)] = np.vstack(rows)
    return _frozen(table)


def _longest_edge_first(v: np.ndarray) -> np.ndarray:
    """The same triangles, their corners turned so that the longest edge leads from the first to the second."""
    edges = np.stack([_squares(v[:, (i + 1) % 3] - v[:, i]) for i in range(3)], axis=1)
    order = (edges.argmax(axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(v, order[:, :, None], axis=1)


def _squares(vectors: np.ndarray) -> np.ndarray:
    squares: np.ndarray = (vectors * vectors).sum(axis=1)
    return squares


def _lengths(vectors: np.ndarray) -> np.ndarray:
    lengths: np.ndarray = np.sqrt(_squares(vectors))
    return lengths


def _checked(name: str, values: Floats | None, shape: tuple[int, ...]) -> Floats:
    """The array as float64; of shape (0, *shape) if there is none."""
    array = np.zeros((0, *shape)) if values is None else np.asarray(values, dtype=np.float64)
    if array.shape[1:] != shape or array.ndim != len(shape) + 1:
        raise ValueError(f"`{name}` must have shape {('n', *shape)}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"`{name}` must be finite")
    return array


def _frozen(values: Floats) -> Floats:
    array = np.ascontiguousarray(values)
    array.setflags(write=False)
    return array
