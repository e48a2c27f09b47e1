"""Where along a chain of waypoints the distance to obstacles is taken, and how it counts there."""

from __future__ import annotations

import functools

import numpy as np

from guidefield.kernels.relax.relaxation import PathSamples
from guidefield.read_only import read_only

RANGE = 0.08
"""Range of the barrier [m]."""

DENSE = 8
"""Samples on a segment that ends at a waypoint that stays: the clearance changes fastest there."""

RAMP = 5.0
"""So many segments away from a waypoint that stays, range and weight are the full ones."""

LEAST_RANGE = 0.5
"""Share of the range at a waypoint that stays: what is that close by cannot be left."""

EXTRA_WEIGHT = 10.0
"""Weight on top of the full one at a waypoint that stays, against the tighter range."""


def path_samples(segments: int, held: list[int]) -> PathSamples:
    """Samples at waypoints and midpoints, and `DENSE` ones of the same weight next to waypoints that stay.

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
    stays = np.zeros(segments + 1, bool)
    stays[list(held)] = True
    dense = np.flatnonzero(stays[:-1] | stays[1:])
    plain = np.setdiff1d(np.arange(segments), dense)
    waypoints = np.flatnonzero(~stays)
    at = np.concatenate([waypoints, plain + 0.5, (dense[:, None] + (np.arange(DENSE) + 0.5) / DENSE).ravel()])
    weights = np.concatenate([np.ones(len(waypoints) + len(plain)), np.full(DENSE * len(dense), 2.0 / DENSE)])
    shares = np.concatenate(
        [
            np.full(len(waypoints), 2.0),
            np.zeros(len(plain)),
            np.tile(np.arange(DENSE) == DENSE // 2, len(dense)) * DENSE / 2.0,
        ]
    )
    order = np.argsort(at, kind="stable")
    at, weights, shares = at[order], weights[order], shares[order]
    near = np.minimum(np.abs(at[:, None] - np.flatnonzero(stays)).min(axis=1) / RAMP, 1.0)
    chosen = np.minimum(at.astype(np.int64), segments - 1)
    samples = PathSamples(
        segments=chosen,
        fractions=at - chosen,
        weights=weights / weights.sum() * (1.0 + EXTRA_WEIGHT * (1.0 - near)),
        ranges=RANGE * (LEAST_RANGE + (1.0 - LEAST_RANGE) * near),
        shares=shares,
    )
    read_only(*samples)
    return samples
