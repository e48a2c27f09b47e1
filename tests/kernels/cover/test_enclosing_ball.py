"""Balls: the smallest about points and balls, few that cover, and points that are within."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.geometry.solid import solid
from guidefield.kernels.cover.ball_cover import greedy_choice
from guidefield.kernels.cover.enclosing_ball import ball_around_balls, smallest_ball
from tests.geometry import solids


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


def packed(rows: np.ndarray) -> np.ndarray:
    """Rows of truth values as bits, 64 to a word."""
    padded = np.zeros((len(rows), 64 * max(1, -(-rows.shape[1] // 64))), bool)
    padded[:, : rows.shape[1]] = rows
    return np.packbits(padded, axis=1, bitorder="little").view(np.uint64)


def chosen_by_greed(rows: np.ndarray) -> np.ndarray:
    chosen = np.empty(len(rows), np.int64)
    return chosen[: greedy_choice(packed(rows), chosen)]


def fewest(rows: np.ndarray) -> int:
    """By trying all choices."""
    wanted = rows.any(axis=0)
    for count in range(len(rows) + 1):
        if any((rows[list(some)].any(axis=0) == wanted).all() for some in combinations(range(len(rows)), count)):
            return count
    raise AssertionError


problems = st.tuples(st.integers(0, 10**6), st.integers(1, 9), st.integers(1, 140), st.floats(0.02, 0.6)).map(
    lambda drawn: np.random.default_rng(drawn[0]).random((drawn[1], drawn[2])) < drawn[3]
)


@settings(max_examples=24)
@given(problems)
def test_all_that_can_be_contained_is_by_few_sets(rows: np.ndarray) -> None:
    """The greedy choice has at most the harmonic number of the largest set times as many as needed (Chvatal 1979)."""
    choice = chosen_by_greed(rows)
    assert len(set(choice.tolist())) == len(choice)
    assert (rows[choice].any(axis=0) == rows.any(axis=0)).all()
    harmonic = (1.0 / np.arange(1, rows.sum(axis=1).max(initial=1) + 1)).sum()
    assert len(choice) <= harmonic * fewest(rows) + 1e-9


BODIES = {"box": solids.box((0.1, 0.2, 0.3)), "ring": solids.torus(), "channel": solids.channel()}


@pytest.mark.parametrize("far", [0.0, 1e3, 1e8])
@pytest.mark.parametrize("mesh", [*BODIES.values(), solids.overlapping(), solids.hollow()])
def test_what_is_known_of_a_point_changes_nothing_for_the_next(mesh: solids.Mesh, far: float) -> None:
    vertices, triangles = mesh
    body, rng = solid(far + vertices, triangles), np.random.default_rng(3)
    low, high = body.surface.vertices.min(axis=0), body.surface.vertices.max(axis=0)
    walk = rng.uniform(low, high) + np.cumsum(rng.normal(scale=0.02, size=(300, 3)), axis=0)
    points = np.vstack([walk, rng.uniform(low - 0.05, high + 0.05, (300, 3)), np.repeat(walk[:1], 3, axis=0)])
    for asked in (body.depths, body.distances):
        assert (asked(points) == np.concatenate([asked(point[None]) for point in points])).all()
