"""Where along a chain of waypoints the distance to obstacles is taken, and how it counts there."""

from __future__ import annotations

import functools

import numpy as np

from guidefield.kernels.relax.relaxation import PathSamples
from guidefield.planner.relax.settings import BARRIER
from guidefield.read_only import read_only


def path_samples(segments: int, held: list[int]) -> PathSamples:
    """Samples at waypoints and midpoints, and `BARRIER.dense` ones of the same weight next to waypoints that stay.

    Links are looked at against each other at waypoints only, and once on a segment next to a waypoint that stays.

    Args:
        segments: Number of segments; waypoint k is the start of segment k.
        held: Waypoints that stay, the first and the last among them.

    Returns:
        Read-only; the weights add up to 1 but for the extra weight.
    """
    return _samples(segments, tuple(held))


@functools.lru_cache(maxsize=256)
def _samples(segments: int, held: tuple[int, ...]) -> PathSamples:
    """`path_samples`: the same for all paths of so many segments, of which mostly the ends alone stay."""
    count, stays = BARRIER.dense, np.zeros(segments + 1, bool)
    stays[list(held)] = True
    dense = np.flatnonzero(stays[:-1] | stays[1:])
    plain = np.setdiff1d(np.arange(segments), dense)
    waypoints = np.flatnonzero(~stays)
    at = np.concatenate([waypoints, plain + 0.5, (dense[:, None] + (np.arange(count) + 0.5) / count).ravel()])
    weights = np.concatenate([np.ones(len(waypoints) + len(plain)), np.full(count * len(dense), 2.0 / count)])
    shares = np.concatenate(
        [
            np.full(len(waypoints), 2.0),
            np.zeros(len(plain)),
            np.tile(np.arange(count) == count // 2, len(dense)) * count / 2.0,
        ]
    )
    order = np.argsort(at, kind="stable")
    at, weights, shares = at[order], weights[order], shares[order]
    near = np.minimum(np.abs(at[:, None] - np.flatnonzero(stays)).min(axis=1) / BARRIER.ramp, 1.0)
    chosen = np.minimum(at.astype(np.int64), segments - 1)
    samples = PathSamples(
        segments=chosen,
        fractions=at - chosen,
        weights=weights / weights.sum() * (1.0 + BARRIER.extra_weight * (1.0 - near)),
        ranges=BARRIER.range * (BARRIER.least_range + (1.0 - BARRIER.least_range) * near),
        shares=shares,
    )
    read_only(*samples)
    return samples
