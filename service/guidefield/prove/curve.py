"""A motion in time as a chain of Bezier curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.prove.bezier import point_on, restricted
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints


@dataclass(frozen=True, eq=False)
class Curve(ReadOnly):
    """A chain of Bezier curves in the group's local coordinates, each run through evenly.

    Attributes:
        pieces: Control points, shape (m, k, nv) [rad or m].
        times: Begin of each, and the end of the last one, shape (m + 1,) [s]; pieces may take no time.
    """

    pieces: ChartCurves
    times: np.ndarray

    @property
    def box(self) -> tuple[ChartPoint, ChartPoint]:
        """Lower and upper corner of a box about it, each of shape (nv,) [rad or m]."""
        return self.pieces.min(axis=(0, 1)), self.pieces.max(axis=(0, 1))

    def at(self, times: np.ndarray) -> ChartPoints:
        """Points at times (n,), shape (n, nv) [rad or m]."""
        piece = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.pieces) - 1)
        share = self._shares(times, piece)
        points: ChartPoints = restricted(self.pieces[piece], share, share)[:, 0]
        return points

    def point_at(self, time: float) -> ChartPoint:
        """The point (nv,) at a time [s]."""
        piece = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.pieces) - 1))
        begin, end = float(self.times[piece]), float(self.times[piece + 1])
        return self.point(piece, min(max((time - begin) / (end - begin), 0.0), 1.0) if end > begin else 0.0)

    def point(self, piece: int, parameter: float) -> ChartPoint:
        """The point (nv,) of a piece at a parameter from 0 to 1."""
        return point_on(self.pieces[piece], parameter)

    def _shares(self, times: np.ndarray, piece: np.ndarray) -> np.ndarray:
        """Share of a piece that has passed at a time, from 0 to 1, shape (n,)."""
        spans = self.times[piece + 1] - self.times[piece]
        passed = np.clip(times - self.times[piece], 0.0, spans)
        shares: np.ndarray = np.divide(passed, spans, out=np.zeros_like(passed), where=spans > 0.0)
        return shares
