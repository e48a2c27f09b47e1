"""A path with its corners rounded: a uniform cubic B-spline whose control points are places on the path.

It begins and ends where the path does, without bend there. Each piece is in the hull of its four control points, so it
keeps the limits of positions that the path keeps. Next to a corner it is off the path by at most a sixth of the second
difference of its control points: the closer these are, the closer it is.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.planner.motion.bspline import basis, basis_bends, basis_slopes
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.model.spaces import ChartPoints, ChartRates

BEFORE = np.array([-1, 0, 1, 2])
"""The control points of a piece, counted from the place at which it begins."""


@dataclass(frozen=True, eq=False)
class PathCurve(ReadOnly):
    """A curve by a parameter without a unit, that grows by 1 on each piece.

    Attributes:
        points: Control points, shape (m + 3, nv), m pieces; the first and the last stand for the ends' bends.
    """

    points: ChartPoints

    @classmethod
    def along(cls, places: ChartPoints) -> PathCurve:
        """Along places on a path, shape (m + 1, nv), m >= 1, no two consecutive ones the same."""
        first, last = 2.0 * places[:1] - places[1:2], 2.0 * places[-1:] - places[-2:-1]
        return cls(cast(ChartPoints, np.concatenate([first, places, last])))

    @property
    def pieces(self) -> int:
        """How many there are."""
        return len(self.points) - 3

    def at(self, parameters: np.ndarray) -> ChartPoints:
        """Chart points (k, nv) at parameters (k,), from 0 to `pieces`."""
        pieces = np.clip(parameters.astype(np.int64), 0, self.pieces - 1)
        return cast(
            ChartPoints,
            np.einsum("ka,kaj->kj", basis(parameters - pieces), self.points[pieces[:, None] + 1 + BEFORE]),
        )

    def derivatives(self, steps: int) -> tuple[ChartRates, ChartRates]:
        """The first two derivatives by the parameter, at even steps on each piece and at the end.

        Args:
            steps: On each piece.

        Returns:
            Both of shape (pieces * steps + 1, nv) [rad or m].
        """
        about = self.points[np.arange(self.pieces)[:, None] + 1 + BEFORE]
        made = [
            np.concatenate([(of @ about).reshape(-1, self.points.shape[1]), at_end @ about[-1]])
            for of, at_end in zip(_bases(steps), _bases(0), strict=True)
        ]
        return cast(ChartRates, made[0]), cast(ChartRates, made[1])


@functools.lru_cache(maxsize=16)
def _bases(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """The derivatives of the basis at so many even steps of a piece, shape (steps, 4) each; at its end where 0."""
    shares = np.arange(steps) / steps if steps else np.ones(1)
    made = basis_slopes(shares), basis_bends(shares)
    read_only(*made)
    return made
