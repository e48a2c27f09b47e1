"""What controllers draw: against polynomials solved for, dense samples, and how ros2_control describes it."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.interpolate import BPoly, CubicHermiteSpline

from guidefield.errors import MalformedRequest
from guidefield.messages.scene import Box
from guidefield.planner.motion.drawn_motion import deviations, draw_plan
from guidefield.planner.motion.limit_load import measure_limit_shares
from guidefield.planner.motion.submitted_motion import CurveKind
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion_certificate import choose_execution, judge
from guidefield.planner.task.problem import ConfigurationGoal, ControllerModel, Interpolation
from guidefield.prove.curve import largest_magnitudes, point_on
from guidefield.prove.verdict import Reason
from tests.planner.problems import problem, scene_of
from tests.robots import box_arm, group, grouped

NV = 7


def planned(seed: int, knots: int = 6) -> Trajectory:
    """A motion whose acceleration jumps at knots, from 1 s on."""
    rng = np.random.default_rng(seed)
    times = 1.0 + np.cumsum(np.r_[0.0, rng.uniform(0.05, 0.4, knots - 1)])
    velocities = rng.normal(size=(knots, NV))
    velocities[[0, -1]] = 0.0
    return Trajectory(times, np.cumsum(rng.normal(size=(knots, NV)) * 0.1, axis=0), velocities)


def execution(kind: str, rate: float | None = None, tolerance: float = 0.0) -> ControllerModel:
    return ControllerModel(Interpolation(kind), rate, np.full(NV, tolerance))


def solved(t0: float, t1: float, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Coefficients of the polynomial with the position and its derivatives, (k,), at both ends."""
    k, size = len(first), 2 * len(first)
    rows = []
    for t in (0.0, t1 - t0):
        for order in range(k):
            row = np.zeros(size)
            for power in range(order, size):
                row[power] = np.prod(np.arange(power - order + 1, power + 1.0)) * t ** (power - order)
            rows.append(row)
    return np.linalg.solve(np.array(rows), np.r_[first, last])


@settings(max_examples=10)
@given(st.integers(0, 10**6), st.sampled_from([None, 3.0, 50.0]), st.integers(1, 3))
def test_a_quintic_is_the_polynomial_of_positions_velocities_and_accelerations(seed, rate, parts):
    drawn = draw_plan(planned(seed), execution("quintic", rate), parts)
    for row, (t0, t1) in enumerate(itertools.pairwise(drawn.times)):
        times = np.linspace(t0, t1, 7)
        found = drawn.motion.scheduled.evaluate(times)[0]
        for j in (0, NV - 1):
            ends = [
                np.array([drawn.positions[r, j], drawn.velocities[r, j], drawn.accelerations[r, j]])
                for r in (row, row + 1)
            ]
            wanted = np.polynomial.Polynomial(solved(t0, t1, *ends))(times - t0)
            np.testing.assert_allclose(found[:, j], wanted, atol=1e-9)


@settings(max_examples=10)
@given(st.integers(0, 10**6), st.sampled_from([None, 7.0, 125.0]))
def test_a_cubic_of_rows_on_the_plan_is_the_plan(seed, rate):
    plan = planned(seed)
    drawn = draw_plan(plan, execution("cubic", rate), 1)
    times = np.linspace(plan.times[0], plan.times[-1], 301)
    other = CubicHermiteSpline(drawn.times, drawn.positions, drawn.velocities)(times)
    np.testing.assert_allclose(other, plan.evaluate(times)[0], atol=1e-12)
    assert deviations(plan, drawn.motion).values.max() < 1e-12
    assert np.diff(drawn.times).min() > 0.0
    assert rate is None or np.diff(drawn.times).max() <= 1.0 / rate * (1.0 + 1e-9)


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.sampled_from(list(Interpolation)), st.sampled_from([9.0, 125.0]))
def test_the_deviation_is_the_largest_of_dense_samples(seed, kind, rate):
    plan = planned(seed)
    drawn = draw_plan(plan, execution(kind.value, rate), 1)
    found = deviations(plan, drawn.motion)
    end = drawn.motion.scheduled.piece_times()[-1]
    times = np.linspace(plan.times[0], end, 4001)
    wanted = plan.evaluate(np.minimum(times, plan.times[-1]))[0]
    if kind is Interpolation.ZERO_ORDER_HOLD:  # from the command of the tick before to that of this one
        tick = np.clip(np.floor((times - plan.times[0]) * rate + 1e-9).astype(int), 0, len(drawn.times) - 1)
        pair = np.stack([drawn.positions[np.maximum(tick - 1, 0)], drawn.positions[tick]])
        apart = np.abs(pair - wanted).max(axis=0)
    else:
        apart = np.abs(drawn.motion.scheduled.evaluate(np.minimum(times, drawn.times[-1]))[0] - wanted)
    assert (apart.max(axis=0) <= found.values + 1e-9).all()
    np.testing.assert_allclose(found.values, apart.max(axis=0), atol=3e-2 if rate < 10 else 1e-3)


@settings(max_examples=10)
@given(st.integers(0, 10**6))
def test_shares_of_a_quintics_limits_are_those_of_dense_samples(seed):
    arm, rng = group("panda"), np.random.default_rng(seed)
    plan = planned(seed)
    motion = draw_plan(plan, execution("quintic"), 1).motion
    jerks = rng.uniform(50.0, 500.0, NV)
    uses = measure_limit_shares(motion, arm, jerks)
    rows = np.stack([motion.positions, motion.velocities, motion.accelerations], axis=1)
    about = np.concatenate([plan.times[1:] - 1e-9, plan.times[:-1] + 1e-9])
    times = np.append(np.linspace(plan.times[0], plan.times[-1], 10001), about)
    middle, half = 0.5 * (arm.lower + arm.upper), 0.5 * (arm.upper - arm.lower)
    curve = BPoly.from_derivatives(motion.times, rows)
    limits = ((uses.velocity, arm.velocity_limits), (uses.acceleration, arm.acceleration_limits), (uses.jerk, jerks))
    shares = [(uses.position, np.abs(curve(times) - middle) / half)]
    shares += [(use, np.abs(curve.derivative(k)(times)) / limit) for k, (use, limit) in enumerate(limits, 1)]
    for use, dense in shares:
        assert use.share >= dense.max() * (1.0 - 1e-9)
        assert use.share == pytest.approx(dense.max(), rel=1e-2)
        assert use.share == pytest.approx(dense[:, use.coordinate].max(), rel=1e-3)


@pytest.mark.parametrize("kind", [one for one in Interpolation if one.holds])
@pytest.mark.parametrize("rate", [9.0, 125.0, 1000.0])
def test_commands_are_at_ticks_and_end_at_the_goal(kind, rate):
    plan = planned(0)
    drawn = draw_plan(plan, execution(kind.value, rate), 1)
    np.testing.assert_allclose(np.diff(drawn.times), 1.0 / rate, rtol=1e-9)
    assert (drawn.positions[0] == plan.positions[0]).all()
    assert (drawn.positions[-1] == plan.positions[-1]).all()
    assert -1e-9 < drawn.times[-1] - plan.times[-1] < 1.0 / rate
    inside = plan.evaluate(drawn.times[:-1])[0]
    np.testing.assert_allclose(drawn.positions[:-1], inside, atol=1e-12)


def test_too_many_rows_are_refused_by_name():
    plan = planned(0)
    slow = Trajectory(1e6 * plan.times, plan.positions, plan.velocities / 1e6)
    with pytest.raises(MalformedRequest, match=r"`execution` makes .* at 1000 Hz; at most 100000 are sent"):
        draw_plan(slow, execution("quintic", 1000.0), 1)


def test_steps_have_a_tube_from_each_command_to_the_next():
    drawn = draw_plan(planned(1), execution("zero_order_hold", 20.0, 0.01), 1).motion
    assert drawn.kind is CurveKind.STEPS
    low, high = drawn.pieces[:, 0] - drawn.tube, drawn.pieces[:, 0] + drawn.tube
    corners = np.stack([drawn.positions[:-1], drawn.positions[1:]])
    np.testing.assert_allclose(low, corners.min(axis=0) - 0.01, atol=1e-12)
    np.testing.assert_allclose(high, corners.max(axis=0) + 0.01, atol=1e-12)


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(2, 6), st.booleans())
def test_largest_magnitudes_are_those_of_dense_samples(seed, order, wide):
    rng = np.random.default_rng(seed)
    curves = rng.normal(size=(5, order, 3))
    more = rng.uniform(0.0, 2.0, (5, 3)) if wide else None
    most, piece, place = largest_magnitudes(curves, more)
    share = np.linspace(0.0, 1.0, 801)
    dense = np.abs([[point_on(curve, s) for s in share] for curve in curves[:, :, :]])
    dense = dense if more is None else dense + more[:, None]
    np.testing.assert_allclose(most, dense.max(axis=(0, 1)), atol=1e-4)
    assert (most >= dense.max(axis=(0, 1)) - 1e-12).all()
    for j in range(3):
        there = abs(point_on(curves[piece[j]], place[j])[j]) + (0.0 if more is None else more[piece[j], j])
        assert there == pytest.approx(most[j], abs=1e-12)


@pytest.mark.parametrize(("width", "free"), [(1e-3, True), (0.5, False)])
def test_more_rows_are_sent_until_what_is_drawn_is_free(width, free):
    """An arm that folds to pass below a box, and would touch it on the straight path between its two knots."""
    arm = grouped(box_arm("y y", 2))
    start, turn = np.array([-0.8, 0.0]), np.array([0.0, 0.9])
    plan = Trajectory(np.array([0.0, 5.0]), np.array([start, -start]), np.array([turn, -turn]))
    posed = problem(
        arm,
        scene_of(Box(name="lid", size=(0.1, 0.1, 0.04), position=(0.0, 0.0, 0.88))),
        ConfigurationGoal((-start,)),
        start,
    )
    assert judge(posed, plan).free
    posed = dataclasses.replace(posed, execution=ControllerModel(Interpolation.LINEAR, None, np.full(2, width)))
    settled = choose_execution(posed, plan)
    assert judge(posed, plan).free is settled.verdict.free is free
    assert settled.drawn.parts > 1 if free else settled.drawn.parts == 1
    assert len(settled.drawn.times) == settled.drawn.parts + 1
    refused = dataclasses.replace(posed, execution=ControllerModel(Interpolation.FIRST_ORDER_HOLD, 0.2, np.zeros(2)))
    assert choose_execution(refused, plan).verdict.reason is Reason.CONTACT
