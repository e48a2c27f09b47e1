"""How far a motion has travelled, against SciPy's curves and dense chords."""

import numpy as np
import pytest
from scipy.interpolate import BPoly

from guidefield.kernels.timing.travel import squared_turns, travelled, when_travelled


def random_motion(seed: int, order: int) -> tuple[np.ndarray, np.ndarray, BPoly]:
    rng = np.random.default_rng(seed)
    pieces, times = rng.normal(size=(6, order, 3)), np.cumsum(np.r_[0.0, rng.uniform(0.1, 1.0, 6)])
    pieces[1:, 0] = pieces[:-1, -1]
    return pieces, times, BPoly(pieces.swapaxes(0, 1), times)


@pytest.mark.parametrize("order", [2, 3, 4, 6])
def test_lengths_are_those_of_the_chords(order: int) -> None:
    pieces, times, curve = random_motion(order, order)
    asked, lengths = np.linspace(times[0], times[-1], 500), np.empty(500)
    travelled(pieces, times, asked, lengths)
    steps = np.linalg.norm(np.diff(curve(asked), axis=0), axis=1)
    np.testing.assert_allclose(lengths, np.r_[0.0, np.cumsum(steps)], rtol=1e-10)


@pytest.mark.parametrize("order", [2, 4])
def test_it_is_found_when_a_length_was_travelled(order: int) -> None:
    pieces, times, curve = random_motion(order, order)
    known, lengths = np.linspace(times[0], times[-1], 20_000), np.empty(20_000)
    travelled(pieces, times, known, lengths)
    wanted = np.array([0.3, lengths[-1] - 0.3])
    whens = wanted.copy()
    when_travelled(pieces, times, known, lengths, 100, whens)
    for when, length in zip(whens, wanted, strict=True):
        dense = np.linspace(times[0], when, 100_001)
        gone = np.linalg.norm(np.diff(curve(dense), axis=0), axis=1).sum()
        assert gone == pytest.approx(length, abs=1e-3)


def test_turns_are_those_between_chords() -> None:
    pieces, times, curve = random_motion(3, 4)
    asked = np.linspace(times[0], times[-1], 60)
    chords = np.diff(curve(asked), axis=0)
    sizes = np.linalg.norm(chords, axis=1)
    angles = np.arccos(np.einsum("ij,ij->i", chords[1:], chords[:-1]) / (sizes[1:] * sizes[:-1]))
    assert squared_turns(pieces, times, asked) == pytest.approx((angles**2).sum(), rel=1e-9)


def test_who_rests_has_travelled_nowhere() -> None:
    pieces, times, lengths = np.ones((1, 4, 2)), np.zeros(2), np.full(3, np.nan)
    travelled(pieces, times, np.zeros(3), lengths)
    np.testing.assert_array_equal(lengths, 0.0)
