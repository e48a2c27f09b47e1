"""Boxes and straight ways about parts of a motion: every point of the curves is where they say."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from guidefield.prove.chords import chords_of
from guidefield.prove.curve import restricted


def points_of(part, count=9):
    """Points of Bezier curves, control points (m, k, nv): the first control points of what is left from there on."""
    at = np.repeat(np.linspace(0.0, 1.0, count), len(part))
    curves = np.tile(part, (count, 1, 1))
    return restricted(curves, at, np.ones(len(at)))[:, 0]


@given(
    st.lists(st.tuples(st.integers(1, 4), st.floats(-6.0, 1.0)), min_size=1, max_size=5),
    st.integers(2, 4),
    st.integers(0, 2**32 - 1),
)
def test_curves_stay_in_the_box_and_near_the_way(parts, points, seed):
    rng = np.random.default_rng(seed)
    given = [rng.uniform(-3, 3, 3) + 10.0**size * rng.normal(size=(pieces, points, 3)) for pieces, size in parts]
    found = chords_of(given)
    for part, middle, widths, chord, off in zip(given, *found, strict=True):
        beyond = points_of(part) - middle
        assert (np.abs(beyond) <= widths + 1e-12).all()
        along = np.clip(beyond @ chord / max(chord @ chord, 1e-300), -1.0, 1.0)
        assert (np.abs(beyond - along[:, None] * chord) <= off + 1e-12).all()


def test_of_a_straight_way_nothing_is_off_it():
    first, last = np.array([0.1, -2.0, 3.0]), np.array([0.4, -1.0, 2.5])
    straight = np.linspace(first, last, 8).reshape(2, 4, 3)
    found = chords_of([straight, straight[::-1, ::-1], np.repeat(first[None, None], 4, axis=1)])
    assert found.middles == pytest.approx(np.array([0.5 * (first + last)] * 2 + [first]))
    assert found.chords == pytest.approx(np.array([0.5 * (last - first), 0.5 * (first - last), 0.0 * first]))
    assert found.off == pytest.approx(np.zeros((3, 3)), abs=1e-15)
