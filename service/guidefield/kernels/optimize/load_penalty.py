"""A penalty of a motion's loads beyond a share of their limits, with derivatives by control points and time.

A load is a torque, or the speed of a point in space, as a share of its limit. Those near their limits are expanded
where they were evaluated (`torque_loads`, `speed_loads`): torques, and the three components of velocities, are q = q0 +
a · z + b · z' + c · z''. The penalty is

    1/2 w · sum of max(0, |q| - s)²

At the share t of a piece of length h, z = B P, z' = B' P / h and z'' = B'' P / h², with B the basis of the piece's four
control points. By u = log h a load changes by -b · z' - 2 c · z''. The Hessian is Gauss and Newton's of torques; that
of speeds, which are convex in velocities, has their curvature too. Unlike the clearance's it is made anew in each of
Newton's steps, so that a step knows of loads that begin to exceed their limits. It leads the optimizer alone: whether
limits are kept is checked by `planner/task`, on bounds. Another form has to be that of `largest_torque_loads` and
`largest_speed_loads`, too: by their sums candidates are given up unlooked at.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import Blocks, Floats, Indices, Row, Rows, numba_type
from guidefield.kernels.jit.decorators import kernel, uncounted


class LoadModel(NamedTuple):
    """Loads of a motion about control points where they were evaluated, in k rows, the first `rows` of which count.

    Torques have a row each, and after them velocities three.
    """

    torques: int  # how many
    rows: int
    weight: float  # w
    share: float  # s
    bases: Blocks  # of samples on a piece of length 1: the basis and its first two derivatives, shape (s, 3, 4)
    pieces: Indices  # the piece of each row, shape (k,)
    samples: Indices  # its sample on that piece, shape (k,)
    values: Row  # q0, shape (k,)
    slopes: Blocks  # a, b and c, shape (k, 3, nv)


LOADS = numba_type(LoadModel)


@uncounted
def _place(loads: LoadModel, k: int, points: Floats, step: float, state: Floats) -> None:
    """Write point, velocity and acceleration at a row's sample, shape (3, nv), unless they are there from the last."""
    piece, sample = loads.pieces[k], loads.samples[k]
    if k > 0 and loads.pieces[k - 1] == piece and loads.samples[k - 1] == sample:
        return
    for order in range(3):
        over = 1.0 if order == 0 else (1.0 / step if order == 1 else 1.0 / (step * step))
        b0, b1, b2, b3 = (
            over * loads.bases[sample, order, 0],
            over * loads.bases[sample, order, 1],
            over * loads.bases[sample, order, 2],
            over * loads.bases[sample, order, 3],
        )
        for p in range(points.shape[1]):
            value = b0 * points[piece, p] + b1 * points[piece + 1, p]
            state[order, p] = value + b2 * points[piece + 2, p] + b3 * points[piece + 3, p]


@uncounted
def _expand(loads: LoadModel, k: int, state: Floats) -> tuple[float, float]:
    """Return what a row comes to at a state, and its derivative by u."""
    by, value, of_dz, of_ddz = loads.slopes[k], loads.values[k], 0.0, 0.0
    for p in range(state.shape[1]):
        value += by[0, p] * state[0, p]
        of_dz += by[1, p] * state[1, p]
        of_ddz += by[2, p] * state[2, p]
    return value + of_dz + of_ddz, -of_dz - 2.0 * of_ddz


@kernel
def load_penalty(loads: LoadModel, points: Rows, step: float) -> float:
    """Return the penalty at control points (n, nv), for pieces of a length [s]."""
    total, square, state = 0.0, 0.0, np.empty((3, points.shape[1]))
    for k in range(loads.rows):
        _place(loads, k, points, step, state)
        value = _expand(loads, k, state)[0]
        square += value * value
        if k < loads.torques or (k - loads.torques) % 3 == 2:
            beyond = math.sqrt(square) - loads.share
            square = 0.0
            if beyond > 0.0:
                total += beyond * beyond
    return 0.5 * loads.weight * total


@uncounted
def _write_row(loads: LoadModel, k: int, step: float, by_points_out: Floats) -> None:
    """Write the derivatives of a row by the four control points of its piece, shape (4 nv,)."""
    by, bases = loads.slopes[k], loads.bases[loads.samples[k]]
    nv = by.shape[1]
    for a in range(4):
        b0, b1, b2 = bases[0, a], bases[1, a] / step, bases[2, a] / (step * step)
        for p in range(nv):
            by_points_out[a * nv + p] = b0 * by[0, p] + b1 * by[1, p] + b2 * by[2, p]


@uncounted
def _add_square(
    piece: int, weight: float, of_u: float, by_points: Floats, blocks_out: Floats, border_out: Floats
) -> None:
    """Add the Hessian of half a row's square by control points, and by these and u."""
    nv = border_out.shape[1]
    for a in range(4):
        for p in range(nv):
            here = weight * by_points[a * nv + p]
            border_out[piece + a, p] += of_u * here
            into = blocks_out[piece + a, p, (3 - a) * nv :]
            for q in range((a + 1) * nv):
                into[q] += here * by_points[q]


@uncounted
def add_load_penalty(
    loads: LoadModel,
    points: Floats,
    step: float,
    rows: Floats,
    gradient_out: Floats,
    blocks_out: Floats,
    border_out: Floats,
) -> tuple[float, float, float]:
    """Add the penalty to derivatives by all control points; return its value, first and second derivative by u.

    Args:
        loads: The loads.
        points: Control points, shape (n, nv).
        step: h [s].
        rows: Scratch, shape (3, 4 nv).
        gradient_out: By the control points, shape (n, nv).
        blocks_out: Hessian as in `clearance_model.add_hessian`, shape (n, nv, 4 nv).
        border_out: Hessian by control points and u, shape (n, nv).
    """
    nv, total, by_u, by_uu, k = points.shape[1], 0.0, 0.0, 0.0, 0
    row, along, state = rows[0], rows[1], rows[2, : 3 * nv].reshape(3, nv)
    while k < loads.rows:
        width = 1 if k < loads.torques else 3
        _place(loads, k, points, step, state)
        square = 0.0
        for c in range(width):
            square += _expand(loads, k + c, state)[0] ** 2
        load = math.sqrt(square)
        beyond, piece = load - loads.share, loads.pieces[k]
        if beyond > 0.0:
            total += beyond * beyond
            along[:] = 0.0
            along_u, bend = 0.0, loads.weight * beyond / load
            for c in range(width):
                value, of_u = _expand(loads, k + c, state)
                _write_row(loads, k + c, step, row)
                along_u += value / load * of_u
                for q in range(4 * nv):
                    along[q] += value / load * row[q]
                if width > 1:  # what is across
                    by_uu += bend * of_u * of_u
                    _add_square(piece, bend, of_u, row, blocks_out, border_out)
            weight = loads.weight if width == 1 else loads.weight - bend
            by_u += loads.weight * beyond * along_u
            by_uu += weight * along_u * along_u
            _add_square(piece, weight, along_u, along, blocks_out, border_out)
            for a in range(4):
                for p in range(nv):
                    gradient_out[piece + a, p] += loads.weight * beyond * along[a * nv + p]
        k += width
    return 0.5 * loads.weight * total, by_u, by_uu
