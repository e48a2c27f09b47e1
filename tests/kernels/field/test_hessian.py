from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from guidefield.geometry.charged import field_tables
from tests.kernels.evaluation import field, rigid_motions, triangles, vectors
from tests.kernels.field.hessian import hessian_at_points
from tests.oracles import EPS, PolygonCase, distance_to_triangle, polygon_cases

HESSIAN_ULPS = 64

laws = settings(deadline=None, max_examples=18)


def hessian(point: np.ndarray, corners: np.ndarray) -> np.ndarray:
    matrix: np.ndarray = hessian_at_points(field_tables(corners), point[None])[0]
    return matrix


@pytest.mark.parametrize("case", polygon_cases(), ids=lambda case: case.name)
def test_agrees_with_the_high_precision_oracle(case: PolygonCase) -> None:
    error = np.linalg.norm(hessian(case.point, case.triangles) - case.hessian)
    assert error <= HESSIAN_ULPS * EPS * case.condition * np.linalg.norm(case.hessian)


@laws
@given(triangles, vectors(2.0))
def test_is_the_derivative_of_the_gradient(corners: np.ndarray, point: np.ndarray) -> None:
    near = distance_to_triangle(point, corners)
    assume(near > 0.02)
    step = 1e-4 * near
    columns = [
        (field(point + e, corners[None]).gradient - field(point - e, corners[None]).gradient) / (2.0 * step)
        for e in step * np.eye(3)
    ]
    matrix = hessian(point, corners[None])
    assert np.array(columns) == pytest.approx(matrix, rel=0.0, abs=1e-5 * np.linalg.norm(matrix))
    assert matrix == pytest.approx(matrix.T, rel=1e-12, abs=1e-12 * np.linalg.norm(matrix))


@laws
@given(triangles, vectors(2.0))
def test_trace_and_bound(corners: np.ndarray, point: np.ndarray) -> None:
    near = distance_to_triangle(point, corners)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    height = float(normal @ (point - corners[0]))
    assume(near > 1e-3 and abs(height) > 1e-3)
    at, matrix = field(point, corners[None]), hessian(point, corners[None])
    expected = -2.0 * float(normal @ at.gradient) / height
    assert np.trace(matrix) == pytest.approx(expected, rel=1e-7, abs=1e-10 * at.potential / near**2)
    assert np.linalg.norm(matrix, 2) <= 12.0 * at.potential / near**2 * (1.0 + 1e-9)


@laws
@given(triangles, vectors(2.0), rigid_motions(), st.floats(-4.0, 4.0))
def test_scales_and_turns(
    corners: np.ndarray, point: np.ndarray, motion: tuple[np.ndarray, np.ndarray], exponent: float
) -> None:
    assume(distance_to_triangle(point, corners) > 0.05)
    (rotation, translation), size = motion, 10.0**exponent
    here = hessian(point, corners[None])
    there = hessian(size * (rotation @ point + translation), (size * (corners @ rotation.T + translation))[None])
    expected = rotation @ here @ rotation.T
    assert size**3 * there == pytest.approx(expected, rel=0.0, abs=1e-9 * np.linalg.norm(here))


def test_only_triangles() -> None:
    with pytest.raises(ValueError, match="triangles only"):
        hessian_at_points(field_tables(spheres=[[0, 0, 0, 1, 1]]), np.zeros((1, 3)))
