"""Quadrilaterals and polygons of them: one arctangent for two triangles must be the two triangles."""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from guidefield.geometry import surfaces
from guidefield.geometry.charged import convex_quads
from tests.kernels.evaluation import field, rigid_motions, vectors
from tests.oracles import EPS, PolygonCase, distance_to_triangle, fan, polygon_cases

laws = settings(deadline=None, max_examples=18)

CONVEX = [case for case in polygon_cases() if len(case.vertices) > 3 and "nonconvex" not in case.tags]


@st.composite
def convex_quads_in_space(draw: st.DrawFn) -> np.ndarray:
    """A flat convex quadrilateral of ordinary proportions, shape (4, 3)."""
    angles = [draw(st.floats(k + 0.1, k + 0.9)) * 0.5 * np.pi for k in range(4)]
    rotation, translation = draw(rigid_motions())
    stretch = draw(st.floats(0.2, 1.0))
    return np.array([(np.cos(a), stretch * np.sin(a), 0.0) for a in angles]) @ rotation.T + translation


@pytest.mark.parametrize("case", CONVEX, ids=lambda case: case.name)
def test_polygons_agree_with_the_high_precision_oracle(case: PolygonCase) -> None:
    quads, rest = convex_quads(case.vertices)
    at = field(case.point, rest, quads=quads)
    assert abs(at.potential - case.potential) <= 8 * EPS * case.condition * case.potential
    assert np.linalg.norm(at.gradient - case.gradient) <= 16 * EPS * case.condition * np.linalg.norm(case.gradient)
    assert -4.0 * np.pi * at.winding == pytest.approx(case.solid_angle, rel=8 * EPS * case.condition, abs=8 * EPS)


@laws
@given(convex_quads_in_space(), vectors(2.0))
def test_agrees_with_its_two_triangles(corners: np.ndarray, point: np.ndarray) -> None:
    assume(min(distance_to_triangle(point, triangle) for triangle in fan(corners)) > 0.01)
    one, two = field(point, quads=corners[None]), field(point, fan(corners))
    assert one.potential == pytest.approx(two.potential, rel=1e-12)
    steep = float(np.linalg.norm(two.gradient))
    assert one.gradient == pytest.approx(two.gradient, rel=0.0, abs=1e-11 * steep)
    assert one.curvature == pytest.approx(two.curvature, rel=1e-9, abs=1e-12 * two.potential**3)
    assert one.curvature >= 0.0
    assert one.winding == pytest.approx(two.winding, abs=1e-14)


@laws
@given(vectors(1.5))
def test_a_prism_of_quads_is_the_prism_of_triangles(point: np.ndarray) -> None:
    prism = surfaces.cylinder(0.3, 0.8)
    near = min(distance_to_triangle(point, corners) for corners in prism.corners)
    assume(near > 1e-4)
    quads, mesh = field(point, quads=surfaces.prism_quads(0.3, 0.8)), field(point, prism.corners)
    assert quads.potential == pytest.approx(mesh.potential, rel=1e-14 / near)
    assert quads.gradient == pytest.approx(mesh.gradient, rel=0.0, abs=1e-13 * mesh.potential / near**2)
    assert quads.winding == pytest.approx(mesh.winding, abs=1e-12)
