"""The objective of a motion as a uniform cubic B-spline in time, with gradient and Hessian by control points and times.

    exp(u - u0) + t0 / (m h0) + clearance + loads' penalty + μ · barrier of limits and times + path constraints' penalty

with u = log h, h the length of each of m pieces, h0 = exp(u0), and t0 the departure: all in all the arrival, in units
of m h0. The departure may be given. The clearance is its model's, and holds λ. The first three and the last three
control points are the ends': they are moved by u alone. A further term is added to `objective_value`, with its
derivatives to `motion_objective`, and to `_of_samples` or `_but_clearance` of planner/optimize/interior_point.py: all
three have to be the same function.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import (
    BLOCKS_OUT,
    INDICES,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    VECTOR_OUT,
    Floats,
    Integers,
    Rows,
    numba_type,
)
from guidefield.kernels.jit.decorators import compiled, uncounted
from guidefield.kernels.optimize.clearance_model import (
    CLEARANCE,
    ClearanceModel,
    add_hessians,
    expanded,
    expanded_value,
)
from guidefield.kernels.optimize.limit_barrier import (
    LIMITS,
    TIMES,
    MotionLimits,
    TimeLimits,
    add_limit_barrier,
    add_time_barrier,
    limit_barrier,
    time_barrier,
)
from guidefield.kernels.optimize.penalties import (
    KEPT_SAMPLES,
    LOADS,
    KeptSamples,
    LoadModel,
    add_constraint_penalty,
    add_load_penalty,
    constraint_penalty,
    load_penalty,
)

ENDS = 3  # control points at each end that are its own: no setting, as in `limit_barrier`, planner/motion/bspline.py


class MotionEnds(NamedTuple):
    """The states in which a motion begins and ends, each of shape (2, nv)."""

    positions: Rows  # [rad or m]
    velocities: Rows  # [rad/s or m/s]
    accelerations: Rows  # [rad/s² or m/s²]


STATES = numba_type(MotionEnds)


@uncounted
def place_ends(ends: MotionEnds, step: float, points_out: Floats) -> None:
    """The ends' control points, the first and the last three of (n, nv), for pieces of a length [s].

    Where the basis is (1, 4, 1) / 6 its derivatives are (-1, 0, 1) / (2 h) and (1, -2, 1) / h².
    """
    for e in range(2):
        first = e * (points_out.shape[0] - ENDS)
        for j in range(points_out.shape[1]):
            across, bend = step * ends.velocities[e, j], 0.5 * step * step * ends.accelerations[e, j]
            middle = ends.positions[e, j] - bend / 3.0
            points_out[first, j] = middle + bend - across
            points_out[first + 1, j] = middle
            points_out[first + 2, j] = middle + bend + across


@uncounted
def _slopes(ends: MotionEnds, step: float, slopes_out: Floats) -> None:
    """Derivatives of the ends' control points by u, shape (6, nv)."""
    for e in range(2):
        for j in range(slopes_out.shape[1]):
            across, bend = step * ends.velocities[e, j], step * step * ends.accelerations[e, j]
            slopes_out[ENDS * e, j] = bend - bend / 3.0 - across
            slopes_out[ENDS * e + 1, j] = -bend / 3.0
            slopes_out[ENDS * e + 2, j] = bend - bend / 3.0 + across


@uncounted
def _ends_to_border(blocks: Floats, first: int, past: int, slopes: Floats, border_out: Floats) -> float:
    """Add what the ends' motion with u couples to a group's border; its share of the second derivative by u."""
    n, nv = border_out.shape
    last = n - ENDS
    total = 0.0
    for i in range(n):
        for c in range(4):
            k = i - 3 + c
            if k < 0 or (ENDS <= i < last and ENDS <= k < last):
                continue
            of_i = i if i < ENDS else i - last + ENDS
            of_k = k if k < ENDS else k - last + ENDS
            for p in range(first, past):
                for q in range(first, past):
                    value = blocks[i, p, c * nv + q]
                    if ENDS <= i < last:
                        border_out[i, p] += value * slopes[of_k, q]
                    elif ENDS <= k < last:
                        border_out[k, q] += value * slopes[of_i, p]
                    else:
                        total += (1.0 if k == i else 2.0) * value * slopes[of_i, p] * slopes[of_k, q]
    return total


@uncounted
def objective_value(
    model: ClearanceModel,
    loads: LoadModel,
    limits: MotionLimits,
    times: TimeLimits,
    kept: KeptSamples,
    points: Floats,
    step: float,
    begin: float,
    first_step: float,
    limit_weight: float,
    scratch: Floats,
) -> float:
    """The objective alone, with scratch (4 nv,); infinite where a limit is reached. See `motion_objective`."""
    pieces = points.shape[0] - 3
    of_limits = limit_barrier(points, step, limits) + time_barrier(times, begin, pieces * step)
    if of_limits == math.inf:
        return of_limits
    of_constraints = constraint_penalty(kept, points)
    of_clearance = expanded_value(model, points, step, begin, scratch)
    arrival: float = step / first_step + begin / (pieces * first_step)
    return arrival + limit_weight * of_limits + of_constraints + of_clearance + load_penalty(loads, points, step)


@uncounted
def _nothing(first: int, past: int, blocks_out: Floats) -> None:
    """Set to zero what couples a group's coordinates."""
    n, nv, _ = blocks_out.shape
    for i in range(n):
        for p in range(first, past):
            for c in range(4):
                blocks_out[i, p, c * nv + first : c * nv + past] = 0.0


@uncounted
def _hold(j: int, blocks_out: Floats, border_out: Floats, gradient_out: Floats) -> None:
    """Cut a coordinate out of the system."""
    inner, nv, _ = blocks_out.shape
    border_out[:, j : inner * nv : nv] = 0.0
    for i in range(inner):
        blocks_out[i, j, :] = 0.0
        for p in range(nv):
            for c in range(4):
                blocks_out[i, p, c * nv + j] = 0.0
        blocks_out[i, j, 3 * nv + j] = 1.0
        gradient_out[i * nv + j] = 0.0


@compiled(
    SCALAR(
        CLEARANCE,
        LOADS,
        STATES,
        LIMITS,
        TIMES,
        KEPT_SAMPLES,
        INDICES,
        MATRIX,
        SCALAR,
        SCALAR,
        SCALAR,
        SCALAR,
        BLOCKS_OUT,
        MATRIX_OUT,
        MATRIX_OUT,
        VECTOR_OUT,
    )
)
def motion_objective(
    model: ClearanceModel,
    loads: LoadModel,
    ends: MotionEnds,
    limits: MotionLimits,
    times: TimeLimits,
    kept: KeptSamples,
    groups: Integers,
    points: Floats,
    step: float,
    begin: float,
    first_step: float,
    limit_weight: float,
    blocks_out: Floats,
    border_out: Floats,
    corner_out: Floats,
    gradient_out: Floats,
) -> float:
    """The objective of a motion, its gradient and Hessian by the free control points and k times: u, and t0 if free.

    Of the ends' points, which move with u, the Hessian has the Gauss-Newton part: the gradient times their second
    derivatives is left out.

    Args:
        model: The clearance; holds λ.
        loads: The loads near their limits.
        ends: The ends of the motion.
        limits: What is kept. A coordinate whose range is a single value is cut out of the system.
        times: When it may depart and arrive.
        kept: Where path constraints are examined.
        groups: Of coordinates that may be coupled, as `newton_descent.coupled_groups` gives them.
        points: Control points, shape (n, nv), n > 6, strictly within limits [rad or m].
        step: h [s].
        begin: t0 [s].
        first_step: h0 [s].
        limit_weight: μ.
        blocks_out: Hessian by all points, as in `clearance_model`, shape (n, nv, 4 nv); without the first three and the
            last three it is that of the n - 6 free points, as in `bordered_band`. What couples different groups means
            nothing.
        border_out: By the times and these, shape (k, (n - 6) nv).
        corner_out: By the times, shape (k, k).
        gradient_out: By the points, then the times, shape ((n - 6) nv + k,).

    Returns:
        The objective.
    """
    n, nv = points.shape
    gradient, slopes, scratch = np.empty((n, nv)), np.empty((2 * ENDS, nv)), np.empty((3, 4 * nv))
    border, corner, by_times = model.border.copy(), model.corner.copy(), np.empty(2)
    g = 0
    while groups[g] < nv:
        _nothing(groups[g], groups[g + 1], blocks_out)
        g += 1
    add_hessians(model, scratch[0], blocks_out)
    of_clearance, by_times[0], by_times[1] = expanded(model, points, step, begin, scratch[0], gradient)
    of_limits, by_u, by_uu = add_limit_barrier(points, step, limits, limit_weight, gradient, blocks_out, border[0])
    by_times[0] += by_u
    corner[0, 0] += by_uu
    of_loads, by_u, by_uu = add_load_penalty(loads, points, step, scratch, gradient, blocks_out, border[0])
    by_times[0] += by_u
    corner[0, 0] += by_uu
    of_limits += add_time_barrier(times, begin, (n - 3) * step, limit_weight, by_times, corner)
    duration, of_begin = step / first_step, 1.0 / ((n - 3) * first_step)
    of_constraints = add_constraint_penalty(kept, points, gradient, blocks_out)
    total: float = of_clearance + of_loads + of_limits + duration + of_begin * begin + of_constraints
    by_times[0] += duration
    by_times[1] += of_begin
    corner[0, 0] += duration
    _slopes(ends, step, slopes)
    last = n - ENDS
    for i in range(n):  # the ends' points move with u
        if ENDS <= i < last:
            continue
        row = i if i < ENDS else i - last + ENDS
        for p in range(nv):
            by_times[0] += slopes[row, p] * gradient[i, p]
            corner[0, 0] += 2.0 * slopes[row, p] * border[0, i, p]
            corner[0, 1] += slopes[row, p] * border[1, i, p]
    g = 0
    while groups[g] < nv:
        corner[0, 0] += _ends_to_border(blocks_out, groups[g], groups[g + 1], slopes, border[0])
        g += 1
    corner[1, 0] = corner[0, 1]
    free, more = nv * (n - 2 * ENDS), corner_out.shape[0]
    for i in range(ENDS, last):
        for p in range(nv):
            gradient_out[(i - ENDS) * nv + p] = gradient[i, p]
            for e in range(more):
                border_out[e, (i - ENDS) * nv + p] = border[e, i, p]
    for e in range(more):
        gradient_out[free + e] = by_times[e]
        for f in range(more):
            corner_out[e, f] = corner[e, f]
    for j in range(nv):
        if limits.lower[j] >= limits.upper[j]:
            _hold(j, blocks_out[ENDS:last], border_out, gradient_out)
    return total
