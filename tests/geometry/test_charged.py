from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from guidefield.geometry import surfaces
from guidefield.geometry.charged import convex_quads, field_tables
from guidefield.kernels.field.box import BOX_COLUMNS
from guidefield.kernels.field.field_tables import NODE_COLUMNS, QUAD_COLUMNS, TRIANGLE_COLUMNS
from tests.oracles import EPS


@pytest.mark.skipif(np.finfo(np.longdouble).eps == EPS, reason="this machine has no extended precision")
@pytest.mark.parametrize("width", [1e-4, 1e-8, 1e-10])
def test_area_of_an_oblique_sliver_is_exact(width: float) -> None:
    turn = np.linalg.qr(np.array([[1.0, 2.0, 0.5], [0.3, -1.0, 2.0], [2.0, 0.1, 1.0]]))[0]
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.4, width, 0.0]]) @ turn.T
    a, b, c = ([Fraction(float(x)) for x in corner] for corner in corners)
    u, v = ([end[i] - a[i] for i in range(3)] for end in (b, c))
    cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    # A square root of a fraction, to more digits than a float has.
    exact = float(sum(x * x for x in cross) * Fraction(10) ** 60) ** 0.5 / 1e30
    assert field_tables(corners[None]).triangles[0, 6] == pytest.approx(2.0 * exact, rel=8 * EPS)


def test_faces_without_area_are_left_out() -> None:
    whole = surfaces.box((1.0, 2.0, 3.0)).corners
    slit = np.array([[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]], [[1.0, 0.0, 0.0]] * 3])
    charge = np.arange(1.0, 13.0)
    mixed = field_tables(np.concatenate([slit, whole]), np.concatenate([[9.0, 9.0], charge]))
    for ours, theirs in zip(mixed, field_tables(whole, charge), strict=True):
        assert (ours == theirs).all()
    half_flat = [[[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]]]
    tables = field_tables(quads=half_flat)
    assert (len(tables.quads), len(tables.triangles)) == (0, 1)


@pytest.mark.parametrize("count", [3, 4, 5, 8, 24, 25])
def test_convex_polygons_in_quads(count: int) -> None:
    angles = 2.0 * np.pi * np.arange(count) / count
    polygon = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])
    quads, rest = convex_quads(polygon)
    assert len(quads) == (count - 2) // 2
    assert len(rest) == count % 2
    corners = np.concatenate([rest, quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert (areas > 0.0).all()
    assert areas.sum() == pytest.approx(0.5 * count * np.sin(2.0 * np.pi / count))


def test_tables_are_frozen_and_contiguous() -> None:
    tables = field_tables(
        surfaces.box((1.0, 1.0, 1.0)).corners, None, [[0, 0, 0, 1, 2]], [[0, 0, 0, 1, 0, 0, 0.1, 1]], [[0, 0, 1, 0, 1]]
    )
    for table in tables:
        assert table.flags.c_contiguous
        assert not table.flags.writeable
    matrices = (tables.boxes, tables.triangles, tables.quads, tables.nodes)
    assert [table.shape[1] for table in matrices] == [BOX_COLUMNS, TRIANGLE_COLUMNS, QUAD_COLUMNS, NODE_COLUMNS]
    assert tables.spheres[0].tolist() == [0, 0, 0, 1, 2]


TRIANGLE = [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        ({"triangles": np.zeros((2, 3))}, "`triangles` must have shape"),
        ({"triangles": np.full((1, 3, 3), np.nan)}, "`triangles` must be finite"),
        ({"triangles": TRIANGLE, "triangle_charge": [1.0, 2.0]}, "as many"),
        ({"spheres": [[0, 0, 0, 0, 1]]}, "positive radii"),
        ({"capsules": [[0, 0, 0, 1, 0, 0, -0.1, 1]]}, "positive radii"),
        ({"planes": [[0, 0, 2, 0, 1]]}, "unit normals"),
        ({"planes": [[0, 0, 1, 0]]}, "`planes` must have shape"),
        ({"boxes": [[0, 0, 0, *np.eye(3).ravel(), 1, 0, 1, 1]]}, "positive sizes"),
        ({"boxes": [[0, 0, 0, *(2 * np.eye(3)).ravel(), 1, 1, 1, 1]]}, "unit normals"),
        ({"cloud": [[0, 0, 0, 1, 0]]}, "positive radii"),
    ],
)
def test_what_cannot_be_charged_is_refused(arguments: dict[str, Any], fault: str) -> None:
    with pytest.raises(ValueError, match=fault):
        field_tables(**arguments)
