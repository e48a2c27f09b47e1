"""The logarithmic barrier of when a motion departs and arrives.

A motion of m pieces of length h, u = log h, departs at t0 and arrives at t0 + m h. The barrier is

    -log(t0 / T) - log((latest - t0) / T) - log((t0 + m h - earliest) / T)

in units of T, without what is infinite, and without the first two where the departure is given. Its Hessian is Gauss
and Newton's.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from guidefield.kernels.jit.fields import numba_type
from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Floats


class TimeLimits(NamedTuple):
    """When a motion may depart and arrive.

    Attributes:
        departs: How many departures there are to choose from: 1, or 0 where it is given.
        latest: It departs before [s].
        earliest: It arrives after [s].
        unit: T [s].
    """

    departs: int
    latest: float
    earliest: float
    unit: float


TIMES = numba_type(TimeLimits)


@uncounted
def time_barrier(times: TimeLimits, begin: float, duration: float) -> float:
    """The barrier of a departure and a duration [s]; infinite where a limit is reached."""
    total, over = 0.0, 1.0 / times.unit
    if times.departs > 0:
        if begin <= 0.0 or begin >= times.latest:
            return math.inf
        total -= math.log(begin * over)
        if times.latest < math.inf:
            total -= math.log((times.latest - begin) * over)
    if times.earliest > -math.inf:
        if begin + duration <= times.earliest:
            return math.inf
        total -= math.log((begin + duration - times.earliest) * over)
    return total


@uncounted
def add_time_barrier(
    times: TimeLimits, begin: float, duration: float, weight: float, by_times_out: Floats, corner_out: Floats
) -> float:
    """Add the weighted barrier's derivatives to those by (u, t0), shapes (2,) and (2, 2); its weighted value."""
    if times.departs > 0:
        by_times_out[1] -= weight / begin
        corner_out[1, 1] += weight / (begin * begin)
        left = times.latest - begin
        by_times_out[1] += weight / left
        corner_out[1, 1] += weight / (left * left)
    if times.earliest > -math.inf:
        over = 1.0 / (begin + duration - times.earliest)
        by_u = duration * over
        by_times_out[0] -= weight * by_u
        by_times_out[1] -= weight * over
        corner_out[0, 0] += weight * by_u * by_u
        corner_out[0, 1] += weight * by_u * over
        corner_out[1, 0] += weight * by_u * over
        corner_out[1, 1] += weight * over * over
    return weight * time_barrier(times, begin, duration)
