"""Draw the motion of a case between its knots, in pieces that are polynomials in time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from guidefield.referee.case import Case


class Piece(NamedTuple):
    """A piece of a motion: a time s after its start the columns are at the sum of s^k powers[k], or beside that."""

    start: float  # [s, or knots]
    powers: np.ndarray  # shape (d + 1, n), d at least 1
    span: float
    beside: np.ndarray  # how far each column may be from there, shape (n,)


def pieces(case: Case, *, commanded: bool = False) -> Iterator[Piece]:
    """Draw the motion between its knots: straight, cubic by velocities, of degree 5 by accelerations, too (Hermite).

    Of steps each column may be anywhere between both knots; `commanded` are the straight lines instead.
    """
    p, times = case.positions, np.arange(float(len(case.positions))) if case.times is None else case.times
    for k, h in enumerate(np.diff(times).tolist()):
        beside, way = case.tolerance, p[k + 1] - p[k]
        powers = [p[k], way]
        if case.steps and not commanded:
            powers, beside = [p[k] + 0.5 * way, 0.0 * way], beside + 0.5 * np.abs(way)
        elif case.velocities is not None and case.accelerations is None:
            v, w = h * case.velocities[k : k + 2]
            powers = [p[k], v, 3.0 * way - 2.0 * v - w, v + w - 2.0 * way]
        elif case.velocities is not None and case.accelerations is not None:
            (v, w), (a, b) = h * case.velocities[k : k + 2], h * h * case.accelerations[k : k + 2]
            r, s, t = way - v - 0.5 * a, w - v - a, b - a  # what the rest adds to position, velocity, acceleration
            powers = [p[k], v, 0.5 * a, 10 * r - 4 * s + 0.5 * t, 7 * s - 15 * r - t, 6 * r - 3 * s + 0.5 * t]
        yield Piece(float(times[k]), np.array([one / h**power for power, one in enumerate(powers)]), h, beside)


def expand_about(powers: np.ndarray, s: np.ndarray | float) -> np.ndarray:
    """Return the powers of pieces, shape (…, d + 1, n), about a time after their starts, shape (…, 1) or (…, n) [s]."""
    found, degree = powers.copy(), powers.shape[-2] - 1
    for k in range(degree):
        for j in reversed(range(k, degree)):
            found[..., j, :] += s * found[..., j + 1, :]
    return found


def find_rate(powers: np.ndarray, order: int, s: np.ndarray) -> np.ndarray:
    """Return a derivative of pieces, shape (m, d + 1, n), at times after their starts, shape (…, m, n) [s]."""
    value = np.zeros(s.shape)
    for j in reversed(range(order, powers.shape[1])):
        value = value * s + math.perm(j, order) * powers[:, j]
    return value
