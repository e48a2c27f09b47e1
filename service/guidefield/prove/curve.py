"""A motion in time as Bezier curves: where it is, and how fast it changes at most between two times."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartCurveRates, ChartCurves, ChartPoint, ChartPoints, ChartRates

JUMP = 1e-9
"""Rates that differ by less than this share of the largest one count as equal: they do but for rounding."""


@dataclass(frozen=True, eq=False)
class Curve(ReadOnly):
    """A chain of Bezier curves in the group's chart, each run through evenly.

    Attributes:
        pieces: Control points, shape (m, k, nv) [rad or m].
        times: When they begin and the last one ends, shape (m + 1,) [s]; pieces may take no time.
    """

    pieces: ChartCurves
    times: np.ndarray

    @cached_property
    def velocities(self) -> ChartCurveRates:
        """Control points of the rates, shape (m, k - 1, nv)."""
        return self._derived(self.pieces)

    @cached_property
    def accelerations(self) -> ChartCurveRates:
        """Control points of the rates' rates, shape (m, max(k - 2, 1), nv)."""
        if self.velocities.shape[1] == 1:
            return np.zeros_like(self.velocities)
        return self._derived(self.velocities)

    def _derived(self, controls: ChartCurves | ChartCurveRates) -> ChartCurveRates:
        """Control points of the derivative in time; 0 where no time passes."""
        spans = np.diff(self.times)[:, None, None]
        steps = (controls.shape[1] - 1) * np.diff(controls, axis=1)
        rates: ChartCurveRates = np.divide(steps, spans, out=np.zeros_like(steps), where=spans > 0.0)
        return rates

    @property
    def box(self) -> tuple[ChartPoint, ChartPoint]:
        """Lower and upper corner of a box that it stays in, each of shape (nv,) [rad or m]."""
        return self.pieces.min(axis=(0, 1)), self.pieces.max(axis=(0, 1))

    @cached_property
    def breaks(self) -> np.ndarray:
        """The times at which a rate jumps, shape (b,) [s]."""
        before, after = self.velocities[:-1, -1], self.velocities[1:, 0]
        largest = np.abs(self.velocities).max(initial=0.0)
        jumps = np.abs(after - before).max(axis=1, initial=0.0) > JUMP * largest
        times: np.ndarray = self.times[1:-1][jumps]
        return times

    def at(self, times: np.ndarray) -> tuple[ChartPoints, ChartRates]:
        """Chart points and their rates at times (n,), both of shape (n, nv) [rad or m, and per s]."""
        piece = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.pieces) - 1)
        share = self._shares(times, piece)
        return restricted(self.pieces[piece], share, share)[:, 0], restricted(self.velocities[piece], share, share)[
            :, 0
        ]

    def most(self, since: np.ndarray, until: np.ndarray) -> tuple[ChartRates, ChartRates]:
        """The largest rates and rates of rates between two times.

        Args:
            since: From when, shape (s,) [s].
            until: Until when, later, shape (s,) [s].

        Returns:
            Both of shape (s, nv), each coordinate by itself [rad/s or m/s, and per s^2].
        """
        last = len(self.pieces) - 1
        first_piece = np.clip(np.searchsorted(self.times, since, side="right") - 1, 0, last)
        last_piece = np.clip(np.searchsorted(self.times, until, side="left") - 1, first_piece, last)
        counts = last_piece - first_piece + 1
        starts = np.r_[0, np.cumsum(counts)[:-1]]
        owner = np.repeat(np.arange(len(since)), counts)
        piece = first_piece[owner] + np.arange(len(owner)) - starts[owner]
        low, high = self._shares(since[owner], piece), self._shares(until[owner], piece)
        found = []
        for controls in (self.velocities, self.accelerations):
            largest = np.abs(restricted(controls[piece], low, high)).max(axis=1)
            found.append(np.maximum.reduceat(largest, starts, axis=0))
        return found[0], found[1]

    def _shares(self, times: np.ndarray, piece: np.ndarray) -> np.ndarray:
        """How much of a piece has passed at a time, from 0 to 1, shape (n,)."""
        spans = self.times[piece + 1] - self.times[piece]
        passed = np.clip(times - self.times[piece], 0.0, spans)
        shares: np.ndarray = np.divide(passed, spans, out=np.zeros_like(passed), where=spans > 0.0)
        return shares


def restricted(controls: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Control points of parts of Bezier curves, by their blossom.

    Args:
        controls: Of the curves, shape (n, k, nv).
        low: Parameters where the parts begin, shape (n,).
        high: Where they end, shape (n,).

    Returns:
        Shape (n, k, nv).
    """
    order = controls.shape[1]
    parts = np.empty_like(controls)
    a, b = low[:, None, None], high[:, None, None]
    for index in range(order):
        row = controls
        for step in range(order - 1):
            share = b if step < index else a
            row = row[:, :-1] + share * (row[:, 1:] - row[:, :-1])
        parts[:, index] = row[:, 0]
    return parts
