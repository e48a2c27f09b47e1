"""Parts of a motion that are judged together: Bezier curves in a box of the chart, and how they are divided."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np

from guidefield.kernels.certificate.halves import find_halves
from guidefield.kernels.certificate.ranges import find_ranges
from guidefield.prove.settings import CERTIFICATE
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints

CHECKS_AHEAD = 8
"""Places after an undecided one that are checked for contact; each is twice as far ahead as the one before."""
MANY = 64.0
"""A curve that spans so many times `CERTIFICATE.widest` is divided bit by bit."""


class CurveSegment(NamedTuple):
    """A part of a piece, or several pieces, not judged yet.

    Attributes:
        piece: Index of the piece, or of the first of them.
        controls: Control points, shape (m, k, nv).
        start, end: Parameters on a single piece; 0 and 1 for several.
        pairs: Index and bodies of the pairs that are left, shape (k, 3); None: all are.
    """

    piece: int
    controls: ChartCurves
    start: float
    end: float
    pairs: np.ndarray | None

    def parts(self, count: int, pairs: np.ndarray | None) -> list[CurveSegment]:
        """About so many parts of it in order, two at least, for some pairs, shape (k, 3)."""
        pieces = len(self.controls)
        if pieces > 1:
            cuts = [pieces * k // min(count, pieces) for k in range(min(count, pieces) + 1)]
            return [CurveSegment(self.piece + a, self.controls[a:b], 0.0, 1.0, pairs) for a, b in pairwise(cuts)]
        curves = halved(self.controls)
        while len(curves) < count:
            curves = halved(curves)
        share = (self.end - self.start) / len(curves)
        starts = [self.start + k * share for k in range(len(curves))]
        return [
            CurveSegment(self.piece, curves[k : k + 1], start, end, pairs)
            for k, (start, end) in enumerate(zip(starts, [*starts[1:], self.end], strict=True))
        ]


def curve_segments(pieces: ChartCurves) -> Iterator[CurveSegment]:
    """Pieces in order: short ones together, long ones halved until no coordinate spans more than `CERTIFICATE.widest`.

    Each is made when it is asked for: a motion may be of any length.

    Args:
        pieces: Control points, shape (m, k, nv).
    """
    if not len(pieces):
        return
    low, high = ranges(pieces)
    spans = (high - low).max(axis=1)
    number, alone = (np.cumsum(spans) - 0.5 * spans) // CERTIFICATE.together, spans > CERTIFICATE.together
    begun = np.flatnonzero((number[1:] != number[:-1]) | alone[1:] | alone[:-1]) + 1
    wide = spans > CERTIFICATE.widest
    for first, last in pairwise([0, *begun.tolist(), len(pieces)]):
        if not wide[first]:
            yield CurveSegment(first, pieces[first:last], 0.0, 1.0, None)
        else:
            yield from _parts_of_wide(first, pieces[first:last], 0.0, 1.0)


def _parts_of_wide(piece: int, controls: ChartCurves, start: float, end: float) -> Iterator[CurveSegment]:
    """The parts of a piece from one parameter to another that span little enough; control points (1, k, nv)."""
    if _span(controls) > MANY * CERTIFICATE.widest:
        middle = 0.5 * (start + end)
        first, second = halved(controls)[:, None]
        yield from _parts_of_wide(piece, first, start, middle)
        yield from _parts_of_wide(piece, second, middle, end)
        return
    parts = controls
    while _span(parts) > CERTIFICATE.widest:
        parts = halved(parts)
    at = [start + (end - start) * (index / len(parts)) for index in range(len(parts))]
    for part, begin, until in zip(parts, at, [*at[1:], end], strict=True):
        yield CurveSegment(piece, part[None], begin, until, None)


def _span(controls: ChartCurves) -> float:
    """The most that a coordinate spans on one of some curves, control points (m, k, nv)."""
    low, high = ranges(controls)
    return float((high - low).max())


def ranges(controls: ChartCurves) -> tuple[ChartPoints, ChartPoints]:
    """The least and the largest of each curve's control points, shape (m, k, nv), by coordinate: (m, nv) each."""
    low, high = np.empty((2, len(controls), controls.shape[2]))
    find_ranges(np.ascontiguousarray(controls), low, high)
    return cast(ChartPoints, low), cast(ChartPoints, high)


def point_on(controls: ChartPoints, parameter: float) -> ChartPoint:
    """Return the point (nv,) of a Bezier curve, control points (k, nv), at a parameter by de Casteljau's scheme."""
    row = controls
    while len(row) > 1:
        row = row[:-1] + parameter * (row[1:] - row[:-1])
    point: ChartPoint = row[0]
    return point


Place = tuple[int, float]
"""Index of a piece, and the parameter on it."""


def places_ahead(free_until: Place, undecided: Place, count: int) -> Iterator[Place]:
    """Yield places shortly after an undecided one, where the contact that it comes before may be proved.

    Args:
        free_until: Up to where the motion is certified.
        undecided: Where it is undecided.
        count: Number of pieces of the motion.
    """
    here = sum(undecided)
    for doubling in range(CHECKS_AHEAD):
        ahead = min(here + 2**doubling * (here - sum(free_until)), count)
        piece = min(int(ahead), count - 1)
        yield piece, ahead - piece
        if ahead == count:
            return


def halved(controls: ChartCurves) -> ChartCurves:
    """Both halves of each Bezier curve, in order, by de Casteljau's scheme.

    Args:
        controls: Control points, shape (n, k, nv).

    Returns:
        Shape (2 n, k, nv).
    """
    halves = cast(ChartCurves, np.empty((2 * len(controls), *controls.shape[1:])))
    find_halves(np.ascontiguousarray(controls), halves)
    return halves
