"""Pieces and braking: limits exactly, a stop in the end, no goal passed; and no stop is sooner."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings, strategies as st

from guidefield.stream.commit import Commit, JointBounds, plan_commit

VELOCITY, ACCELERATION, JERK = 2.0, 10.0, 400.0
BOUNDS = JointBounds(np.array([-3.0]), np.array([3.0]), np.array([[VELOCITY, ACCELERATION, JERK]]))
ROUNDING = 1e-9
share = st.floats(-1.0, 1.0)


def state(q: float, v: float, a: float) -> np.ndarray:
    """A state whose acceleration can be ended within the velocity's limit, shape (1, 3); shares of the limits."""
    acceleration = 0.999 * a * ACCELERATION
    paths = VELOCITY * 0.999 - acceleration**2 / (2.0 * JERK)
    return np.array([[q, v * paths, acceleration]])


def piece(start: np.ndarray, velocity: float, goal: float = np.inf, within: float = 0.0) -> Commit:
    return plan_commit(start, np.array([velocity]), np.array([goal]), BOUNDS, 0.0, 0.03, within)


@settings(max_examples=18, deadline=None)
@given(share, share, share)
def test_a_piece_and_its_braking_keep_every_limit_and_end_in_a_stop(v: float, a: float, u: float) -> None:
    start = state(0.0, v, a)
    commit = piece(start, u * VELOCITY)
    times = np.unique(np.r_[np.linspace(0.0, commit.stops, 400), commit.phases[0, : commit.counts[0], 0]])
    states = np.array([commit.state(time)[0] for time in times])
    np.testing.assert_allclose(states[0, :3], start[0], atol=ROUNDING)
    for column, limit in ((1, VELOCITY), (2, ACCELERATION), (3, JERK)):
        assert np.abs(states[:, column]).max() <= limit * (1.0 + ROUNDING)
    assert not commit.state(commit.stops + 1e-6)[0, 1:].any()
    # no jump: each derivative is what the one below it changes by (second way: trapezoids between all knots)
    steps = np.diff(times)
    np.testing.assert_allclose(np.diff(states[:, 2]), steps * states[:-1, 3], atol=1e-7)
    middles = 0.5 * (states[1:, 2] + states[:-1, 2])
    np.testing.assert_allclose(np.diff(states[:, 1]), steps * middles, atol=1e-7)


@settings(max_examples=12, deadline=None)
@given(share, share, st.floats(-0.4, 0.4))
def test_no_goal_is_passed_that_need_not_be(v: float, u: float, away: float) -> None:
    start = state(0.0, v, 0.0)
    still = float(piece(start, 0.0).ends[0])
    goal = still + away
    velocity = np.copysign(abs(u) * VELOCITY, away)
    ends = float(piece(start, velocity, goal).ends[0])
    assert (ends - goal) * np.sign(away) <= 1e-8
    if (float(piece(start, velocity).ends[0]) - goal) * np.sign(away) > 0.0:
        assert abs(ends - goal) <= 1e-8


@settings(max_examples=12, deadline=None)
@given(share)
def test_braking_lasts_as_long_as_it_has_to(v: float) -> None:
    start = state(0.0, v, 0.0)
    commit = plan_commit(start, np.zeros(1), np.array([np.inf]), BOUNDS, 0.0, 1e-9, 0.0)
    speed = abs(start[0, 1])
    # a triangle of acceleration, or a trapezoid where its limit is reached
    quickest = speed / ACCELERATION + ACCELERATION / JERK
    if speed < ACCELERATION**2 / JERK:
        quickest = 2.0 * np.sqrt(speed / JERK)
    assert abs(commit.stops - quickest) <= 1e-7
    assert abs(commit.ends[0] - 0.5 * start[0, 1] * quickest) <= 1e-7  # it is symmetric in time


@settings(max_examples=18, deadline=None)
@given(st.lists(share, min_size=3, max_size=3), st.lists(st.floats(0.2, 1.0), min_size=3, max_size=3))
def test_from_rest_all_coordinates_go_straight_on_together(shares: list[float], hardness: list[float]) -> None:
    """Else a robot near the floor would begin with a motion of its own; every limit is kept all the same."""
    rates = np.outer(hardness, [VELOCITY, ACCELERATION, JERK])
    bounds = JointBounds(np.full(3, -3.0), np.full(3, 3.0), rates)
    velocities = np.array(shares) * rates[:, 0]
    state, goals = np.zeros((3, 3)), np.full(3, np.inf)
    for begins in (0.0, 0.02, 0.04):  # each follows the one before
        commit = plan_commit(state, velocities, goals, bounds, begins, 0.03, 0.0)
        states = np.array([commit.state(time) for time in np.linspace(begins, commit.stops, 50)])
        assert (np.abs(states[:, :, 1:]) <= rates * (1.0 + ROUNDING)).all()
        states = np.array([commit.state(time) for time in np.linspace(begins, commit.brakes, 30)])
        along = states[:, :, 0] @ velocities / max(velocities @ velocities, 1e-12)
        np.testing.assert_allclose(
            states[:, :, 0], np.outer(along, velocities), atol=1e-3 * max(1e-6, np.abs(commit.ends).max())
        )
        state = commit.state(begins + 0.02)[:, :3]


@settings(max_examples=12, deadline=None)
@given(share, st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4), st.sampled_from([0.0, 5.0, 9e8]))
def test_what_is_told_keeps_the_jerk_however_late_the_next_piece_is(v: float, later: list[float], clock: float) -> None:
    """Also from the last moments of a braking, where a square root loses half its digits, and by a clock long on."""
    commit = plan_commit(state(0.0, v, 0.0), np.zeros(1), np.array([np.inf]), BOUNDS, clock, 0.03, 1e-7)
    for share_of in later:
        told = commit.trajectory()
        spans, accelerations = np.diff(told.times), np.array(told.accelerations)[:, 0]
        assert (spans > 0.0).all()
        assert abs(told.times[-1] - commit.stops) <= np.spacing(commit.stops)
        assert told.velocities[-1] == [0.0]
        assert told.accelerations[-1] == [0.0]
        rounded = 4.0 * np.spacing(told.times[1:]) + 1e-13 / JERK
        assert (np.abs(np.diff(accelerations)) <= JERK * (spans + rounded)).all()
        since = (1.0 - 1e-6 * share_of**4) * (commit.stops - commit.begins)
        now = commit.state(commit.begins + since)[:, :3]
        commit = plan_commit(now, np.zeros(1), np.array([np.inf]), BOUNDS, commit.begins + since, 0.03, 1e-7)
