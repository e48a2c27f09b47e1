"""Newton's method on a motion's control points and the length of its pieces, about one evaluation of the clearance.

`planner/optimize/interior_point.py` sets the rules and the weights, and evaluates the clearance again in between.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.jit.arrays import MATRIX_OUT, SCALAR, BlocksOut, Floats, IndicesOut, Integers, numba_type
from guidefield.kernels.jit.decorators import compiled, uncounted
from guidefield.kernels.linalg.bordered_band import (
    COUPLED,
    TILE,
    BorderedFactor,
    allocate_factor,
    factorize_bordered,
    inner_product,
    solve_factorized,
)
from guidefield.kernels.optimize.clearance_model import CLEARANCE, ClearanceModel
from guidefield.kernels.optimize.limit_barrier import LIMITS, TIMES, MotionLimits, TimeLimits
from guidefield.kernels.optimize.motion_objective import (
    ENDS,
    STATES,
    MotionEnds,
    motion_objective,
    objective_value,
    place_ends,
)
from guidefield.kernels.optimize.penalties import KEPT_SAMPLES, LOADS, KeptSamples, LoadModel


@uncounted
def coupled_groups(model: ClearanceModel, couples: bool, groups_out: Integers) -> None:
    """Find coordinates that are coupled anywhere on a motion. Limits couple none, and links far from all else neither.

    Args:
        model: The clearance; its Hessians are symmetric.
        couples: Whether there are path constraints or loads: they couple all.
        groups_out: Gets where each group begins, multiples of `TILE` from 0 on, and behind the last nv.
    """
    nv, last = model.points.shape[1], groups_out.shape[0] - 2
    for t in range(last + 1):
        groups_out[t + 1] = last if couples else t  # the last tile that one is coupled with
    for s in range(model.places):
        for p in range(nv):
            q, t = nv, p // TILE + 1
            past = (groups_out[t] + 1) * TILE
            while q > past and model.hessians[s, p, q - 1] == 0.0:
                q -= 1
            if q > past:
                groups_out[t] = (q - 1) // TILE
    g = past = 0
    for t in range(last + 1):
        past = max(past, groups_out[t + 1])
        if past == t:
            g += 1
            groups_out[g] = min((t + 1) * TILE, nv)
    groups_out[0] = 0


class DescentRules(NamedTuple):
    """Settings of the steps."""

    steps: int  # at most this many
    tries: int  # lengths of a step that are tried until one is within limits and lowers the objective
    shorter: float  # by this factor
    # a step that promises less than this share of the objective is not taken, nor a further one after a whole step that
    # lowered the objective, up to this share, as if it were quadratic: it would promise as little
    settled: float
    little: float  # after a step that brought less than this share of the objective no further one is taken
    # most that a coordinate of a control point [rad, or m at size 1] and the departure [s] move in one step
    longest: float
    most_stretched: float  # most that u changes in one step
    # if a coordinate is further than this from where the clearance was evaluated, no further step is taken
    trusted: float
    damping: float  # added to the Hessian's diagonal, as a share of it


RULES = numba_type(DescentRules)


class DescentBuffers(NamedTuple):
    """Buffers of a descent, overwritten by each step: new ones would cost as much as a third of a step."""

    blocks: BlocksOut  # of the Hessian by all n control points, shape (n, nv, 4 nv)
    groups: IndicesOut  # of coordinates that are coupled
    factor: BorderedFactor  # of the factors of the free ones'


def allocate_descent_buffers(n: int, nv: int, times: TimeLimits) -> DescentBuffers:
    """Allocate the buffers for motions of n control points of nv coordinates, and for these times."""
    factor = allocate_factor(n - 2 * ENDS, nv, 1 + times.departs)
    return DescentBuffers(np.empty((n, nv, (COUPLED + 1) * nv)), np.empty_like(factor.groups), factor)


BUFFERS = numba_type(DescentBuffers)


@uncounted
def _largest(values: Floats, sizes: Floats) -> float:
    most = 0.0
    for i in range(values.shape[0]):
        most = max(most, abs(values[i]) / sizes[i % sizes.shape[0]])
    return most


@uncounted
def _move(points: Floats, ends: MotionEnds, move: Floats, stride: float, step: float, points_out: Floats) -> None:
    """Control points after a share of a step, the ends' for pieces of a length [s]."""
    n, nv = points.shape
    for i in range(ENDS, n - ENDS):
        for p in range(nv):
            points_out[i, p] = points[i, p] + stride * move[(i - ENDS) * nv + p]
    place_ends(ends, step, points_out)


@uncounted
def _distance(first: Floats, second: Floats, sizes: Floats) -> float:
    """The largest difference between the inner control points of two motions, shape (n, nv), over sizes (nv,)."""
    most = 0.0
    for i in range(ENDS, first.shape[0] - ENDS):
        for p in range(first.shape[1]):
            most = max(most, abs(first[i, p] - second[i, p]) / sizes[p])
    return most


@uncounted
def _stride(move: Floats, free: int, rules: DescentRules, sizes: Floats) -> float:
    """Share of a step, in which times are behind what is free, that goes no further than is allowed."""
    moves = _largest(move[:free], sizes)
    if move.shape[0] > free + 1:
        moves = max(moves, abs(move[free + 1]))
    stretched: float = abs(move[free])
    return min(1.0, rules.longest / max(moves, 1e-300), rules.most_stretched / max(stretched, 1e-300))


@uncounted
def _times(
    step: float, begin: float, move: Floats, stride: float, free: int, longest_step: float
) -> tuple[float, float]:
    """Length of pieces and departure after a share of a step, in which they are behind what is free [s]."""
    departure = begin + stride * move[free + 1] if move.shape[0] > free + 1 else begin
    return min(step * math.exp(stride * move[free]), longest_step), departure


@compiled(
    types.Tuple((types.float64, types.float64, types.int64, types.float64))(
        CLEARANCE,
        LOADS,
        STATES,
        LIMITS,
        TIMES,
        KEPT_SAMPLES,
        RULES,
        SCALAR,
        SCALAR,
        SCALAR,
        SCALAR,
        SCALAR,
        MATRIX_OUT,
        BUFFERS,
    )
)
def newton_descent(
    model: ClearanceModel,
    loads: LoadModel,
    ends: MotionEnds,
    limits: MotionLimits,
    times: TimeLimits,
    kept: KeptSamples,
    rules: DescentRules,
    first_step: float,
    longest_step: float,
    limit_weight: float,
    step: float,
    begin: float,
    points_out: Floats,
    buffers: DescentBuffers,
) -> tuple[float, float, int, float]:
    """Lower the objective of `motion_objective` by Newton's method; every motion on the way is within limits.

    Under path constraints each step is followed by a second-order correction (Nocedal and Wright, Numerical
    Optimization, 2006, section 18.3): the next one with the same factors.

    Args:
        model: The clearance.
        loads: The loads near their limits.
        ends: The ends of the motion.
        limits: What is kept.
        times: When it may depart and arrive.
        kept: Where path constraints are examined.
        rules: When steps are taken.
        first_step: exp(u0) [s].
        longest_step: Pieces are no longer than this [s].
        limit_weight: μ.
        step: Length of pieces [s].
        begin: Departure [s].
        points_out: Control points, shape (n, nv), strictly within limits; moved [rad or m].
        buffers: As `allocate_descent_buffers` makes them.

    Returns:
        Length of pieces [s]; departure [s]; how many steps were taken; by how much they lowered the objective.
    """
    n, nv = points_out.shape
    free, more = nv * (n - 2 * ENDS), 1 + times.departs
    blocks, factor = buffers.blocks, buffers.factor
    inner, border = blocks[ENDS : n - ENDS], np.empty((more, free))
    corner, gradient = np.empty((more, more)), np.empty(free + more)
    move, back = np.empty(free + more), np.empty(free + more)
    trial, corrected, scratch = np.empty((n, nv)), np.empty((n, nv)), np.empty(4 * nv)
    constrained = kept.frames.kinds.shape[0] > 0
    coupled_groups(model, constrained or loads.rows > 0, buffers.groups)
    groups, taken, gained = buffers.groups, 0, 0.0
    for _ in range(rules.steps):
        value = motion_objective(
            model, loads, ends, limits, times, kept, groups, points_out, step, begin, first_step, limit_weight, blocks,
            border, corner, gradient,
        )  # fmt: skip
        if not factorize_bordered(inner, groups, border, corner, rules.damping, factor):
            break
        solve_factorized(factor, inner.shape[0], -gradient, move)
        promised = -inner_product(gradient, move)
        if promised < rules.settled * abs(value):
            break
        stride = _stride(move, free, rules, limits.sizes)
        lower = math.inf
        length, departure = step, begin
        for _ in range(rules.tries):
            length, departure = _times(step, begin, move, stride, free, longest_step)
            _move(points_out, ends, move, stride, length, trial)
            lower = objective_value(
                model, loads, limits, times, kept, trial, length, departure, first_step, limit_weight, scratch
            )
            if constrained and lower < math.inf:  # back towards constraints that bend, by the same factors
                motion_objective(
                    model, loads, ends, limits, times, kept, groups, trial, length, departure, first_step, limit_weight,
                    blocks, border, corner, gradient,
                )  # fmt: skip
                solve_factorized(factor, inner.shape[0], -gradient, back)
                further, since = _times(length, departure, back, 1.0, free, longest_step)
                _move(trial, ends, back, 1.0, further, corrected)
                then = objective_value(
                    model, loads, limits, times, kept, corrected, further, since, first_step, limit_weight, scratch
                )
                if then < lower:
                    lower, length, departure = then, further, since
                    trial[:, :] = corrected
            if lower < value:
                break
            stride *= rules.shorter
        if not lower < value:
            break
        taken += 1
        gained += value - lower
        step, begin = length, departure
        points_out[:, :] = trial
        if value - lower < rules.little * abs(value) or _distance(trial, model.points, limits.sizes) > rules.trusted:
            break
        if stride == 1.0 and abs(value - lower - 0.5 * promised) < rules.settled * abs(value):
            break
    return step, begin, taken, gained
