"""Respacing: even between what is kept, on the polyline, and what is kept to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.planner.motion.waypoints import respaced


def zigzag(seed: int = 0, count: int = 9) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3)).cumsum(axis=0)


def off_polyline(path: np.ndarray, point: np.ndarray) -> float:
    """Distance of a point to a polyline."""
    along = np.diff(path, axis=0)
    share = np.clip(np.einsum("ij,ij->i", point - path[:-1], along) / (along**2).sum(axis=1), 0.0, 1.0)
    return float(np.linalg.norm(path[:-1] + share[:, None] * along - point, axis=1).min())


@pytest.mark.parametrize("kept", [[0, 8], [0, 3, 8], [0, 1, 2, 5, 7, 8]])
def test_kept_waypoints_stay_and_the_others_lie_evenly_on_the_polyline(kept: list[int]) -> None:
    path = zigzag()
    points, indices = respaced(path, np.array(kept), 30)
    np.testing.assert_array_equal(points[indices], path[kept])
    assert abs(len(points) - 31) <= len(kept)
    assert max(off_polyline(path, point) for point in points) < 1e-12
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    for first, last, a, b in zip(indices, indices[1:], kept, kept[1:], strict=False):
        expected = np.linspace(lengths[a], lengths[b], last - first + 1)
        along = [np.column_stack([np.interp(expected, lengths, column) for column in path.T])]
        np.testing.assert_allclose(points[first : last + 1], along[0], atol=1e-12)


def test_a_stretch_without_length_keeps_both_its_ends() -> None:
    path = np.array([[0.0], [1.0], [1.0], [2.0]])
    points, indices = respaced(path, np.array([0, 1, 2, 3]), 10)
    np.testing.assert_array_equal(points[indices], path)
    assert (np.diff(indices) >= 1).all()


def test_a_straight_motion_is_cut_evenly() -> None:
    points, _ = respaced(np.array([[0.0, 0.0], [1.0, 2.0]]), np.array([0, 1]), 16)
    np.testing.assert_allclose(points, np.outer(np.linspace(0, 1, 17), [1.0, 2.0]))
