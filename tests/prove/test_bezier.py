"""Halves and parts of Bezier curves."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from guidefield.prove.curve import halve_curves, point_on, ranges, restrict_curves


@given(st.integers(1, 4), st.integers(1, 7), st.integers(0, 2**32 - 1))
def test_halves_are_the_curve_from_0_to_a_half_and_from_there_to_1(count, points, seed):
    curves = np.random.default_rng(seed).normal(size=(count, 2 * points, 3))[:, ::2]  # not one behind the other
    twice, start = np.repeat(curves, 2, axis=0), np.tile([0.0, 0.5], count)
    assert halve_curves(curves) == pytest.approx(restrict_curves(twice, start, start + 0.5), rel=0.0, abs=1e-12)


@given(st.integers(1, 7), st.floats(0.0, 1.0), st.integers(0, 2**32 - 1))
def test_a_part_of_no_length_is_a_point_within_the_ranges(points, parameter, seed):
    curve = np.random.default_rng(seed).normal(size=(1, points, 3))
    at = np.array([parameter])
    point = point_on(curve[0], parameter)
    assert restrict_curves(curve, at, at)[0] == pytest.approx(np.tile(point, (points, 1)), rel=0.0, abs=1e-12)
    low, high = ranges(curve)
    assert (low[0] - 1e-12 <= point).all()
    assert (point <= high[0] + 1e-12).all()
