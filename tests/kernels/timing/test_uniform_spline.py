"""Places on a uniform B-spline, against the cubic through its knots and finite differences."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st
from scipy.interpolate import BSpline

from guidefield.kernels.timing.hermite import spline_points, spline_slopes


@given(st.integers(0, 1000), st.integers(1, 12), st.integers(1, 4))
def test_they_are_those_of_de_boors_basis(seed: int, pieces: int, nv: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(pieces + 3, nv))
    expected = BSpline(np.arange(-3.0, pieces + 4.0), points, 3)
    places = np.r_[0.0, np.sort(rng.uniform(0.0, pieces, 6)), float(pieces)]
    found, slopes = np.empty((len(places), nv)), np.empty((len(places), nv))
    spline_points(points, places, found)
    spline_slopes(points, places, slopes)
    np.testing.assert_allclose(found, expected(places), atol=1e-13)
    np.testing.assert_allclose(slopes, expected.derivative()(places), atol=1e-12)
