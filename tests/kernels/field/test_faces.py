import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from tests.kernels.evaluation import field, gradient_by_differences, triangles, vectors
from tests.oracles import (
    EPS,
    PolygonCase,
    SolidCase,
    distance_to_triangle,
    edge_sum_potential,
    polygon_cases,
    solid_cases,
)

# What an ulp in a corner changes is about EPS * K, K = farthest corner over distance; see oracle/README.md.
POTENTIAL_ULPS = 8
GRADIENT_ULPS = 16

laws = settings(deadline=None, max_examples=18)

MESHES = [case for case in solid_cases() if case.kind == "mesh"]


def condition(point: np.ndarray, corners: np.ndarray) -> float:
    corners = corners.reshape(-1, 3, 3)
    extent = np.linalg.norm(corners - point, axis=2).max()
    return float(extent / min(distance_to_triangle(point, triangle) for triangle in corners))


@pytest.mark.parametrize("case", polygon_cases(), ids=lambda case: case.name)
def test_polygon_agrees_with_the_high_precision_oracle(case: PolygonCase) -> None:
    at = field(case.point, case.triangles)
    assert abs(at.potential - case.potential) <= POTENTIAL_ULPS * EPS * case.condition * case.potential
    error = np.linalg.norm(at.gradient - case.gradient)
    assert error <= GRADIENT_ULPS * EPS * case.condition * np.linalg.norm(case.gradient)
    assert -4.0 * math.pi * at.winding == pytest.approx(case.solid_angle, rel=8 * EPS * case.condition, abs=8 * EPS)


@pytest.mark.parametrize("case", MESHES, ids=lambda case: case.name)
def test_closed_mesh_agrees_with_the_high_precision_oracle(case: SolidCase) -> None:
    at = field(case.point, case.shape["triangles"])
    K = condition(case.point, case.shape["triangles"])
    assert abs(at.potential - case.potential) <= POTENTIAL_ULPS * EPS * K * case.potential
    # Faces on opposite sides cancel: the scale of the gradient is 3 Phi / distance at most.
    distance = min(distance_to_triangle(case.point, triangle) for triangle in case.shape["triangles"])
    assert np.linalg.norm(at.gradient - case.gradient) <= GRADIENT_ULPS * EPS * K * 3.0 * case.potential / distance
    assert at.winding == pytest.approx(case.winding, abs=1e-14)


@laws
@given(triangles, vectors(2.0))
def test_agrees_with_the_edge_sum(corners: np.ndarray, point: np.ndarray) -> None:
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    assume(abs(normal @ (point - corners[0])) > 0.05 * np.linalg.norm(normal))
    assert field(point, corners[None]).potential == pytest.approx(edge_sum_potential(point, corners), rel=1e-11)


@laws
@given(triangles, vectors(2.0))
def test_gradient_is_the_derivative_of_the_potential(corners: np.ndarray, point: np.ndarray) -> None:
    distance = distance_to_triangle(point, corners)
    assume(distance > 0.01)
    at = field(point, corners[None])
    differences = gradient_by_differences(point, 1e-3 * distance, triangles=corners[None])
    assert differences == pytest.approx(at.gradient, rel=0.0, abs=1e-8 * at.potential / distance)


@laws
@given(triangles, vectors(2.0))
def test_curvature_is_the_derivative_with_the_height_at_constant_denominator(
    corners: np.ndarray, point: np.ndarray
) -> None:
    # Phi = (2/h) atan2(4 A h, F): the classical F, differentiated numerically in h alone.
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    area = 0.5 * float(np.linalg.norm(normal))
    normal /= 2.0 * area
    h = abs(float(normal @ (point - corners[0])))
    assume(h > 0.05)
    l1, l2, l3 = np.linalg.norm(corners - point, axis=1)
    L1, L2, L3 = (np.linalg.norm(corners[(i + 2) % 3] - corners[(i + 1) % 3]) for i in range(3))
    F = (l1 + l2) * (l2 + l3) * (l3 + l1) - L1**2 * l1 - L2**2 * l2 - L3**2 * l3

    def phi(height: float) -> float:
        return 2.0 / height * math.atan2(4.0 * area * height, F)

    step = 1e-3 * h
    slope = (8.0 * (phi(h + step) - phi(h - step)) - phi(h + 2 * step) + phi(h - 2 * step)) / (12.0 * step)
    at = field(point, corners[None])
    assert at.curvature == pytest.approx(-2.0 * slope / h, rel=1e-6, abs=1e-8 * at.potential / h**2)


@laws
@given(triangles, vectors(2.0), st.floats(-1e-9, 1e-9))
def test_curvature_is_never_negative(corners: np.ndarray, point: np.ndarray, height: float) -> None:
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    in_plane = point - normal * (normal @ (point - corners[0]))
    for p in (point, in_plane, in_plane + height * normal, corners[0], corners.mean(axis=0)):
        curvature = field(p, corners[None]).curvature
        assert curvature >= 0.0
        assert math.isfinite(curvature)
