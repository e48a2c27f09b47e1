"""Passages: where a motion comes nearest, what missing them costs, and that in the end nothing is missed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.planner.motion.bspline import BSpline, End
from guidefield.planner.optimize.passages import (
    REACHED,
    Passage,
    add_passage,
    move_onto_places,
    nearest,
)
from guidefield.planner.optimize.settings import BALANCED

PIECES = 10


@dataclass(frozen=True)
class Waypoint:
    """A chart point that is passed within a radius."""

    point: np.ndarray
    radius: float
    tip_plane: None = None

    def missed(self, zs: np.ndarray) -> np.ndarray:
        return np.maximum(np.linalg.norm(zs - self.point, axis=1) - self.radius, 0.0)[:, None]

    def rows(self, z: np.ndarray) -> np.ndarray:
        away = z - self.point
        return (away / np.linalg.norm(away))[None]


def curve(seed: int, nv: int = 3) -> BSpline:
    """Along the first coordinate, with others astray."""
    rng = np.random.default_rng(seed)
    points = 0.1 * rng.normal(size=(PIECES + 3, nv))
    points[:, 0] = np.linspace(0.0, 4.0, PIECES + 3)
    return BSpline.between(End.at_rest(points[1]), End.at_rest(points[-2]), points[3:-3], 0.2)


def least(spline: BSpline, place: Waypoint, about: float, window: float = 1.0) -> float:
    """Half the square of what is missed at least next to a place, by dense samples."""
    dense = np.clip(np.linspace(about - window, about + window, 2_001), 0.0, spline.pieces)
    return 0.5 * float((place.missed(spline.at(dense)) ** 2).sum(axis=1).min())


@pytest.mark.parametrize("seed", range(3))
def test_the_gradient_is_that_of_finite_differences_of_the_least_miss(seed: int) -> None:
    spline = curve(seed)
    place = Waypoint(spline.at(np.array([4.6]))[0] + [0.0, 0.3, 0.1], 0.05)
    n, nv = spline.points.shape
    gradient, places = np.zeros((n, nv)), (np.empty(1, np.int64), np.empty((1, 4)), np.empty((1, nv, nv)))
    at = nearest(place, spline, 4.6)
    value = add_passage(place, spline, at, 7.0, BALANCED.crossing, 0, gradient, *places)
    assert value == pytest.approx(7.0 * least(spline, place, at, 0.3), rel=1e-4)
    rng = np.random.default_rng(seed)
    for _ in range(4):
        along = rng.normal(size=(n, nv))
        moved = (BSpline(spline.points + by * along, spline.step, spline.start, spline.end) for by in (1e-3, -1e-3))
        difference = np.subtract(*(least(one, place, at, 0.3) for one in moved)) / 2e-3
        assert float((gradient * along).sum()) == pytest.approx(7.0 * difference, rel=1e-2, abs=1e-3)


def test_its_hessian_is_positive_and_leaves_free_what_time_makes_up_for() -> None:
    spline = curve(1)
    place = Waypoint(spline.at(np.array([4.6]))[0] + [0.0, 0.3, 0.1], 0.0)
    n, nv = spline.points.shape
    at = nearest(place, spline, 4.6)
    pieces, shares, hessians = np.empty(1, np.int64), np.empty((1, 4)), np.empty((1, nv, nv))
    add_passage(place, spline, at, 1.0, BALANCED.crossing, 0, np.zeros((n, nv)), pieces, shares, hessians)
    by_point = np.zeros((n, 1))
    by_point[pieces[0] : pieces[0] + 4, 0] = shares[0]
    np.testing.assert_allclose((by_point * spline.points).sum(axis=0), spline.at(np.array([at]))[0])
    whole = np.kron(by_point @ by_point.T, hessians[0])
    assert np.linalg.eigvalsh(whole).min() > -1e-12
    away = spline.at(np.array([at]))[0] - place.point
    sideways = np.tile(away, (n, 1)).ravel()
    along = np.tile(spline.slopes(np.array([at]))[0], (n, 1)).ravel()
    assert sideways @ whole @ sideways > 0.1 * (away @ away)
    assert along @ whole @ along < 1e-3 * sideways @ whole @ sideways * (along @ along) / (sideways @ sideways)


@settings(max_examples=12)
@given(st.integers(0, 10_000), st.floats(0.0, 0.02), st.floats(2.0, 6.0))
def test_a_motion_is_brought_exactly_to_all_places_and_its_ends_stay(seed: int, radius: float, at: float) -> None:
    spline = curve(seed)
    aside = 0.02 * np.random.default_rng(seed).normal(size=(2, 3))
    places = (at, at + 2.0)
    passages = [Passage(Waypoint(z + by, radius), z) for z, by in zip(spline.at(np.array(places)), aside, strict=True)]
    found = move_onto_places(spline, passages, places, np.ones(spline.points.shape[1]))
    assert found is not None
    moved, reached = found
    for passage, where in zip(passages, reached, strict=True):
        assert passage.place.missed(moved.at(np.array([where]))).max() <= REACHED
    np.testing.assert_array_equal(moved.points[:3], spline.points[:3])
    np.testing.assert_array_equal(moved.points[-3:], spline.points[-3:])
