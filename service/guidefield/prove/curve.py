"""Motions as Bezier curves: their points, halves and ranges, and by how much they exceed limits of position.

A curve lies in the box of its control points (the convex hull property): certificates and limits rely on it. `EXACT`
has to stay far below `LIMIT_TOLERANCE` of verdict.py, beyond which an excess counts; few `MOST_HALVINGS` miss excesses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.kernels.prove.placement import find_halves, find_ranges
from guidefield.read_only import ReadOnly
from guidefield.robot.model.joints import LocalCurves, LocalPoint, LocalPoints

EXACT = 1e-13  # curves are halved until the largest excess is known to this [rad or m]
MOST_HALVINGS = 60  # parts of 2^-60 of a curve are as good as points


def ranges(controls: LocalCurves) -> tuple[LocalPoints, LocalPoints]:
    """Return the least and the largest of each curve's control points (m, k, nv) by coordinate, (m, nv) each."""
    low, high = np.empty((2, len(controls), controls.shape[2]))
    find_ranges(np.ascontiguousarray(controls), low, high)
    return cast(LocalPoints, low), cast(LocalPoints, high)


def polyline(path: LocalPoints) -> LocalCurves:
    """Straight pieces between local coordinates, shape (n, nv), as Bezier control points, shape (n - 1, 2, nv).

    A single point is one piece.
    """
    if len(path) == 1:
        return np.repeat(path[None], 2, axis=1)
    return np.stack([path[:-1], path[1:]], axis=1)


def point_on(controls: LocalPoints, parameter: float) -> LocalPoint:
    """Return the point (nv,) of a Bezier curve, control points (k, nv), at a parameter by de Casteljau's scheme."""
    row = controls
    while len(row) > 1:
        row = row[:-1] + parameter * (row[1:] - row[:-1])
    point: LocalPoint = row[0]
    return point


def halve_curves(controls: LocalCurves) -> LocalCurves:
    """Return both halves of each Bezier curve (n, k, nv), in order, by de Casteljau's scheme, shape (2 n, k, nv)."""
    halves = cast(LocalCurves, np.empty((2 * len(controls), *controls.shape[1:])))
    find_halves(np.ascontiguousarray(controls), halves)
    return halves


def restrict_curves(controls: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return control points of parts of Bezier curves (n, k, nv), parameters low to high (n,), by their blossom."""
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


def excesses(pieces: LocalCurves, lower: LocalPoint, upper: LocalPoint) -> tuple[np.ndarray, np.ndarray]:
    """Find by how much each coordinate of each piece is beyond its limits at most, and where.

    Args:
        pieces: Bezier control points in local coordinates, shape (m, k, nv) [rad or m].
        lower: Lower limits, shape (nv,) [rad or m]; infinite where there are none.
        upper: Upper limits, likewise.

    Returns:
        The largest excess, shape (m, nv) [rad or m]; where no control point is beyond a limit a bound of it, which
        isn't positive but for rounding. The parameter of its place on the piece, from 0 to 1, shape (m, nv).
    """
    low, high = ranges(pieces)
    most, places = np.maximum(lower - low, high - upper), np.zeros(low.shape)
    which, at = np.nonzero(most > EXACT)
    if len(which):
        most[which, at], places[which, at] = _largest(pieces[which, :, at], lower[at], upper[at])
    return most, places


def _largest(curves: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the largest excess of curves of one coordinate each, (p, k), over limits (p,), and its parameter, (p,)."""
    ends = np.maximum(lower[:, None] - curves[:, [0, -1]], curves[:, [0, -1]] - upper[:, None])
    most, places = ends.max(axis=1), np.argmax(ends, axis=1).astype(float)
    parts, of, starts, width = curves[:, :, None], np.arange(len(curves)), np.zeros(len(curves)), 1.0
    for _ in range(MOST_HALVINGS):
        parts, of, starts, width = halve_curves(parts), np.repeat(of, 2), np.repeat(starts, 2), 0.5 * width
        starts[1::2] += width
        begun = np.maximum(lower[of] - parts[:, 0, 0], parts[:, 0, 0] - upper[of])
        for k in np.flatnonzero(begun > most[of]):
            if begun[k] > most[of[k]]:
                most[of[k]], places[of[k]] = begun[k], starts[k]
        reached = np.maximum(lower[of] - parts.min(axis=(1, 2)), parts.max(axis=(1, 2)) - upper[of])
        left = reached > np.maximum(most[of], 0.0) + EXACT
        if not left.any():
            break
        parts, of, starts = parts[left], of[left], starts[left]
    return most, places


def largest_magnitudes(curves: np.ndarray, beside: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
    """Find the largest magnitude of each coordinate along Bezier curves, to `EXACT` of it.

    Args:
        curves: Control points, shape (m, k, nv), m >= 1.
        beside: Numbers that are added to the magnitude on each curve, shape (m, nv); None: nothing.

    Returns:
        The magnitude, the index of its curve and the parameter on it, shape (nv,) each.
    """
    count, order, nv = curves.shape
    columns = np.arange(nv)
    more = np.zeros((count, nv)) if beside is None else beside
    ends = np.abs(curves[:, [0, -1]]) + more[:, None]
    flat = ends.reshape(2 * count, nv).argmax(axis=0)
    most, piece, places = ends.reshape(2 * count, nv)[flat, columns], flat // 2, (flat % 2).astype(float)
    bound = np.abs(curves).max(axis=1) + more
    of, at = np.nonzero(bound > most * (1.0 + EXACT) + EXACT)
    parts, starts, width = np.ascontiguousarray(curves[of, :, at])[:, :, None], np.zeros(len(of)), 1.0
    for _ in range(MOST_HALVINGS if order > 2 else 0):
        if not len(of):
            break
        parts, of, at, starts, width = halve_curves(parts), of.repeat(2), at.repeat(2), starts.repeat(2), 0.5 * width
        starts[1::2] += width
        begun = np.abs(parts[:, 0, 0]) + more[of, at]
        for k in np.flatnonzero(begun > most[at]):
            if begun[k] > most[at[k]]:
                most[at[k]], piece[at[k]], places[at[k]] = begun[k], of[k], starts[k]
        reached = np.abs(parts).max(axis=(1, 2)) + more[of, at]
        left = reached > most[at] * (1.0 + EXACT) + EXACT
        parts, of, at, starts = parts[left], of[left], at[left], starts[left]
    return most, piece, places


@dataclass(frozen=True, eq=False)
class Curve(ReadOnly):
    """A chain of Bezier curves in the group's local coordinates, each run through evenly, and a tube about them.

    With a tube the robot may be anywhere in a box of its half widths about the curve, at each time. Only then may the
    curve jump from one piece to the next.
    """

    pieces: LocalCurves  # control points, shape (m, k, nv) [rad or m]
    times: np.ndarray  # begin of each, and the end of the last one, shape (m + 1,) [s]; pieces may take no time
    tube: np.ndarray | None = None  # half widths about each piece, shape (m, nv) [rad or m]; None: there is none

    @property
    def box(self) -> tuple[LocalPoint, LocalPoint]:
        """Lower and upper corner of a box about it and its tube, each of shape (nv,) [rad or m]."""
        low, high = self.pieces.min(axis=1), self.pieces.max(axis=1)
        if self.tube is not None:
            low, high = low - self.tube, high + self.tube
        return low.min(axis=0), high.max(axis=0)

    @property
    def jumps(self) -> bool:
        """Whether a piece begins elsewhere than the one before ends."""
        return bool((self.pieces[1:, 0] != self.pieces[:-1, -1]).any())

    def up_to(self, count: int) -> Curve:
        """Return its first `count` pieces."""
        return Curve(self.pieces[:count], self.times[: count + 1], None if self.tube is None else self.tube[:count])

    def at(self, times: np.ndarray) -> LocalPoints:
        """Return the points at times (n,), shape (n, nv) [rad or m]."""
        piece, share = find_pieces(self.times, times)
        row, at = self.pieces[piece], share[:, None, None]
        while row.shape[1] > 1:
            row = row[:, :-1] + at * (row[:, 1:] - row[:, :-1])
        points: LocalPoints = row[:, 0]
        return points

    def point(self, piece: int, parameter: float) -> LocalPoint:
        """Return the point (nv,) of a piece at a parameter from 0 to 1."""
        return point_on(self.pieces[piece], parameter)


def find_pieces(knots: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the pieces that are run through at times (n,), and the share of each that has passed, (n,) each.

    Knots (m + 1,) are begins of pieces, and the end of the last one; pieces may take no time. Times outside count as
    the nearer end. At a knot the later piece counts.
    """
    piece = np.minimum(np.maximum(np.searchsorted(knots, times, side="right") - 1, 0), len(knots) - 2)
    spans = knots[piece + 1] - knots[piece]
    passed = np.minimum(np.maximum(times - knots[piece], 0.0), spans)
    return piece, np.divide(passed, spans, out=np.zeros_like(passed), where=spans > 0.0)
