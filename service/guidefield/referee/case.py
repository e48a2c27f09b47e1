"""The case that the referee judges, its motion as polynomials in time, its limits, and the verdicts about it.

`loading.py` builds cases from files; `judge.py` and `replay.py` decide on nothing else. The motion between knots has to
be that of docs/referee.md, because all bounds rest on it. Values of `Answer` are what users read.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np


@dataclass(frozen=True, eq=False)
class Screw:
    """An obstacle's motion: on a screw from each placement to the next, at rest before the first and after the last."""

    times: np.ndarray  # shape (k,), increasing [s]; k is at least 2
    stops: Sequence[Any]  # placements of the obstacle's frame in the world at those times, pinocchio.SE3
    # its velocity in itself from each to the next, (k - 1, 6), linear part first: log(T_i^-1 T_i+1) / dt
    twists: np.ndarray


@dataclass(frozen=True, eq=False)
class Body:
    """A collision shape of a link, a held object, or an obstacle."""

    name: str  # of the link, the held object or the obstacle
    joint: int  # pinocchio's index of the joint that carries it; 0 is the world
    placement: Any  # of the shape in the joint's frame, pinocchio.SE3; of an obstacle that moves, in its own frame
    exact: Any  # Coal's shape of what is declared; of a cloud tiny triangles at its points
    rounding: float  # what it is rounded by all around: the radius of a cloud's balls [m]
    # points whose hull contains the body, in the shape's frame, shape (8, 3) [m]; of a half-space, which has none,
    # zeros
    corners: np.ndarray
    # Coal's convex shapes that are said to contain the mesh, in the same frame; none where there are none
    parts: Sequence[Any]
    triangles: np.ndarray  # the mesh's triangles, shape (t, 3, 3) [m, the shape's frame]; none where it isn't a mesh
    shell: np.ndarray  # triangles that are said to be the mesh closed and turned outwards, shape (s, 3, 3); often none
    points: np.ndarray  # a point of each connected piece, shape (p, 3) [m, the shape's frame]
    obstacle: bool  # whether it is an obstacle
    screw: Screw | None = None  # how it moves, if it does so by itself


@dataclass(frozen=True, eq=False)
class Constraint:
    """A frame's axis stays within a cone, or its origin near a plane or a line."""

    name: str  # its kind and frame, for a reader
    joint: int  # pinocchio's index of the joint that carries the frame
    placement: Any  # of the frame in that joint's, pinocchio.SE3
    limit: float  # largest angle or distance [rad or m]
    axis: np.ndarray  # of a cone: unit vector in the frame, shape (3,); else zeros
    target: np.ndarray  # of a cone: unit vector in the world that the axis stays near, shape (3,); else zeros
    point: np.ndarray  # on the plane or line, shape (3,) [m, world]; of a cone zeros
    # directions in which the distance from it counts, orthonormal rows, shape (1, 3) or (2, 3); of a cone (0, 3)
    across: np.ndarray
    corners: np.ndarray  # the frame's origin in itself, eight times, shape (8, 3)
    screw: None = None


@dataclass(frozen=True, eq=False)
class Case:
    """A motion of a robot among obstacles, and what it is said to keep.

    The model has `model.nv` local coordinates, joint by joint in Pinocchio's order: a joint's value or unwrapped
    angle; x, y and angle of a planar joint; position and rotation vector of a floating one. At a motion's columns z it
    is ``spread @ z + offset``: so mimic joints follow, and joints without a column stand still.
    """

    model: Any  # pinocchio's model; a ball joint is a floating one that stays where it is
    spread: np.ndarray  # shape (model.nv, n)
    offset: np.ndarray  # shape (model.nv,)
    # which local coordinates are angles or rotation vectors of joints of several freedoms, (model.nv,)
    turning: np.ndarray
    # where `turning`, the rotation vector of the orientation from which others count, shape (model.nv,)
    turned: np.ndarray
    bodies: Sequence[Body]  # the robot's, then obstacles
    constraints: Sequence[Constraint]  # along the path
    rows: Sequence[str]  # the joint that each local coordinate of the model is about
    columns: Sequence[str]  # the joint that each of the motion's columns is about
    times: np.ndarray | None  # of the knots, shape (k,) [s]; None of a path
    positions: np.ndarray  # shape (k, n) [rad or m]
    velocities: np.ndarray | None  # shape (k, n) [rad/s or m/s]; None: from knot to knot it goes straight on
    accelerations: np.ndarray | None  # shape (k, n) [rad/s² or m/s²]; None: it is cubic, or straight
    steps: bool  # whether each column may be anywhere between both knots' values, instead of on the drawn motion
    tolerance: np.ndarray  # how far each column may be beside that, shape (n,) [rad or m]
    lower: np.ndarray  # least local coordinates of the model, shape (model.nv,); infinite where there is no limit
    upper: np.ndarray  # largest values, shape (model.nv,)
    # largest velocity, acceleration and jerk of each column of z, shape (3, n); infinite where there is none
    rates: np.ndarray
    clearance: float  # distance to keep from obstacles [m]
    left_out: Sequence[tuple[str, str, str]]  # two names and a reason: pairs that are not judged
    unknown: Sequence[str]  # what the file has and the referee can't judge, in words


class Answer(enum.Enum):
    """The verdict in a word."""

    FREE = "free"
    CONTACT = "contact"
    TOO_CLOSE = "closer than required"
    INSIDE = "inside a closed mesh at the start"
    BEYOND_LIMIT = "beyond a limit"
    CONSTRAINT_BROKEN = "a path constraint is broken"
    FALSE_PART = "a convex part or closed shell is not that of its mesh"
    NOT_PROVED = "the proof doesn't hold"
    UNDECIDED = "undecided"
    NOT_JUDGED = "not judged"


@dataclass(frozen=True)
class Finding:
    """One answer, and where."""

    answer: Answer  # the verdict
    # two bodies, or the joint and its limit, or a constraint, or what can't be judged; empty where all is free
    about: tuple[str, ...] = ()
    time: float = math.nan  # when [s]; along a path, how many segments in
    distance: float = math.nan  # of the bodies there [m]; by how much a limit or constraint is exceeded


@dataclass(frozen=True)
class Verdict:
    """A finding, and what it rests on."""

    finding: Finding  # the answer, and where
    kept: float = math.inf  # margin above the required distances that all judged pairs are proved to keep [m]
    pairs: int = 0  # how many pairs were judged
    left_out: tuple[tuple[str, str, str], ...] = ()  # two names and a reason: pairs about which nothing is said
    evaluations: int = 0  # distances that Coal was asked for, or slabs of a proof

    @property
    def answer(self) -> Answer:
        """The verdict in a word."""
        return self.finding.answer


def lines(verdict: Verdict, rests_on: str = "distances") -> Iterator[str]:
    """Yield the verdict, what it rests on, and every pair that was left out, a line each."""
    found = verdict.finding
    about = ("; " if found.answer is Answer.NOT_JUDGED else " and ").join(found.about)
    when = "" if math.isnan(found.time) else f" at {found.time:.6g}"
    how_far = "" if math.isnan(found.distance) else f", {found.distance:.9g}"
    yield f"referee: {found.answer.value}" + (f": {about}{when}{how_far}" if about else "")
    if found.answer is Answer.FREE:
        kept = "" if math.isinf(verdict.kept) else f"; each keeps at least {verdict.kept:.3g} m more than is required"
        yield f"{verdict.pairs} pairs, {verdict.evaluations} {rests_on}{kept}"
    yield f"pairs left out: {len(verdict.left_out)}"
    for first, second, why in sorted(verdict.left_out):
        yield f"  {first} and {second}: {why}"


SLACK, ROUNDING = 1e-6, 1e-9
"""Excess that is allowed, as docs/certificate.md says: share of a rate's limit; beyond one of position [rad or m]."""
DIGITS = 4e-15  # relative error of double precision, summed up over a few operations; more lets more jumps pass
KINDS = ("position", "velocity", "acceleration", "jerk")
HALVINGS = 60  # of a span in which a rate's zero is: down to rounding
AT_ONCE = 2000  # pieces whose extremes are found together


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
    """Find a limit that is exceeded: by a position or rate at its extremes, or by an unbounded jerk at a knot."""
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
    """Return the first of the excesses on a piece that begins at a time, at that time the largest of the first kind."""
    moves = np.abs(case.spread).argmax(axis=1)  # the column that each local coordinate depends on
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
    """A piece of a motion: a time s after its start the columns are the sum of s^k powers[k], within `beside`."""

    start: float  # [s, or knots]
    powers: np.ndarray  # shape (d + 1, n), d at least 1
    span: float
    beside: np.ndarray  # how far each column may be from there, shape (n,)


def pieces(case: Case, *, commanded: bool = False) -> Iterator[Piece]:
    """Draw the motion between its knots: straight, cubic by velocities, of degree 5 by accelerations, too (Hermite).

    In steps each column may be anywhere between both knots; with `commanded` their straight lines are drawn instead.
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
