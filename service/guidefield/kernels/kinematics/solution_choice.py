"""Which of many configurations are distinct, and a few of them that lie far apart."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import int64, types

from guidefield.kernels.jit.fields import Indices, Row, numba_type
from guidefield.kernels.jit.signatures import MATRIX, Floats, Integers, compiled, inlined

_INDICES_OUT = types.Array(types.int64, 1, "C")


class Measure(NamedTuple):
    """How far two chart points are from each other.

    Attributes:
        periods: By how much a coordinate may differ without any difference, 0 for none, shape (nv,) [rad or m].
        units: The difference that counts as one, shape (nv,) [rad or m].
        rotations: Where rotation vectors begin, of which the angle between the two counts, shape (b,).
    """

    periods: Row
    units: Row
    rotations: Indices


MEASURE = numba_type(Measure)


@inlined
def _turn_between(a: Floats, b: Floats, at: int) -> float:
    """Angle between two rotation vectors' rotations [rad]."""
    va, vb = (
        math.sqrt(a[at] ** 2 + a[at + 1] ** 2 + a[at + 2] ** 2),
        math.sqrt(b[at] ** 2 + b[at + 1] ** 2 + b[at + 2] ** 2),
    )
    sa = math.sin(0.5 * va) / va if va > 1e-9 else 0.5
    sb = math.sin(0.5 * vb) / vb if vb > 1e-9 else 0.5
    dot = sa * sb * (a[at] * b[at] + a[at + 1] * b[at + 1] + a[at + 2] * b[at + 2])
    return 2.0 * math.acos(min(abs(dot + math.cos(0.5 * va) * math.cos(0.5 * vb)), 1.0))


@inlined
def _apart(measure: Measure, a: Floats, b: Floats) -> tuple[float, float]:
    """The largest of the differences between two points, and the sum of their squares."""
    largest, squared, rotation = 0.0, 0.0, 0
    for d in range(a.shape[0]):
        if rotation < measure.rotations.shape[0] and d >= measure.rotations[rotation]:
            difference = _turn_between(a, b, d) if d == measure.rotations[rotation] else 0.0
            if d == measure.rotations[rotation] + 2:
                rotation += 1
        else:
            difference = abs(a[d] - b[d])
            if measure.periods[d] > 0.0:
                difference = abs(difference - measure.periods[d] * np.rint(difference / measure.periods[d]))
        difference /= measure.units[d]
        largest, squared = max(largest, difference), squared + difference * difference
    return largest, squared


@compiled(int64(MEASURE, MATRIX, int64, _INDICES_OUT))
def distinct(measure: Measure, points: Floats, known: int, kept_out: Integers) -> int:
    """Points that differ from every one before by more than one unit in some coordinate.

    Args:
        measure: How differences are measured.
        points: Chart points, shape (n, nv); the first `known` are distinct.
        known: See points.
        kept_out: Indices of the distinct ones, the known first; shape (n,).

    Returns:
        How many there are.
    """
    count = known
    for i in range(known):
        kept_out[i] = i
    for i in range(known, points.shape[0]):
        alone = True
        for k in range(count):
            if _apart(measure, points[i], points[kept_out[k]])[0] <= 1.0:
                alone = False
                break
        if alone:
            kept_out[count] = i
            count += 1
    return count


@compiled(types.void(MEASURE, MATRIX, int64, _INDICES_OUT))
def farthest_apart(measure: Measure, points: Floats, given: int, chosen_out: Integers) -> None:
    """Choose points, each the farthest from those chosen before it; ties go to the first.

    Args:
        measure: How differences are measured; the distance is the root of the sum of their squares.
        points: Chart points, shape (n, nv); the first `given` are chosen, at least one.
        given: See points.
        chosen_out: Indices of the chosen, in order; shape (m,), m <= n.
    """
    nearest = np.full(points.shape[0], np.inf)
    for place in range(chosen_out.shape[0]):
        best = place
        if place >= given:
            best = 0
            for i in range(points.shape[0]):
                if nearest[i] > nearest[best]:
                    best = i
        chosen_out[place] = best
        for i in range(points.shape[0]):
            nearest[i] = min(nearest[i], _apart(measure, points[i], points[best])[1])
