"""Samples along a chain of waypoints."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.planner.relax.path_samples import path_samples
from guidefield.planner.relax.settings import BARRIER

CASES = [(1, [0, 1]), (2, [0, 2]), (12, [0, 12]), (30, [0, 30]), (30, [0, 11, 30]), (5, [0, 1, 2, 3, 4, 5])]


@pytest.mark.parametrize(("segments", "held"), CASES)
def test_every_segment_counts_alike_and_what_stays_is_never_sampled(segments: int, held: list[int]) -> None:
    samples = path_samples(segments, held)
    places = samples.segments + samples.fractions
    assert (np.diff(places) > 0.0).all()
    assert not set(held) & set(places.tolist())
    assert samples.segments.min() >= 0
    assert samples.segments.max() <= segments - 1
    assert (samples.fractions >= 0.0).all()
    assert (samples.fractions <= 1.0).all()
    ramp = np.minimum(np.abs(places[:, None] - np.array(held)).min(axis=1) / BARRIER.ramp, 1.0)
    np.testing.assert_allclose(
        samples.ranges, BARRIER.range * (BARRIER.least_range + (1.0 - BARRIER.least_range) * ramp)
    )
    even = samples.weights / (1.0 + BARRIER.extra_weight * (1.0 - ramp))
    assert even.sum() == pytest.approx(1.0)
    units = np.empty(segments)
    for segment in range(segments):
        inside = (samples.segments == segment) & (samples.fractions > 0.0)
        dense = segment in held or segment + 1 in held
        assert inside.sum() == (BARRIER.dense if dense else 1)
        units[segment] = even[inside].sum() / (2.0 if dense else 1.0)
    np.testing.assert_allclose(units, units[0])
    own = samples.weights * samples.shares / (1.0 + BARRIER.extra_weight * (1.0 - ramp))
    assert 0 < (own > 0.0).sum() <= segments + len(held)
    assert 0.4 < own.sum() < 1.5
    between = [k for k in range(segments + 1) if k not in held]
    assert set(between) <= set(places.tolist())
    assert not any(array.flags.writeable for array in samples)


def test_in_the_middle_of_a_long_chain_range_and_weight_are_full() -> None:
    samples = path_samples(40, [0, 40])
    places = samples.segments + samples.fractions
    middle = (places > BARRIER.ramp) & (places < 40 - BARRIER.ramp)
    np.testing.assert_allclose(samples.ranges[middle], BARRIER.range)
    assert np.ptp(samples.weights[middle]) == 0.0
    assert samples.weights[0] > 2.0 * samples.weights[middle][0]
