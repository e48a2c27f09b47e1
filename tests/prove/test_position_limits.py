"""Position limits along a motion: exact excesses against roots and samples, and what the certificate says of them."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.prove.certificate import certify, motion_free
from guidefield.prove.curve import EXACT, excesses
from guidefield.prove.verdict import LIMIT_TOLERANCE, Reason
from tests.collision.scenery import box, world_of
from tests.robots import box_arm, grouped

ARM = grouped(box_arm("y", 2))  # two joints from -2 to 2

OVER = np.array([[0.0, 1.9], [0.1, 2.1], [0.2, 2.1], [0.3, 1.9]])
"""A cubic whose ends are within, and whose second joint reaches 2.05 halfway."""

UNDER = np.array([[0.0, 1.9], [0.1, 2.02], [0.2, 2.02], [0.3, 1.9]])
"""One whose control points are beyond the limit, and which is not: it reaches 1.99."""


def bezier(controls: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Points (n, nv) of a curve by Bernstein's polynomials."""
    degree = len(controls) - 1
    binomials = np.cumprod([1.0, *((degree - k) / (k + 1) for k in range(degree))])
    t = parameters[:, None]
    k = np.arange(degree + 1)
    return (binomials * t**k * (1.0 - t) ** (degree - k)) @ controls


def extremes_by_roots(controls: np.ndarray) -> np.ndarray:
    """Values (n,) of a curve of one coordinate at its ends and where its derivative vanishes."""
    degree = len(controls) - 1
    places = np.linspace(0.0, 1.0, degree + 1)
    values = bezier(controls[:, None], places)[:, 0]
    stops = np.polynomial.Polynomial.fit(places, values, degree, domain=[0.0, 1.0]).deriv().roots()
    stops = stops[np.abs(stops.imag) < 1e-7].real
    inside = np.r_[0.0, 1.0, stops[(stops > 0.0) & (stops < 1.0)]]
    return bezier(controls[:, None], inside)[:, 0]


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.integers(1, 5))
def test_agrees_with_the_roots_of_the_derivative(seed, degree):
    rng = np.random.default_rng(seed)
    pieces = rng.normal(size=(3, degree + 1, 2))
    lower, upper = np.array([-0.3, -np.inf]), np.array([0.5, 0.2])
    found, places = excesses(pieces, lower, upper)
    for piece in range(3):
        for c in range(2):
            values = extremes_by_roots(pieces[piece, :, c])
            expected = max(lower[c] - values.min(), values.max() - upper[c])
            if expected > 0.0:
                assert found[piece, c] == pytest.approx(expected, abs=1e-11)
                there = bezier(pieces[piece], places[piece, [c]])[0, c]
                assert max(lower[c] - there, there - upper[c]) == pytest.approx(found[piece, c], abs=10 * EXACT)
            else:
                assert found[piece, c] <= EXACT


def test_a_curve_that_only_touches_its_limit_keeps_it():
    touching = np.array([[[0.0], [2.0 / 3.0], [2.0 / 3.0], [0.0]]])  # reaches 1/2
    assert excesses(touching, np.array([-1.0]), np.array([0.5]))[0][0, 0] <= EXACT
    assert excesses(touching, np.array([-1.0]), np.array([0.5 - 1e-9]))[0][0, 0] == pytest.approx(1e-9, abs=1e-12)


def test_the_certificate_refuses_what_is_beyond_a_limit_between_the_samples():
    world = world_of(ARM, [])
    verdict = certify(world, np.array([UNDER, OVER]))
    assert not verdict.free
    assert verdict.reason is Reason.BEYOND_LIMITS
    assert (verdict.piece, verdict.free_until, verdict.pair) == (1, (1, 0.0), None)
    assert verdict.parameter == pytest.approx(0.5, abs=1e-5)
    assert (verdict.beyond.joint, verdict.beyond.lower, verdict.beyond.upper) == ("j2", -2.0, 2.0)
    assert verdict.beyond.value == pytest.approx(2.05, abs=1e-12)
    np.testing.assert_allclose(verdict.chart_point, [0.15, 2.05], atol=1e-5)


def test_control_points_may_be_beyond_limits_where_the_curve_is_not():
    assert certify(world_of(ARM, []), UNDER[None]).free


def test_only_rounding_is_tolerated():
    world = world_of(ARM, [])
    assert motion_free(world, np.zeros(2), np.array([0.0, 2.0 + 0.9 * LIMIT_TOLERANCE])).free
    assert motion_free(world, np.zeros(2), np.array([-2.0 - 1.1 * LIMIT_TOLERANCE, 0.0])).reason is Reason.BEYOND_LIMITS


def test_whichever_comes_first_is_told():
    above = box("above", (0.1, 0.1, 0.1), (0.0, 0.0, 0.85))  # where the upright arm ends
    world = world_of(ARM, [above])
    upright, aside, beyond = np.zeros(2), np.array([1.5, 0.0]), np.array([1.5, 2.5])
    assert certify(world, np.array([[aside, upright], [aside, beyond]])).reason is Reason.CONTACT
    refused = certify(world, np.array([[aside, beyond], [aside, upright]]))
    assert (refused.reason, refused.piece) == (Reason.BEYOND_LIMITS, 0)
    assert certify(world, np.array([[aside, aside]])).free


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_never_free(value):
    with pytest.raises(ValueError, match="finite"):
        certify(world_of(ARM, []), np.array([[[0.5, 0.0], [value, 0.0]]]))
