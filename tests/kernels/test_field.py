from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numba import njit

from guidefield.geometry import surfaces
from guidefield.geometry.charged import field_tables
from guidefield.kernels.field import field_at, potential_at_points
from tests.kernels.evaluation import field, vectors

TRIANGLES = surfaces.box((0.4, 1.0, 0.6)).corners
SPHERES = [[1.0, 0.0, 0.0, 0.2, 1.5], [0.0, 2.0, 0.0, 0.3, 0.5]]
CAPSULES = [[0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.1, 2.0]]
PLANES = [[0.0, 0.0, 1.0, -1.0, 0.7]]


@settings(deadline=None, max_examples=60)
@given(st.lists(vectors(3.0), min_size=1, max_size=5))
def test_all_kinds_of_charge_add_up(points: list[np.ndarray]) -> None:
    tables = field_tables(TRIANGLES, None, SPHERES, CAPSULES, PLANES)
    potential, gradient, winding = potential_at_points(tables, np.array(points))
    for i, point in enumerate(points):
        kinds = [
            field(point, TRIANGLES),
            *[field(point, spheres=[ball]) for ball in SPHERES],
            field(point, capsules=CAPSULES),
            field(point, planes=PLANES),
        ]
        together = field(point, TRIANGLES, spheres=SPHERES, capsules=CAPSULES, planes=PLANES)
        assert potential[i] == together.potential == pytest.approx(sum(at.potential for at in kinds), rel=1e-12)
        scale = sum(float(np.linalg.norm(at.gradient)) for at in kinds)
        assert gradient[i] == pytest.approx(sum(at.gradient for at in kinds), rel=0.0, abs=1e-12 * scale)
        assert together.curvature == pytest.approx(sum(at.curvature for at in kinds), rel=1e-12)
        assert winding[i] == pytest.approx(sum(at.winding for at in kinds), abs=1e-12)


def test_nothing_charged_has_no_field() -> None:
    potential, gradient, winding = potential_at_points(field_tables(), np.zeros((3, 3)))
    assert not potential.any()
    assert not gradient.any()
    assert not winding.any()


def test_no_points_give_empty_answers() -> None:
    potential, gradient, winding = potential_at_points(field_tables(TRIANGLES), np.zeros((0, 3)))
    assert (potential.shape, gradient.shape, winding.shape) == ((0,), (0, 3), (0,))


@pytest.mark.parametrize("points", [np.zeros(3), np.zeros((2, 4)), np.array([[0.0, np.nan, 0.0]])])
def test_points_that_are_none_are_refused(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="`points` must"):
        potential_at_points(field_tables(TRIANGLES), points)


def test_other_kernels_can_call_it() -> None:
    @njit
    def potentials(points, triangles, spheres, capsules, planes):  # type: ignore[no-untyped-def]
        total = 0.0
        for i in range(points.shape[0]):
            total += field_at(points[i, 0], points[i, 1], points[i, 2], triangles, spheres, capsules, planes)[0]
        return total

    tables = field_tables(TRIANGLES, None, SPHERES, CAPSULES, PLANES)
    points = np.array([[1.0, 1.0, 1.0], [0.5, -2.0, 0.3]])
    assert potentials(points, *tables) == pytest.approx(potential_at_points(tables, points)[0].sum(), rel=1e-14)


def test_single_precision_is_refused() -> None:
    tables = field_tables(TRIANGLES)
    with pytest.raises(TypeError):
        field_at(0.0, 0.0, 2.0, tables.triangles.astype(np.float32), *tables[1:])


def test_kernel_runs_undecorated() -> None:
    tables = field_tables(TRIANGLES, None, SPHERES, CAPSULES, PLANES)
    assert field_at.py_func(0.5, 0.6, 0.7, *tables) == pytest.approx(field_at(0.5, 0.6, 0.7, *tables), rel=1e-12)
