"""Trees: within the error that the caller chose, by a bound that is never exceeded."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.geometry import surfaces
from guidefield.geometry.charged import at_angle, field_tables, never, within
from guidefield.kernels.field.field import field_at_points
from guidefield.kernels.field.field_tables import single_precision
from tests.kernels.evaluation import potential_at_points

BALL = surfaces.sphere(0.5, subdivisions=4)
BUMPY = BALL.corners * (1.0 + 0.2 * np.sin(7.0 * BALL.corners[..., :1]) * np.cos(5.0 * BALL.corners[..., 1:2]))


@settings(deadline=None, max_examples=9)
@given(st.integers(0, 1000), st.sampled_from([1e-1, 1e-2, 1e-3, 1e-5]))
def test_the_error_is_within_what_was_asked_for(seed: int, error: float) -> None:
    points = np.random.default_rng(seed).uniform(-2.0, 2.0, (24, 3))
    tables = field_tables(BUMPY, opening=within(error))
    exact, fast = field_at_points(field_tables(BUMPY), points), field_at_points(tables, points)
    assert np.abs(fast.potential / exact.potential - 1.0).max() <= error
    steep = exact.potential / np.maximum(np.abs(np.linalg.norm(points, axis=1) - 0.5), 0.05)
    assert (np.linalg.norm(fast.gradient - exact.gradient, axis=1) <= 3.0 * error * steep).all()
    rough = single_precision(tables, np.zeros(3))
    assert potential_at_points(rough, points) == pytest.approx(field_at_points(rough, points).potential, rel=1e-5)
    assert np.abs(fast.winding - exact.winding).max() < 0.1


def test_no_error_is_no_expansion() -> None:
    points = np.random.default_rng(3).uniform(-2.0, 2.0, (8, 3))
    exact = field_at_points(field_tables(BUMPY), points)
    blocks = [field_at_points(field_tables(part), points) for part in np.array_split(BUMPY, 7)]
    assert exact.potential == pytest.approx(sum(at.potential for at in blocks), rel=1e-13)
    assert exact.gradient == pytest.approx(sum(at.gradient for at in blocks), rel=1e-11)


def test_reach_solves_the_bound() -> None:
    radii, spreads = np.array([0.1, 0.1, 2.0]), np.array([0.3, 1.0, 0.5])
    for error in (1e-2, 1e-4):
        theta = radii / within(error)(radii, spreads)
        bound = (1 + theta) ** 3 * spreads * ((1 - theta) ** -3 - 1 - 3 * theta - 6 * theta**2)
        assert bound == pytest.approx(np.full(3, error), rel=1e-6)
    assert np.isinf(never(radii, spreads)).all()


@pytest.mark.parametrize(("theta", "error"), [(0.1, 3e-5), (0.2, 5e-4), (0.3, 7e-3)])
def test_the_errors_that_are_stated_for_angles(theta: float, error: float) -> None:
    points = np.random.default_rng(5).uniform(-1.5, 1.5, (200, 3))
    exact = field_at_points(field_tables(BUMPY), points)
    fast = field_at_points(field_tables(BUMPY, opening=at_angle(theta)), points)
    assert np.abs(fast.potential / exact.potential - 1.0).max() <= error
