"""Chords of polylines, and what may be gone back within them, against NumPy's."""

import numpy as np

from guidefield.kernels.timing.travel import STRIDES, against_chords, chord_lengths


def test_lengths_are_those_of_all_chords_and_of_longer_ones() -> None:
    points = np.random.default_rng(1).normal(size=(9, 3))
    found = np.zeros(1 + STRIDES)
    chord_lengths(points, 1, found)
    wanted = [np.linalg.norm(np.diff(points[::stride], axis=0), axis=1).sum() for stride in (1, 2, 4)]
    np.testing.assert_allclose(found, [0.0, *wanted], rtol=1e-12)


def test_a_chord_counts_where_the_motion_goes_against_it_at_an_end() -> None:
    points, rates = np.random.default_rng(2).normal(size=(2, 50, 3))
    chords, wanted = np.diff(points, axis=0), 0.0
    for ends in (rates[:-1], rates[1:]):
        back = (ends * chords).sum(axis=1) < 0.0
        wanted += 0.3 * np.where(back, np.linalg.norm(ends, axis=1), 0.0).sum()
    np.testing.assert_allclose(against_chords(points, rates, 0.3), wanted, rtol=1e-12)
