"""Where a motion of Bezier curves is, and how far it goes between two times."""

from __future__ import annotations

from guidefield.kernels.jit.signatures import Floats, lane_part
from guidefield.kernels.minimum.tables import BezierCurve

MOST_ORDER = 8
"""Control points of a curve, at most."""


@lane_part
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


@lane_part
def share_at(curve: BezierCurve, piece: int, time: float) -> float:
    """How much of a piece has passed at a time, from 0 to 1."""
    span = curve.times[piece + 1] - curve.times[piece]
    return min(max((time - curve.times[piece]) / span, 0.0), 1.0) if span > 0.0 else 0.0


@lane_part
def point_of(controls: Floats, piece: int, share: float, row: Floats, point_out: Floats) -> None:
    """The point of a Bezier curve at a share of it, by de Casteljau.

    Args:
        controls: Of all curves, shape (k, order, nv).
        piece: Which curve.
        share: From 0 to 1.
        row: Scratch, shape (MOST_ORDER,).
        point_out: Shape (nv,).
    """
    order = controls.shape[1]
    for j in range(controls.shape[2]):
        for i in range(order):
            row[i] = controls[piece, i, j]
        for step in range(1, order):
            for i in range(order - step):
                row[i] += share * (row[i + 1] - row[i])
        point_out[j] = row[0]


@lane_part
def _write_part(controls: Floats, piece: int, low: float, high: float, row: Floats, part_out: Floats) -> None:
    """Write the control points of a part of a Bezier curve, by its blossom.

    Args:
        controls: Of all curves, shape (k, order, nv).
        piece: Which curve.
        low: Where the part begins, from 0 to 1.
        high: Where it ends.
        row: Scratch, shape (MOST_ORDER,).
        part_out: Shape (MOST_ORDER, nv), the first ones.
    """
    order = controls.shape[1]
    for j in range(controls.shape[2]):
        for index in range(order):
            for i in range(order):
                row[i] = controls[piece, i, j]
            for step in range(1, order):
                share = high if step <= index else low
                for i in range(order - step):
                    row[i] += share * (row[i + 1] - row[i])
            part_out[index, j] = row[0]


@lane_part
def find_ways(
    curve: BezierCurve,
    since: float,
    until: float,
    middle: Floats,
    row: Floats,
    part: Floats,
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
        row: Scratch, shape (MOST_ORDER,).
        part: Scratch, shape (MOST_ORDER, nv).
        straight_out: From where it is at first to where it is at last, D, shape (nv,).
        farthest_out: The most of each coordinate of x, where it is from the place, shape (nv,).
        aside_out: The most of each coordinate of x - l D, where l D is the nearest to x on the line along D, (nv,).

    Returns:
        The most of the size of l.
    """
    controls, order, nv = curve.positions, curve.positions.shape[1], curve.positions.shape[2]
    first, last = piece_at(curve, since), piece_at(curve, until)
    point_of(controls, first, share_at(curve, first, since), row, farthest_out)
    point_of(controls, last, share_at(curve, last, until), row, aside_out)
    square, share = 0.0, 0.0
    for j in range(nv):
        straight_out[j] = aside_out[j] - farthest_out[j]
        square += straight_out[j] ** 2
        farthest_out[j], aside_out[j] = 0.0, 0.0
    for piece in range(first, last + 1):
        low, high = share_at(curve, piece, since), share_at(curve, piece, until)
        whole = low == 0.0 and high == 1.0
        if not whole:
            _write_part(controls, piece, low, high, row, part)
        for index in range(order):
            along = 0.0
            for j in range(nv):
                x = (controls[piece, index, j] if whole else part[index, j]) - middle[j]
                along += x * straight_out[j]
            along = along / square if square > 0.0 else 0.0
            share = max(share, abs(along))
            for j in range(nv):
                x = (controls[piece, index, j] if whole else part[index, j]) - middle[j]
                farthest_out[j] = max(farthest_out[j], abs(x))
                aside_out[j] = max(aside_out[j], abs(x - along * straight_out[j]))
    return share
