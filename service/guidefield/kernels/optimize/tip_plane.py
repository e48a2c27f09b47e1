"""A guide plane that a motion's tip crosses: where it comes nearest, and what missing it costs, in one call each.

`planner/optimize/passages.py` has the formulas, and the same in Python for places that aren't planes: both have to be
changed together.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.jit.arrays import (
    BLOCKS_OUT,
    INDICES_OUT,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    Floats,
    Integers,
    Row,
    Rows,
    numba_type,
)
from guidefield.kernels.jit.decorators import compiled, inlined
from guidefield.kernels.kinematics.forward_kinematics import CarriedPoint, frame_positions, frame_slopes
from guidefield.kernels.optimize.clearance_model import add_gradient
from guidefield.kernels.timing.hermite import spline_points, spline_slopes

SAMPLES = 5  # about a place, an odd number above 1, here and in planner/optimize/passages.py: the middle one is there


class TipPlane(NamedTuple):
    """A robot's tip, and a guide plane's heights: over it, and over its inset edges, where it is one side of it."""

    tip: CarriedPoint  # the tip
    directions: Rows  # along which heights are taken, the plane's first, over the robot's size, shape (k, 3) [1/m]
    heights: Row  # of the plane and its inset edges along them, shape (k,)


TIP_PLANE = numba_type(TipPlane)


@inlined
def _write_misses(place: TipPlane, tip: Floats, missed_out: Floats) -> float:
    """Return what a tip misses the plane and its edges by, shape (k,); the sum of the squares."""
    square = 0.0
    for r in range(place.heights.shape[0]):
        height = -place.heights[r]
        for c in range(3):
            height += place.directions[r, c] * tip[c]
        missed_out[r] = height if r == 0 else min(height, 0.0)
        square += missed_out[r] * missed_out[r]
    return square


@compiled(SCALAR(TIP_PLANE, MATRIX, SCALAR, SCALAR, SCALAR, types.int64))
def nearest_crossing(
    place: TipPlane, points: Floats, about: float, spacing: float, closer: float, shifts: int
) -> float:
    """Return where a spline comes nearest to a plane, in pieces from the start, as `passages.nearest`.

    Args:
        place: The plane.
        points: Control points, shape (m + 3, nv) [rad or m].
        about: Where it was, in pieces from the start.
        spacing: Of samples at first, in pieces.
        closer: Share of it with which they are taken again.
        shifts: How often samples are taken at most.
    """
    last, first = float(points.shape[0] - 3), spacing
    at, zs, tips = np.empty(SAMPLES), np.empty((SAMPLES, points.shape[1])), np.empty((SAMPLES, 3))
    squares, missed = np.empty(SAMPLES), np.empty(place.heights.shape[0])
    for _ in range(shifts):
        for k in range(SAMPLES):
            at[k] = min(max(about + spacing * (k - SAMPLES // 2), 0.0), last)
        spline_points(points, at, zs)
        frame_positions(place.tip, zs, tips)
        least = 0
        for k in range(SAMPLES):
            squares[k] = _write_misses(place, tips[k], missed)
            least = k if squares[k] < squares[least] else least
        if squares[SAMPLES // 2] == 0.0:
            return float(at[SAMPLES // 2])
        about = at[least]
        if least in (0, SAMPLES - 1):
            continue
        if spacing < first:
            before, after = squares[least - 1], squares[least + 1]
            bend = before - 2.0 * squares[least] + after
            about += 0.5 * spacing * (before - after) / bend if bend > 0.0 else 0.0
            return min(max(about, 0.0), last)
        spacing *= closer
    return about


@compiled(
    SCALAR(TIP_PLANE, MATRIX, SCALAR, SCALAR, SCALAR, types.int64, MATRIX_OUT, INDICES_OUT, MATRIX_OUT, BLOCKS_OUT)
)
def add_crossing(
    place: TipPlane,
    points: Floats,
    at: float,
    weight: float,
    crossing: float,
    s: int,
    gradient_out: Floats,
    pieces_out: Integers,
    basis_out: Floats,
    hessians_out: Floats,
) -> float:
    """Add what missing a plane adds to the objective of a motion, as `passages.add_passage`, as place s of a model.

    Args:
        place: The plane.
        points: Control points, shape (m + 3, nv) [rad or m].
        at: Where the motion comes nearest, in pieces from the start.
        weight: w.
        crossing: κ.
        s: Which place it is.
        gradient_out: By the control points, shape (m + 3, nv).
        pieces_out: As `clearance_model.ClearanceModel` has them, shape (places,).
        basis_out: The same, shape (places, 4).
        hessians_out: The same, shape (places, nv, nv).

    Returns:
        Its value.
    """
    nv, k = points.shape[1], place.heights.shape[0]
    where, z, slope, tip = np.array([at]), np.empty((1, nv)), np.empty((1, nv)), np.empty((1, 3))
    of_tip, missed, rows = np.empty((3, nv)), np.empty(k), np.zeros((k, nv))
    spline_points(points, where, z)
    spline_slopes(points, where, slope)
    frame_positions(place.tip, z, tip)
    frame_slopes(place.tip, z[0], of_tip)
    square = _write_misses(place, tip[0], missed)
    gradient, passed, along = np.zeros(nv), np.zeros(nv), crossing * crossing
    for r in range(k):
        if r > 0 and missed[r] == 0.0:
            continue
        speed = 0.0
        for p in range(nv):
            for c in range(3):
                rows[r, p] += place.directions[r, c] * of_tip[c, p]
            speed += rows[r, p] * slope[0, p]
        along += speed * speed
        for p in range(nv):
            gradient[p] += missed[r] * rows[r, p]
            passed[p] += speed * rows[r, p]
    hessian = hessians_out[s]
    for p in range(nv):
        for q in range(nv):
            hessian[p, q] = -weight * passed[p] * passed[q] / along
        for r in range(k):
            share = weight * rows[r, p]
            for q in range(nv):
                hessian[p, q] += share * rows[r, q]
    pieces_out[s] = min(max(int(at), 0), points.shape[0] - 4)
    t = at - pieces_out[s]
    u, basis = 1.0 - t, basis_out[s]
    basis[0], basis[3] = u * u * u / 6.0, t * t * t / 6.0
    basis[1], basis[2] = (4.0 + t * t * (3.0 * t - 6.0)) / 6.0, (4.0 + u * u * (3.0 * u - 6.0)) / 6.0
    add_gradient(pieces_out[s], basis, weight, gradient, gradient_out)
    return 0.5 * weight * square
