"""Kinds of charge add up, in both precisions; trees keep within the error that the caller chose, by a bound."""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from guidefield.geometry import surfaces
from guidefield.geometry.charged import expand_within, field_tables
from guidefield.kernels.field.field import field_at_points, single_precision
from tests.kernels.evaluation import field, potential_at_points, vectors

TRIANGLES = surfaces.box((0.4, 1.0, 0.6)).corners
SPHERES = [[1.0, 0.0, 0.0, 0.2, 1.5], [0.0, 2.0, 0.0, 0.3, 0.5]]
CAPSULES = [[0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.1, 2.0]]
PLANES = [[0.0, 0.0, 1.0, -1.0, 0.7]]


@settings(max_examples=18)
@given(st.lists(vectors(3.0), min_size=1, max_size=5))
def test_all_kinds_of_charge_add_up(points: list[np.ndarray]) -> None:
    tables = field_tables(TRIANGLES, None, SPHERES, CAPSULES, PLANES)
    potential, gradient, _, winding = field_at_points(tables, np.array(points))
    # near a surface rounding counts the more the higher the potential is
    alone = potential_at_points(tables, np.array(points))
    assert (np.abs(alone - potential) <= 1e-12 * potential + 1e-14 * potential**2).all()
    for i, point in enumerate(points):
        kinds = [
            field(point, TRIANGLES),
            *[field(point, spheres=[ball]) for ball in SPHERES],
            field(point, capsules=CAPSULES),
            field(point, planes=PLANES),
        ]
        together = field(point, TRIANGLES, spheres=SPHERES, capsules=CAPSULES, planes=PLANES)
        assert potential[i] == pytest.approx(together.potential, rel=1e-14)
        assert together.potential == pytest.approx(sum(at.potential for at in kinds), rel=1e-12)
        scale = sum(float(np.linalg.norm(at.gradient)) for at in kinds)
        assert gradient[i] == pytest.approx(sum(at.gradient for at in kinds), rel=0.0, abs=1e-12 * scale)
        assert together.curvature == pytest.approx(sum(at.curvature for at in kinds), rel=1e-12)
        assert winding[i] == pytest.approx(sum(at.winding for at in kinds), abs=1e-12)


BOXES = [[0.3, -0.2, 0.5, 1, 0, 0, 0, 0.6, 0.8, 0, -0.8, 0.6, 0.3, 0.7, 0.2, 1.3]]


@settings(max_examples=18)
@given(vectors(2.5))
def test_single_precision_agrees(point: np.ndarray) -> None:
    tables = field_tables(TRIANGLES, None, SPHERES, CAPSULES, PLANES, boxes=BOXES)
    exact = field_at_points(tables, point[None])
    # Distance to everything, from the nearest: the potential is at most 2 pi/d of each of about ten faces.
    assume(exact.potential[0] < 200.0)
    rough = field_at_points(single_precision(tables, np.array([0.1, 0.2, 0.3])), point[None])
    assert rough.potential[0] == pytest.approx(exact.potential[0], rel=3e-5)
    scale = exact.potential[0] ** 2
    assert rough.gradient[0] == pytest.approx(exact.gradient[0], rel=0.0, abs=1e-4 * scale)
    assert rough.winding[0] == pytest.approx(exact.winding[0], abs=1e-5)
    assert potential_at_points(single_precision(tables, np.zeros(3)), point[None])[0] == pytest.approx(
        exact.potential[0], rel=3e-5
    )


BALL = surfaces.sphere(0.5, subdivisions=4)
BUMPY = BALL.corners * (1.0 + 0.2 * np.sin(7.0 * BALL.corners[..., :1]) * np.cos(5.0 * BALL.corners[..., 1:2]))


@settings(max_examples=9)
@given(st.integers(0, 1000), st.sampled_from([1e-1, 1e-2, 1e-3, 1e-5]))
def test_the_error_is_within_what_was_asked_for(seed: int, error: float) -> None:
    points = np.random.default_rng(seed).uniform(-2.0, 2.0, (24, 3))
    tables = field_tables(BUMPY, opening=expand_within(error))
    exact, fast = field_at_points(field_tables(BUMPY), points), field_at_points(tables, points)
    assert np.abs(fast.potential / exact.potential - 1.0).max() <= error
    steep = exact.potential / np.maximum(np.abs(np.linalg.norm(points, axis=1) - 0.5), 0.05)
    assert (np.linalg.norm(fast.gradient - exact.gradient, axis=1) <= 3.0 * error * steep).all()
    rough = single_precision(tables, np.zeros(3))
    assert potential_at_points(rough, points) == pytest.approx(field_at_points(rough, points).potential, rel=1e-5)
    assert np.abs(fast.winding - exact.winding).max() < 0.1
