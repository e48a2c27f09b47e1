"""How far a motion has travelled, against SciPy's curves; the earliest schedule against one that tries all."""

from itertools import product

import numpy as np
import pytest
from scipy.interpolate import BPoly

from guidefield.kernels.timing import path_parameterization as kernel
from guidefield.kernels.timing.travel import squared_turns, travelled, when_travelled

RATES = 3


def found(cells, lowest, highest, free, per_step, length, earliest):
    costs = np.full((len(cells), RATES + 1), kernel.UNREACHED)
    costs[0] = 0
    steps = len(free) // per_step
    parents, arrival = np.zeros((steps, *costs.shape), np.int8), np.array([-1, 0, 0, 0])
    kernel.earliest_schedule(
        cells, lowest, highest, free, per_step, length, earliest, 0, costs, np.empty_like(costs), parents, arrival
    )
    return arrival, parents


def passes(cells, free, per_step, step, place, rate, change):
    """Whether every cell from the one where a part begins to the one where it ends is free in it; by small parts."""
    for part in range(per_step):
        a, b = (place + 2 * rate * t + change * t * t for t in (part / per_step, (part + 1) / per_step))
        first, last = (cells[min(one, len(cells) - 1)] for one in (int(a), int(b) + 1))
        if not free[step * per_step + part, first : last + 1].all():
            return False
    return True


def first_arrival(cells, lowest, highest, free, per_step, length, earliest):
    """The first step in which the end is reached; -1 if in none: all states, step by step."""
    states = {(0, rate) for rate in range(RATES + 1)}
    for step in range(len(free) // per_step):
        for place, rate in states:
            arrives = rate and place + 2 * rate >= length and step + (length - place) / (2 * rate) >= earliest
            if arrives and passes(cells, free, per_step, step, place, rate, 0):
                return step
        after = set()
        for (place, rate), change in product(states, range(-RATES, RATES + 1)):
            new = place + 2 * rate + change, rate + change
            inside = new[0] < len(cells) and 0 <= new[1] <= RATES and not (rate and place + 2 * rate >= length)
            may = inside and all(lowest[at] <= change <= highest[at] for at in ((place, rate), new))
            if may and new not in after and passes(cells, free, per_step, step, place, rate, change):
                after.add(new)
        states = after | ({(0, rate) for rate in range(RATES + 1)} if (0, 0) in after else set())
    return -1


def drawn(seed):
    rng = np.random.default_rng(seed)
    places, steps, per_step = int(rng.integers(8, 30)), 24, int(rng.integers(1, 4))
    cells = np.sort(np.r_[0, rng.integers(0, 7, places - 2), 6])
    lowest = -rng.integers(0, RATES + 1, (places, RATES + 1))
    highest = rng.integers(0, RATES + 1, (places, RATES + 1))
    lowest[0] = highest[0] = 0
    free = (rng.random((steps * per_step, 7)) < rng.choice([0.7, 0.85, 0.97])).astype(np.uint8)
    free[:, 0] = 1
    return cells, lowest, highest, free, per_step, places - rng.random(), float(rng.choice([0.0, 9.5]))


@pytest.mark.parametrize("seed", range(40))
def test_it_arrives_in_the_first_step_in_which_any_schedule_does(seed):
    problem = drawn(seed)
    assert found(*problem)[0][0] == first_arrival(*problem)


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
