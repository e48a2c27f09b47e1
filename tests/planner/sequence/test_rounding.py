"""Rounded corners between straight curves: within their radius, along the curves at both ends, unchanged elsewhere."""

from itertools import pairwise

import numpy as np
from hypothesis import given, strategies as st
from tests.planner.problems import problem, scene_of, to_configuration
from tests.robots import group

from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.sequence.rounding import CurveByLength, round_corners
from guidefield.planner.sequence.stretches import PassedGoal

SEEDS = st.integers(0, 2**32 - 1)


def straight(begin: np.ndarray, end: np.ndarray) -> Trajectory:
    """A straight motion from rest to rest."""
    return Trajectory(np.array([0.0, 1.0]), np.array([begin, end]), np.zeros((2, len(begin))))


def beside(line: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Distances of places (k, nv) from a segment (2, nv)."""
    along = line[1] - line[0]
    shares = np.clip((places - line[0]) @ along / (along @ along), 0.0, 1.0)
    return np.linalg.norm(places - line[0] - shares[:, None] * along, axis=1)


@given(SEEDS, st.floats(0.005, 1.0))
def test_a_corner_leaves_its_lines_within_the_radius_and_along_them(seed: int, radius: float) -> None:
    rng, arm = np.random.default_rng(seed), group("ur5")
    corners = np.cumsum(rng.uniform(-1.0, 1.0, (4, arm.nv)), axis=0)
    asked = problem(arm, scene_of(), goal=to_configuration(corners[1], arm), q_start=arm.from_chart(corners[0]))
    goals = [PassedGoal(asked, z, radius) for z in corners[1:3]]
    curves = [CurveByLength(straight(*line)) for line in pairwise(corners)]
    found = round_corners(curves, goals, [radius, radius], 0.05)
    assert np.array_equal(found.path[[0, -1]], corners[[0, -1]])
    aside = np.min([beside(np.array(line), found.path) for line in pairwise(corners)], axis=0)
    near = np.min([np.abs(found.path - z).max(axis=1) for z in corners[1:3]], axis=0)
    assert aside[near > radius].max(initial=0.0) < 1e-9
    for z, (begin, end) in zip(corners[1:3], found.corners, strict=True):
        bend = found.path[begin : end + 1]
        assert np.abs(bend - z).max() <= radius
        assert np.linalg.norm(bend - z, axis=1).min() < min(np.linalg.norm(bend[[0, -1]] - z, axis=1))
        for line, chord in ((corners, bend[:2]), (corners, bend[-2:])):
            lines = [beside(np.array(one), chord) for one in pairwise(line)]
            assert min(one.max() for one in lines) < 0.05 * np.linalg.norm(chord[1] - chord[0])
