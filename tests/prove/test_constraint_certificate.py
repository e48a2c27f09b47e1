"""Path constraints: gradients by differences; what is certified is kept wherever one looks."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.deadline import Deadline
from guidefield.prove.certificate import certify_constraints
from guidefield.prove.verdict import Reason
from guidefield.robot.group.path_constraints import Cone, ConstrainedFrames, line, plane
from tests.collision.plain import dense
from tests.collision.scenery import world_of
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
        z = arm.chart(arm.random(rng))
        _, rows = frames.values_and_rows(z)
        h = 1e-6 * np.eye(arm.nv)
        expected = np.array([(frames.values(z + d) - frames.values(z - d)) / 2e-6 for d in h]).T
        np.testing.assert_allclose(rows, expected, atol=1e-6)


def test_the_numbers_mean_what_they_say():
    arm = group("panda")
    z = arm.chart(arm.random(np.random.default_rng(1)))
    cone, near_plane, near_line = constraints(arm.tip)
    here = ConstrainedFrames(arm, (cone,))
    assert here.values(z)[0] == pytest.approx(np.arccos(_placement(arm, z).rotation[2] @ ASKEW))
    away = _placement(arm, z).translation - near_plane.point
    values = ConstrainedFrames(arm, (near_plane, near_line)).values(z)
    assert values[0] == pytest.approx(abs(away @ ASKEW))
    assert values[1] == pytest.approx(np.linalg.norm(np.cross(away, ASKEW)))


def _placement(arm, z):
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, arm.from_chart(z))
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
    control = arm.chart(arm.random(rng)) + np.cumsum(rng.normal(size=(4, arm.nv)) * rng.choice([0.02, 0.2]), axis=0)
    samples = dense(control, 2e-3)
    for constraint in constraints(arm.tip):
        frames = ConstrainedFrames(arm, (constraint,))
        most = max(frames.values(z)[0] for z in samples)
        kept = ConstrainedFrames(arm, (dataclasses.replace(constraint, limit=1.02 * most + 1e-3),))
        assert certify_constraints(kept, turns, control[None]).free
        broken = ConstrainedFrames(arm, (dataclasses.replace(constraint, limit=most - 1e-4),))
        verdict = certify_constraints(broken, turns, control[None])
        assert not verdict.free
        assert np.abs(samples - verdict.chart_point).max(axis=1).min() < 3e-3
        assert broken.values(verdict.chart_point)[0] > broken.limits[0] - 1e-4


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
    assert frames.values(off.chart_point)[0] > 1e-4 - 1e-9


def test_a_judgement_that_is_stopped_says_so():
    arm = group("panda")
    frames = ConstrainedFrames(arm, constraints(arm.tip, 10.0))
    verdict = certify_constraints(frames, world_of(arm, []).bodies.turns, np.zeros((2, 4, 7)), Deadline(0.0))
    assert verdict.reason is Reason.STOPPED
    assert not verdict.free
