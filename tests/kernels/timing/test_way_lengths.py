"""Chords of polylines, and what may be gone back within them, against NumPy's."""

import numpy as np

from guidefield.kernels.timing.way_lengths import STRIDES, against_chords, chord_lengths


def test_lengths_are_those_of_all_chords_and_of_longer_ones() -> None:
    points = np.random.default_rng(1).normal(size=(5, 9, 3))
    found = np.empty((5, STRIDES))
    chord_lengths(points, found)
    for column, stride in enumerate((1, 2, 4)):
        wanted = np.linalg.norm(np.diff(points[:, ::stride], axis=1), axis=2).sum(axis=1)
        np.testing.assert_allclose(found[:, column], wanted, rtol=1e-12)


def test_a_chord_counts_where_the_motion_goes_against_it_at_an_end() -> None:
    rng = np.random.default_rng(2)
    points, rates = rng.normal(size=(2, 7, 5, 3))
    times, found = np.arange(7.0)[:, None] + 0.3 * np.arange(5.0), np.empty(7)
    against_chords(times, points, rates, found)
    chords, wanted = np.diff(points, axis=1), np.zeros(7)
    for ends in (rates[:, :-1], rates[:, 1:]):
        back = (ends * chords).sum(axis=2) < 0.0
        wanted += 0.3 * np.where(back, np.linalg.norm(ends, axis=2), 0.0).sum(axis=1)
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
