"""Draw the motion of a case between its knots, in pieces that are polynomials in time, and check its limits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from guidefield.referee.case import Case
from guidefield.referee.verdict import Answer, Finding

SLACK, ROUNDING = (
    1e-6,
    1e-9,
)  # share of a rate's limit, and distance [rad or m] beyond one of position, that count as none
DIGITS = 4e-15  # what 64 bits leave out of 1
KINDS = ("position", "velocity", "acceleration", "jerk")
HALVINGS, AT_ONCE = 60, 2000  # of a span in which a zero is; pieces whose extremes are found at once


def _monotone_between(powers: np.ndarray, spans: np.ndarray) -> np.ndarray:
    edges = np.stack([np.zeros((len(spans), powers.shape[2])), np.tile(spans[:, None], powers.shape[2])])
    for order in reversed(range(1, powers.shape[1] - 1)):
        low, high = edges[:-1], edges[1:]
        positive = find_rate(powers, order, low) > 0.0
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            same = (find_rate(powers, order, middle) > 0.0) == positive
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        edges = np.sort(np.concatenate([edges, low]), axis=0)
    return edges


def beyond_limit(case: Case) -> Finding | None:
    """A limit that is exceeded where a position or a rate of any column is extreme, or a limited jerk without bound."""
    told, kinds = [*pieces(case, commanded=True)], 1 if case.times is None else 4
    for first in range(0, len(told), AT_ONCE):
        some = told[max(first - 1, 0) : first + AT_ONCE]  # with the piece before, whose acceleration may jump
        powers, spans = np.array([one.powers for one in some]), np.array([one.span for one in some])
        s = _monotone_between(powers, spans)
        y = find_rate(powers, 0, s) @ case.spread.T + case.offset  # each depends on one column
        rates = [find_rate(powers, order, s) for order in (1, 2, 3)]
        over = [np.maximum(y - case.upper, case.lower - y)]
        over += [np.abs(rate) - limit * (1.0 + SLACK) for rate, limit in zip(rates, case.rates, strict=True)]
        if case.accelerations is None:  # else it is the same on both sides of a knot
            shorter = np.minimum(spans[1:], spans[:-1])[:, None]
            allowed = SLACK * case.rates[1] + DIGITS * (1.0 + np.abs(powers[1:, 0])) / shorter**2
            jumps = np.abs(rates[1][0, 1:] - rates[1][-1, :-1]) > allowed
            over[3][0, 1:][jumps & np.isfinite(case.rates[2])] = math.inf
        worst = np.array([one.max(axis=(0, 2), initial=-1.0) for one in over[:kinds]])
        if len(refused := np.flatnonzero((worst > ROUNDING).any(axis=0))):
            return _first_excess(case, some[int(refused[0])].start, int(refused[0]), s, over[:kinds])
    return None


def _first_excess(case: Case, start: float, k: int, s: np.ndarray, over: list[np.ndarray]) -> Finding:
    """The first of the excesses on a piece that begins at a time, and of those then the largest of the first kind."""
    moves = np.abs(case.spread).argmax(axis=1)  # the column that each number of the model's chart depends on
    times = [s[:, k, moves], *[s[:, k]] * 3]
    found = [
        (float(times[kind][at, of]), kind, -float(one[at, k, of]), int(of))
        for kind, one in enumerate(over)
        for at, of in np.argwhere(one[:, k] > ROUNDING)
    ]
    time, kind, excess, of = min(found)
    name = (case.columns if kind else case.rows)[of]
    return Finding(Answer.BEYOND_LIMIT, (name, KINDS[kind]), start + time, -excess)


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
