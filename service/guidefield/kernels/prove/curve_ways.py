"""Where a motion of Bezier curves is, and how far it goes between two times."""

from __future__ import annotations

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Floats
from guidefield.kernels.prove.tables import BezierCurve

MOST_ORDER = 8
"""Control points of a curve, at most."""


@uncounted
def piece_at(curve: BezierCurve, time: float) -> int:
    """The piece that is run through at a time: at a knot the one that begins there."""
    low, high = 0, curve.times.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if curve.times[middle] <= time:
            low = middle
        else:
            high = middle
    return low


@uncounted
def share_at(curve: BezierCurve, piece: int, time: float) -> float:
    """How much of a piece has passed at a time, from 0 to 1."""
    span = curve.times[piece + 1] - curve.times[piece]
    return min(max((time - curve.times[piece]) / span, 0.0), 1.0) if span > 0.0 else 0.0


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
def write_point(curve: BezierCurve, time: float, weights: Floats, point_out: Floats) -> None:
    """Write where a motion is at a time; scratch of shape (MOST_ORDER,)."""
    piece = piece_at(curve, time)
    _write_blossom(curve.positions, piece, share_at(curve, piece, time), 0.0, 0, weights, point_out)


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
def _widen(
    control: Floats, middle: Floats, straight: Floats, per_square: float, farthest: Floats, aside: Floats
) -> float:
    """Widen how far a motion goes so that it may go to a control point; the size of its l. See `find_ways`."""
    along = 0.0
    for j in range(middle.shape[0]):
        along += (control[j] - middle[j]) * straight[j]
    along *= per_square
    for j in range(middle.shape[0]):
        x = control[j] - middle[j]
        farthest[j] = max(farthest[j], abs(x))
        aside[j] = max(aside[j], abs(x - along * straight[j]))
    return abs(along)


@uncounted
def find_ways(
    curve: BezierCurve,
    since: float,
    until: float,
    middle: Floats,
    weights: Floats,
    parts: Floats,
    straight_out: Floats,
    farthest_out: Floats,
    aside_out: Floats,
) -> float:
    """How far a motion goes between two times from a place of it.

    Control points of the part of each piece that is between them are no nearer.

    Args:
        curve: The motion.
        since: From when [s].
        until: Until when, later [s].
        middle: The place, shape (nv,).
        weights: Scratch, shape (MOST_ORDER,).
        parts: Scratch, shape (2, MOST_ORDER, nv).
        straight_out: From where it is at first to where it is at last, D, shape (nv,).
        farthest_out: The most of each coordinate of x, where it is from the place, shape (nv,).
        aside_out: The most of each coordinate of x - l D, where l D is the nearest to x on the line along D, (nv,).

    Returns:
        The most of the size of l.
    """
    controls, order, nv = curve.positions, curve.positions.shape[1], curve.positions.shape[2]
    first, last = piece_at(curve, since), piece_at(curve, until)
    for end in range(2 if last > first else 1):
        piece = first if end == 0 else last
        low, high = share_at(curve, piece, since), share_at(curve, piece, until)
        _write_part(controls, piece, low, high, weights, parts[end])
    final = 1 if last > first else 0
    square, share = 0.0, 0.0
    for j in range(nv):
        straight_out[j] = parts[final, order - 1, j] - parts[0, 0, j]
        square += straight_out[j] ** 2
        farthest_out[j], aside_out[j] = 0.0, 0.0
    per_square = 1.0 / square if square > 0.0 else 0.0
    for piece in range(first + 1, last):
        for index in range(order):
            control = controls[piece, index]
            share = max(share, _widen(control, middle, straight_out, per_square, farthest_out, aside_out))
    for end in range(final + 1):
        for index in range(order):
            control = parts[end, index]
            share = max(share, _widen(control, middle, straight_out, per_square, farthest_out, aside_out))
    return share
