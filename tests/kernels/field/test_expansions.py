"""Trees: within the error that the caller chose, by a bound that is never exceeded."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.geometry import surfaces
from guidefield.geometry.charged import expand_within, field_tables
from guidefield.kernels.field.field import field_at_points, single_precision
from tests.kernels.evaluation import potential_at_points

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
