"""Where a motion of Bezier curves is, and its largest rates between two times."""

from __future__ import annotations

import numpy as np

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
def largest_between(controls: Floats, curve: BezierCurve, since: float, until: float, row: Floats, out: Floats) -> None:
    """The largest sizes of a motion's rates between two times, each coordinate by itself.

    Control points of the part of each piece that is between them, by its blossom, are no less.

    Args:
        controls: Of the rates, shape (k, order, nv).
        curve: The motion.
        since: From when [s].
        until: Until when, later [s].
        row: Scratch, shape (MOST_ORDER,).
        out: Shape (nv,).
    """
    order, nv = controls.shape[1], controls.shape[2]
    for j in range(nv):
        out[j] = 0.0
    piece = piece_at(curve, since)
    while piece < controls.shape[0]:
        low, high = share_at(curve, piece, since), share_at(curve, piece, until)
        for j in range(nv):
            for index in range(order):
                for i in range(order):
                    row[i] = controls[piece, i, j]
                for step in range(1, order):
                    share = high if step <= index else low
                    for i in range(order - step):
                        row[i] += share * (row[i + 1] - row[i])
                out[j] = max(out[j], np.abs(row[0]))
        piece += 1
        if piece < controls.shape[0] and curve.times[piece] >= until:
            break
