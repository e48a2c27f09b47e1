"""Path constraints and position limits: gradients by differences, exact excesses, and what is certified is kept."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.deadline import Deadline
from guidefield.prove.certificate import certify, certify_constraints, motion_free
from guidefield.prove.curve import EXACT, excesses
from guidefield.prove.verdict import LIMIT_TOLERANCE, Reason
from guidefield.robot.group.path_constraints import Cone, ConstrainedFrames, line, plane
from tests.collision.plain import dense
from tests.collision.scenery import box, world_of
from tests.robots import ARMS, box_arm, group, grouped

UP, ASKEW = np.array([0.0, 0.0, 1.0]), np.array([0.48, -0.6, 0.64])


def constraints(frame: str, limit: float = 1.0):
    point = np.array([0.3, 0.1, 0.5])
    return Cone(frame, ASKEW, UP, limit), plane(frame, point, ASKEW, limit), line(frame, point, ASKEW, limit)


@pytest.mark.parametrize("name", ARMS)
def test_rows_are_the_derivatives_of_the_numbers(name):
    arm = group(name)
    frames = ConstrainedFrames(arm, constraints(arm.tip))
    rng = np.random.default_rng(0)
    for _ in range(10):
        z = arm.to_local(arm.random(rng))
        _, rows = frames.values_and_rows(z)
        h = 1e-6 * np.eye(arm.nv)
        expected = np.array([(frames.values(z + d) - frames.values(z - d)) / 2e-6 for d in h]).T
        np.testing.assert_allclose(rows, expected, atol=1e-6)


def test_the_numbers_mean_what_they_say():
    arm = group("panda")
    z = arm.to_local(arm.random(np.random.default_rng(1)))
    cone, near_plane, near_line = constraints(arm.tip)
    here = ConstrainedFrames(arm, (cone,))
    assert here.values(z)[0] == pytest.approx(np.arccos(_placement(arm, z).rotation[2] @ ASKEW))
    away = _placement(arm, z).translation - near_plane.point
    values = ConstrainedFrames(arm, (near_plane, near_line)).values(z)
    assert values[0] == pytest.approx(abs(away @ ASKEW))
    assert values[1] == pytest.approx(np.linalg.norm(np.cross(away, ASKEW)))


def _placement(arm, z):
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, arm.from_local(z))
    return data.oMf[arm.tip_id]


@settings(max_examples=18)
@given(
    st.sampled_from(["panda", "slide y slide x", "y x mimic mimic", "continuous y", "continuous screw half-gear"]),
    st.integers(0, 10**6),
)
def test_what_is_certified_is_kept_and_what_is_not_is_shown(kind, seed):
    arm = group(kind) if kind == "panda" else grouped(box_arm(kind, 0))
    rng = np.random.default_rng(seed)
    turns = world_of(arm, []).bodies.turns
    control = arm.to_local(arm.random(rng)) + np.cumsum(rng.normal(size=(4, arm.nv)) * rng.choice([0.02, 0.2]), axis=0)
    samples = dense(control, 2e-3)
    for constraint in constraints(arm.tip):
        frames = ConstrainedFrames(arm, (constraint,))
        most = max(frames.values(z)[0] for z in samples)
        kept = ConstrainedFrames(arm, (dataclasses.replace(constraint, limit=1.02 * most + 1e-3),))
        assert certify_constraints(kept, turns, control[None]).free
        broken = ConstrainedFrames(arm, (dataclasses.replace(constraint, limit=most - 1e-4),))
        verdict = certify_constraints(broken, turns, control[None])
        assert not verdict.free
        assert np.abs(samples - verdict.local_point).max(axis=1).min() < 3e-3
        assert broken.values(verdict.local_point)[0] > broken.limits[0] - 1e-4


def test_joints_that_cancel_are_certified_to_keep_a_narrow_constraint_in_few_evaluations():
    """The tip goes on without turning; by what each joint turns alone, 40,000 parts would have to be looked at."""
    arm = grouped(box_arm("y y", 0))
    turns = world_of(arm, []).bodies.turns
    way = np.array([[0.0, 0.0], [1.0, -1.0]])
    frames = ConstrainedFrames(arm, (Cone(arm.tip, UP, UP, 1e-4),))
    verdict = certify_constraints(frames, turns, way[None])
    assert verdict.free
    assert verdict.evaluations < 1000
    off = certify_constraints(frames, turns, (way + np.array([[0.0, 0.0], [0.0, 1.2e-4]]))[None])
    assert not off.free
    assert frames.values(off.local_point)[0] > 1e-4 - 1e-9


def test_a_judgement_that_is_stopped_says_so():
    arm = group("panda")
    frames = ConstrainedFrames(arm, constraints(arm.tip, 10.0))
    verdict = certify_constraints(frames, world_of(arm, []).bodies.turns, np.zeros((2, 4, 7)), Deadline(0.0))
    assert verdict.reason is Reason.STOPPED
    assert not verdict.free


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
    np.testing.assert_allclose(verdict.local_point, [0.15, 2.05], atol=1e-5)


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
