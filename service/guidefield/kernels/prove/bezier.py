"""Points, bounds and halves of a motion of Bezier curves (de Casteljau)."""

from __future__ import annotations

from numba import void

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import BLOCKS, BLOCKS_OUT, MATRIX_OUT, Floats, lane_kernel
from guidefield.kernels.prove.tables import BezierCurve

MOST_ORDER = 8
"""Control points of a curve, at most."""


@uncounted
def piece_at(curve: BezierCurve, at: float) -> int:
    """Return the piece at a parameter: at a knot the one that begins there."""
    low, high = 0, curve.times.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if curve.times[middle] <= at:
            low = middle
        else:
            high = middle
    return low


@uncounted
def share_at(curve: BezierCurve, piece: int, at: float) -> float:
    """Return the share of a piece that has passed at a parameter, from 0 to 1."""
    span = curve.times[piece + 1] - curve.times[piece]
    return min(max((at - curve.times[piece]) / span, 0.0), 1.0) if span > 0.0 else 0.0


@uncounted
def _write_blossom(
    controls: Floats, piece: int, low: float, high: float, highs: int, weights: Floats, point_out: Floats
) -> None:
    """Write the blossom of a Bezier curve at `highs` times one parameter, and else another.

    With the parameters s it is the sum of the control points by the coefficients of the product of all 1 - s + s x,
    sorted by powers of x.

    Args:
        controls: Of all curves, shape (k, order, nv).
        piece: Which curve.
        low: One parameter, from 0 to 1.
        high: The other.
        highs: How often that is taken, at most order - 1.
        weights: Scratch, shape (MOST_ORDER,).
        point_out: Shape (nv,).
    """
    order = controls.shape[1]
    weights[0] = 1.0
    for taken in range(1, order):
        s = high if taken <= highs else low
        weights[taken] = s * weights[taken - 1]
        for power in range(taken - 1, 0, -1):
            weights[power] = (1.0 - s) * weights[power] + s * weights[power - 1]
        weights[0] *= 1.0 - s
    for j in range(point_out.shape[0]):
        point_out[j] = weights[0] * controls[piece, 0, j]
    for i in range(1, order):
        for j in range(point_out.shape[0]):
            point_out[j] += weights[i] * controls[piece, i, j]


@uncounted
def write_point(curve: BezierCurve, at: float, weights: Floats, point_out: Floats) -> None:
    """Write the point of a motion at a parameter; scratch of shape (MOST_ORDER,)."""
    piece = piece_at(curve, at)
    _write_blossom(curve.positions, piece, share_at(curve, piece, at), 0.0, 0, weights, point_out)


@uncounted
def _write_part(controls: Floats, piece: int, low: float, high: float, weights: Floats, part_out: Floats) -> None:
    """Write the control points of a part of a Bezier curve.

    Args:
        controls: Of all curves, shape (k, order, nv).
        piece: Which curve.
        low: Where the part begins, from 0 to 1.
        high: Where it ends.
        weights: Scratch, shape (MOST_ORDER,).
        part_out: Shape (MOST_ORDER, nv), the first ones.
    """
    for index in range(controls.shape[1]):
        _write_blossom(controls, piece, low, high, index, weights, part_out[index])


@uncounted
def _widen(control: Floats, along: float, middle: Floats, chord: Floats, farthest: Floats, aside: Floats) -> None:
    """Widen bounds of a motion about its middle by a control point whose l is known; see `bound_segment`."""
    for j in range(middle.shape[0]):
        x = control[j] - middle[j]
        farthest[j] = max(farthest[j], abs(x))
        aside[j] = max(aside[j], abs(x - along * chord[j]))


@uncounted
def _along(control: Floats, middle: Floats, chord: Floats, per_square: float) -> float:
    """Return the l of the point on the line along a chord that is nearest to a control point."""
    along = 0.0
    for j in range(middle.shape[0]):
        along += (control[j] - middle[j]) * chord[j]
    return along * per_square


@uncounted
def time_at(curve: BezierCurve, at: float) -> float:
    """Return the time at a parameter [s]."""
    piece = piece_at(curve, at)
    return float(curve.clock[piece] + share_at(curve, piece, at) * (curve.clock[piece + 1] - curve.clock[piece]))


@uncounted
def bound_segment(
    curve: BezierCurve,
    since: float,
    until: float,
    now: float,
    timed: bool,
    middle: Floats,
    weights: Floats,
    parts: Floats,
    chord_out: Floats,
    farthest_out: Floats,
    aside_out: Floats,
) -> float:
    """Bound a motion between two parameters about a place of it: x = l D + e, with D the chord.

    Control points of the part of each piece that is between them are no nearer. Where obstacles move l is the share of
    the time that has passed since the place, so that both go on together; else that of the nearest point along D.

    Args:
        curve: The motion.
        since: The one parameter.
        until: The other, larger.
        now: The time at the place [s].
        timed: Whether l is a share of the time.
        middle: The place, shape (nv,).
        weights: Scratch, shape (MOST_ORDER,).
        parts: Scratch, shape (2, MOST_ORDER, nv).
        chord_out: From the first point to the last, D, shape (nv,).
        farthest_out: The most of each coordinate of x, the way from the place, shape (nv,).
        aside_out: The most of each coordinate of e, shape (nv,).

    Returns:
        The most of the size of l.
    """
    controls, order, nv = curve.positions, curve.positions.shape[1], curve.positions.shape[2]
    first, last = piece_at(curve, since), piece_at(curve, until)
    for side in range(2 if last > first else 1):
        piece = first if side == 0 else last
        low, high = share_at(curve, piece, since), share_at(curve, piece, until)
        _write_part(controls, piece, low, high, weights, parts[side])
    final = 1 if last > first else 0
    square, share = 0.0, 0.0
    for j in range(nv):
        chord_out[j] = parts[final, order - 1, j] - parts[0, 0, j]
        square += chord_out[j] ** 2
        farthest_out[j], aside_out[j] = 0.0, 0.0
    per_square = 1.0 / square if square > 0.0 else 0.0
    begins, ends = time_at(curve, since), time_at(curve, until)
    timed = timed and ends > begins
    per_second = 1.0 / (ends - begins) if timed else 0.0
    for piece in range(first, last + 1):
        at_end = piece in (first, last)
        begin, end = curve.clock[piece], curve.clock[piece + 1]
        if piece == first:
            begin = begins
        if piece == last:
            end = ends
        for index in range(order):
            control = parts[0 if piece == first else final, index] if at_end else controls[piece, index]
            along = _along(control, middle, chord_out, per_square)
            if timed:  # in a piece time is the curve of degree 1 whose control points are even
                along = (begin + (end - begin) * index / (order - 1) - now) * per_second
            share = max(share, abs(along))
            _widen(control, along, middle, chord_out, farthest_out, aside_out)
    return share


@lane_kernel(void(BLOCKS, BLOCKS_OUT))
def find_halves(curves: Floats, halves: Floats) -> None:
    """Find both halves of each curve, in order.

    Args:
        curves: Control points, shape (n, k, nv).
        halves: Out: theirs, shape (2 n, k, nv).
    """
    count, order, nv = curves.shape
    for curve in range(count):
        first, second = halves[2 * curve], halves[2 * curve + 1]
        for at in range(order):
            for i in range(nv):
                second[at, i] = curves[curve, at, i]
        for step in range(order):
            for i in range(nv):
                first[step, i] = second[0, i]
            for at in range(order - 1 - step):  # what is behind them is the second half already
                for i in range(nv):
                    second[at, i] = 0.5 * (second[at, i] + second[at + 1, i])


@lane_kernel(void(BLOCKS, MATRIX_OUT, MATRIX_OUT))
def find_ranges(curves: Floats, low: Floats, high: Floats) -> None:
    """Find the least and the largest value of each coordinate of each curve's control points.

    Args:
        curves: Control points, shape (n, k, nv).
        low: Out: shape (n, nv).
        high: Out: shape (n, nv).
    """
    count, order, nv = curves.shape
    for curve in range(count):
        for i in range(nv):
            low[curve, i] = high[curve, i] = curves[curve, 0, i]
        for at in range(1, order):
            for i in range(nv):
                low[curve, i] = min(low[curve, i], curves[curve, at, i])
                high[curve, i] = max(high[curve, i], curves[curve, at, i])
