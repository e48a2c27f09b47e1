"""The field at one point, as the tests ask for it."""

from typing import Any, NamedTuple

import numpy as np
from hypothesis import strategies as st

from guidefield.geometry.charged import field_tables
from guidefield.kernels.field.field import FieldTables, add_potential, field_at_points, padded


class Field(NamedTuple):
    """What `field_at_points` returns, of one point."""

    potential: float
    gradient: np.ndarray
    curvature: float
    winding: float


def field(point: np.ndarray, triangles: np.ndarray | None = None, **charged: Any) -> Field:
    """Field of charged surfaces, in the arguments of `field_tables`, at a point."""
    at = field_at_points(field_tables(triangles, **charged), np.array([point], float))
    return Field(float(at.potential[0]), at.gradient[0], float(at.curvature[0]), float(at.winding[0]))


def potential_at_points(tables: FieldTables, points: np.ndarray) -> np.ndarray:
    """What `add_potential` makes of points (n, 3), in the precision of the tables: shape (n,) [1/m].

    Its machine code is in single precision only; in double its source runs on NumPy arrays.
    """
    at = padded(tables, points)
    out = np.zeros(at.shape[1], at.dtype)
    added = add_potential if at.dtype == np.float32 else add_potential.py_func
    added(tables, at, 0, out)
    return out[: len(points)].astype(np.float64)


def gradient_by_differences(point: np.ndarray, step: float, **charged: Any) -> np.ndarray:
    """Central differences of the potential, fourth order."""
    tables = field_tables(**charged)

    def potential(p: np.ndarray) -> float:
        return float(potential_at_points(tables, np.array([p]))[0])

    return np.array(
        [
            (8.0 * (potential(point + e) - potential(point - e)) - potential(point + 2 * e) + potential(point - 2 * e))
            / (12.0 * step)
            for e in step * np.eye(3)
        ]
    )


def _altitude(corners: np.ndarray) -> float:
    edges = np.roll(corners, -1, axis=0) - corners
    longest = np.linalg.norm(edges, axis=1).max()
    return float(np.linalg.norm(np.cross(edges[0], edges[1])) / longest) if longest > 0.0 else 0.0


def vectors(reach: float) -> st.SearchStrategy[np.ndarray]:
    """Points of a cube about the origin, shape (3,)."""
    return st.tuples(*[st.floats(-reach, reach, allow_subnormal=False)] * 3).map(np.array)


triangles = st.tuples(vectors(1.0), vectors(1.0), vectors(1.0)).map(np.array).filter(lambda v: _altitude(v) > 0.1)
"""Triangles of ordinary proportions, shape (3, 3)."""


@st.composite
def rigid_motions(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """A rotation (3, 3) and a translation (3,)."""
    w, x, y, z = draw(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: sum(c * c for c in q) > 0.1))
    norm = w * w + x * x + y * y + z * z
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + (2.0 * w * hat + 2.0 * hat @ hat) / norm, draw(vectors(1.0))
