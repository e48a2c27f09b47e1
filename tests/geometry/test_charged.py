from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.geometry import surfaces
from guidefield.geometry.charged import field_tables
from guidefield.kernels.triangle import ROWS
from tests.kernels.evaluation import triangles
from tests.oracles import EPS


@settings(deadline=None, max_examples=50)
@given(triangles)
def test_columns_describe_the_triangle(corners: np.ndarray) -> None:
    column = field_tables(corners[None]).triangles[:, 0]
    a, b, c = column[:9].reshape(3, 3)
    t, length, tau, e, normal, four_areas = column[9:12], *column[12:14], column[14:17], column[17:20], column[20]
    order = [int(np.flatnonzero((corners == corner).all(axis=1))[0]) for corner in (a, b, c)]
    assert order in ([0, 1, 2], [1, 2, 0], [2, 0, 1])
    assert length == pytest.approx(max(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)))
    assert a + length * t == pytest.approx(b)
    assert a + tau * t + e == pytest.approx(c)
    assert e @ t == pytest.approx(0.0, abs=1e-15)
    assert normal * four_areas == pytest.approx(2.0 * np.cross(b - a, c - a))
    assert column[21:24] == pytest.approx([np.sum((b - c) ** 2), np.sum((c - a) ** 2), np.sum((a - b) ** 2)])
    assert column[24] == 1.0


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
    assert field_tables(corners[None]).triangles[20, 0] == pytest.approx(2.0 * exact, rel=8 * EPS)


@given(st.integers(0, 40))
@settings(deadline=None, max_examples=20)
def test_triangles_are_padded_with_zeros(count: int) -> None:
    corners = surfaces.sphere(1.0).corners[:count]
    table = field_tables(corners).triangles
    assert table.shape[0] == ROWS
    assert table.shape[1] % 8 == 0
    assert count <= table.shape[1] < count + 8
    assert not table[:, count:].any()


def test_rows_do_not_all_begin_at_the_same_place_of_a_page() -> None:
    corners = np.tile(surfaces.box((1.0, 1.0, 1.0)).corners, (43, 1, 1))[:512]
    assert field_tables(corners).triangles.strides[0] % 4096 != 0


def test_triangles_without_area_are_left_out() -> None:
    whole = surfaces.box((1.0, 2.0, 3.0)).corners
    slit = np.array([[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]], [[1.0, 0.0, 0.0]] * 3])
    charge = np.arange(1.0, 13.0)
    mixed = field_tables(np.concatenate([slit, whole]), np.concatenate([[9.0, 9.0], charge])).triangles
    assert (mixed == field_tables(whole, charge).triangles).all()


def test_tables_are_frozen_and_contiguous() -> None:
    tables = field_tables(
        surfaces.box((1.0, 1.0, 1.0)).corners, None, [[0, 0, 0, 1, 2]], [[0, 0, 0, 1, 0, 0, 0.1, 1]], [[0, 0, 1, 0, 1]]
    )
    for table in tables:
        assert table.flags.c_contiguous
        assert table.dtype == np.float64
        assert not table.flags.writeable
    assert [table.shape[0] for table in tables] == [ROWS, 5, 8, 5]
    assert tables.spheres[:, 0].tolist() == [0, 0, 0, 1, 2]


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
    ],
)
def test_what_cannot_be_charged_is_refused(arguments: dict[str, Any], fault: str) -> None:
    with pytest.raises(ValueError, match=fault):
        field_tables(**arguments)
