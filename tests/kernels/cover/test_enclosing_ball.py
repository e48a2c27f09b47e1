from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.kernels.cover.enclosing_ball import ball_around_balls, smallest_ball


def enclosing(points: np.ndarray) -> np.ndarray:
    ball = np.empty(4)
    smallest_ball(np.ascontiguousarray(points, dtype=float), ball)
    return ball


def radius_by_trying(points: np.ndarray) -> float:
    """The least radius among the balls held by two, three or four of the points that contain all."""
    best = np.inf
    for count in (1, 2, 3, 4):
        for some in combinations(points, count):
            first, others = some[0], np.array(some[1:]).reshape(-1, 3) - some[0]
            shares = np.linalg.lstsq(others @ others.T, 0.5 * (others**2).sum(axis=1), rcond=None)[0]
            centre = first + shares @ others
            radius = np.linalg.norm(centre - first)
            if np.linalg.norm(points - centre, axis=1).max() <= radius * (1.0 + 1e-9) + 1e-12:
                best = min(best, radius)
    return float(best)


clouds = st.tuples(st.integers(0, 10**6), st.integers(1, 9), st.sampled_from([1.0, 1e-3, 0.0])).map(
    lambda d: np.random.default_rng(d[0]).normal(size=(d[1], 3)) * [1.0, 1.0, d[2]] + [3.0, -2.0, 1.0]
)


@settings(max_examples=30)
@given(clouds)
def test_it_contains_the_points_and_is_the_smallest(points: np.ndarray) -> None:
    ball = enclosing(points)
    assert (np.linalg.norm(points - ball[:3], axis=1) <= ball[3]).all()
    assert ball[3] == pytest.approx(radius_by_trying(points), rel=1e-7, abs=1e-9)


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.integers(1, 12))
def test_a_ball_around_balls_contains_them_and_is_small(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    balls = np.column_stack([rng.normal(size=(count, 3)), rng.uniform(0.05, 0.5, count)])
    ball = np.empty(4)
    ball_around_balls(balls, ball)
    assert (np.linalg.norm(balls[:, :3] - ball[:3], axis=1) + balls[:, 3] <= ball[3]).all()
    directions = rng.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = (balls[:, None, :3] + balls[:, None, 3:] * directions).reshape(-1, 3)
    assert ball[3] <= 1.03 * enclosing(points)[3]
