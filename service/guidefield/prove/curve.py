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
        piece, share = find_pieces(self.times, times)
        points: ChartPoints = restricted(self.pieces[piece], share, share)[:, 0]
        return points

    def point_at(self, time: float) -> ChartPoint:
        """The point (nv,) at a time [s]."""
        pieces, shares = find_pieces(self.times, np.array([time]))
        return self.point(int(pieces[0]), float(shares[0]))

    def point(self, piece: int, parameter: float) -> ChartPoint:
        """The point (nv,) of a piece at a parameter from 0 to 1."""
        return point_on(self.pieces[piece], parameter)


def find_pieces(knots: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the pieces that are run through at some times, and the share of each that has passed.

    Args:
        knots: Begin of each piece, and the end of the last one; pieces may take no time, shape (m + 1,).
        times: Shape (n,); what is outside of the pieces is at the nearer end.

    Returns:
        Indices of pieces, and shares from 0 to 1, each of shape (n,).
    """
    piece = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
    spans = knots[piece + 1] - knots[piece]
    passed = np.clip(times - knots[piece], 0.0, spans)
    return piece, np.divide(passed, spans, out=np.zeros_like(passed), where=spans > 0.0)
