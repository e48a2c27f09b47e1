"""Runs of triangles: balls hold them, and halves are those of sorted members."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings, strategies as st

from guidefield.kernels.distance.bvh import balls_about_runs, halve_runs

SIZES = st.lists(st.integers(1, 40), min_size=1, max_size=8)


def runs(sizes: list[int], seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Corners of triangles, some of them alike; members of runs, where they begin, and their sizes."""
    rng, counts = np.random.default_rng(seed), np.array(sizes, np.int64)
    corners = np.round(rng.normal(size=(counts.sum() + 3, 3, 3)), rng.choice([0, 1, 6]))
    members = rng.permutation(len(corners))[: counts.sum()]
    return corners, members, np.cumsum(counts) - counts, counts


@settings(deadline=None, max_examples=12)
@given(SIZES, st.integers(0, 10**6))
def test_balls_are_about_the_middles_of_boxes_and_reach_the_farthest_corner(sizes: list[int], seed: int) -> None:
    corners, members, starts, counts = runs(sizes, seed)
    balls = np.empty((len(counts), 4))
    balls_about_runs(corners, members, starts, counts, balls)
    for ball, start, count in zip(balls, starts, counts, strict=True):
        points = corners[members[start : start + count]].reshape(-1, 3)
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        np.testing.assert_allclose(ball[:3], middle, atol=1e-12)
        np.testing.assert_allclose(ball[3], np.linalg.norm(points - middle, axis=1).max(), rtol=1e-12)


@settings(deadline=None, max_examples=12)
@given(SIZES, st.integers(0, 10**6))
def test_the_first_half_of_a_run_is_on_one_side_along_its_widest(sizes: list[int], seed: int) -> None:
    corners, members, starts, counts = runs(sizes, seed)
    centres, before = corners.mean(axis=1), members.copy()
    halve_runs(centres, starts, counts, members)
    for start, count in zip(starts, counts, strict=True):
        of_run = members[start : start + count]
        assert sorted(of_run) == sorted(before[start : start + count])
        spread = np.ptp(centres[of_run], axis=0)
        along = centres[of_run, np.argmax(spread)]
        assert along[: count // 2].max(initial=-np.inf) <= along[count // 2 :].min()
