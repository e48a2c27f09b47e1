"""The barrier as a function of distance: what its docstring promises."""

import numpy as np
import pytest

from guidefield.kernels.barrier.sampled_robot import SOFT, barrier
from tests.kernels.parts import from_python

of_a_size = from_python(barrier)

RANGES = (0.08, 0.04, 0.012)


def penalty(distance: float, reach: float) -> tuple[float, float, float]:
    """The barrier of a robot of usual size."""
    return of_a_size(distance, reach, 1.0)


@pytest.mark.parametrize("reach", RANGES)
def test_it_is_the_formula_between_soft_and_range(reach: float) -> None:
    for distance in np.linspace(max(SOFT, 0.5 * reach), reach, 20):
        x = distance / reach
        assert penalty(distance, reach)[0] == pytest.approx((1.0 - x) ** 2 / x**3, abs=1e-12)


@pytest.mark.parametrize("reach", RANGES)
def test_its_derivatives_are_its_own(reach: float) -> None:
    step = 1e-6 * reach
    for distance in (-0.3, -0.01, 0.0, 0.004, 0.3 * reach, 0.7 * reach, 0.95 * reach, 1.5 * reach):
        before, here, after = (penalty(distance + k * step, reach) for k in (-1, 0, 1))
        assert here[1] == pytest.approx((after[0] - before[0]) / (2 * step), rel=1e-5, abs=1e-5)
        if abs(distance - SOFT) > step:
            assert here[2] == pytest.approx((after[1] - before[1]) / (2 * step), rel=1e-5, abs=1e-3)


@pytest.mark.parametrize("reach", RANGES)
def test_it_falls_is_convex_and_continuous(reach: float) -> None:
    distances = np.linspace(-0.5, 1.2 * reach, 20001)
    values, slopes, curvatures = np.array([penalty(d, reach) for d in distances]).T
    assert (np.diff(values) <= 0.0).all()
    assert (np.diff(slopes) >= -1e-9 * np.abs(slopes).max()).all()
    assert (curvatures >= 0.0).all()
    for edge in (min(SOFT, 0.5 * reach), reach):
        a, b = penalty(edge - 1e-12, reach), penalty(edge + 1e-12, reach)
        np.testing.assert_allclose(a[:2], b[:2], rtol=1e-6, atol=1e-6)
    assert penalty(reach, reach) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("distance", [-0.01, 0.004, 0.03])
def test_it_goes_with_the_size(distance: float) -> None:
    value, slope, curvature = penalty(distance, 0.08)
    assert of_a_size(8.0 * distance, 8.0 * 0.08, 8.0) == pytest.approx((value, slope / 8.0, curvature / 64.0))
