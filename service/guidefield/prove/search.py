"""The search over a motion: a verdict, the smallest distances within spans, and the distances at samples, in one pass.

Kernels search by branch and bound (`kernels.prove.search`), Coal confirms: at the place of a refusal it has to find the
pair closer than required, within its accuracy; otherwise there is a bug, and an exception instead of an answer.
`TOLERANCE` and `RESOLUTION_FLOOR` are what replies promise. The others are time, which distance within `TOLERANCE` is
found, and what is said at each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.kernels.prove.kept_distance import LOG_CAPACITY, LOG_COUNT, LOG_ROW, LOG_ROWS
from guidefield.kernels.prove.search import BEGINS, DEEPEST, ENDS, INTERVAL, LOG_ENDS, prove_along
from guidefield.kernels.prove.tables import (
    ANSWER,
    AT_REST,
    BOUND,
    CULPRIT,
    DISTANCE,
    END,
    ERROR,
    FREE,
    IN_CONTACT,
    IN_MOTION,
    KINDS,
    MARGIN,
    OWN,
    OWN_PAIRS,
    PAIR,
    PLACE,
    REASON,
    RESOLUTION,
    SEGMENTS,
    SINCE,
    STAND_OFF,
    TIME,
    TOO_CLOSE,
    UNTIL,
    VERDICT,
    MovingRobot,
)
from guidefield.prove.closest import put_obstacle
from guidefield.prove.curve import Curve, find_pieces
from guidefield.prove.tables import ARITHMETIC, bezier_curve, index_of_pair, with_passing_speeds, world_tables
from guidefield.prove.verdict import Reason, Verdict, with_coal_error
from guidefield.read_only import ReadOnly

TOLERANCE = 1e-4  # maximum error of a smallest distance [m], at size 1

RESOLUTION_FLOOR = 1e-5
"""A pair that moves no farther in a segment and still can't be separated is undecided [m], at size 1;
`docs/certificate.md`."""

EVERY_KIND = OWN_PAIRS | AT_REST | IN_MOTION  # kinds of pairs: the robot with itself, obstacles at rest, moving ones
SEGMENTS_AT_ONCE = 2000  # segments after which the deadline is examined, a few milliseconds; at least 1

LAST_SEGMENTS = 256
"""Most segments that a verdict may need once time is up: some milliseconds; a Baxter's takes a hundred. Not for
distances; with fewer, motions that are free more often end as STOPPED."""

OWN_SAMPLE_STRIDE = 34
"""Pairs of the robot with itself are sampled at every 34th sample, and at the last: another number, at least 1, may
tell another pair and depth in contact. With 8 a UR5 takes a tenth longer, a Baxter a fiftieth less."""

COARSE_SHARE = 1 / 15
"""In segments longer than this share of the motion only spheres and boxes are examined: twice or half of it takes a
UR5 and a Baxter longer. Unrecorded."""

SHORT_MOTION = 0.1  # motions no longer than this in any coordinate have no such segments [rad or m]. Unrecorded
STOPPED_SHARE = 1 / 32  # once time is up, segments of this share aren't halved: larger, bounds are looser; above 0

LOOKAHEAD_PLACES = 8
"""Places after an undecided one at which contact is searched for as the reason, each twice as far ahead as the last."""

_REASONS = {FREE: Reason.FREE, IN_CONTACT: Reason.CONTACT, TOO_CLOSE: Reason.TOO_CLOSE}


class ContradictionError(Exception):
    """Two judges of the same motion contradict each other: an internal failure, never an answer.

    Attributes:
        motion: The robot among obstacles, the motion, and the required clearance [m]; None if it is kept as a file
            already.
    """

    def __init__(self, said: str, motion: tuple[World, Curve, float] | None = None) -> None:
        super().__init__(said)
        self.motion = motion


@dataclass(frozen=True)
class Smallest:
    """A smallest distance."""

    # at `time` between the bodies of `pair` [m]; infinite without a pair; 0 or less where bodies overlap, and no depth
    distance: float = np.inf
    bound: float = np.inf  # certified lower bound of all distances [m]
    time: float = np.nan  # when [s]
    pair: int = -1
    tolerance: float = TOLERANCE  # by how much the bound is smaller, if the search came to its end [m]


class SearchQuery(NamedTuple):
    """The questions about a motion that a search answers."""

    # clearance from obstacles for the verdict [m], the robot must only not touch itself; None: no verdict
    min_clearance: float | None = None
    resolution: float = RESOLUTION_FLOOR  # see `RESOLUTION_FLOOR` [m]
    kinds: int = EVERY_KIND
    in_time: bool = True  # whether obstacles move; else they rest where they are at first
    # spans in each of which the smallest distance from obstacles is found; in the first the robot's own, too [s]
    spans: Sequence[tuple[float, float]] = ()
    # times at which the distance from obstacles is found, in order, the motion's ends among them, shape (k,) [s]; none
    # if only a verdict is needed
    samples: np.ndarray = np.empty(0)


class SearchLog(NamedTuple):
    """The log of how a search closes pairs, for a proof; see `kernels.prove.kept_distance`."""

    numbers: np.ndarray  # a header and rows, shape (n,)
    segments: np.ndarray  # begin, end and middle of each segment, not a number where there is none, shape (s, LOG_ENDS)

    @classmethod
    def with_capacity(cls, rows: int) -> SearchLog:
        """Allocate a log for a number of rows and of segments."""
        numbers = np.zeros(LOG_ROWS + LOG_ROW * rows)
        numbers[LOG_CAPACITY] = rows
        return cls(numbers, np.full((rows, LOG_ENDS), np.nan))

    @property
    def is_complete(self) -> bool:
        """Whether nothing was left out for want of room."""
        return bool(self.numbers[LOG_COUNT] <= self.numbers[LOG_CAPACITY] and np.isnan(self.segments[-1:, 0]).all())

    @property
    def rows(self) -> np.ndarray:
        """The rows that were written, shape (k, LOG_ROW)."""
        return self.numbers[LOG_ROWS:].reshape(-1, LOG_ROW)[: int(self.numbers[LOG_COUNT])]


@dataclass(frozen=True, eq=False)
class SearchResult(ReadOnly):
    """The answers of a search."""

    verdict: Verdict
    obstacle: list[Smallest]  # the smallest distance from obstacles within each span
    own: Smallest  # the smallest distance of the robot from itself within the first span
    distances: np.ndarray  # the smallest distance from obstacles at each sample, shape (k,) [m]; infinite without one


def without_distances(verdict: Verdict) -> SearchResult:
    """Return a verdict without any distance."""
    return SearchResult(verdict, [], Smallest(), np.empty(0))


def search(
    world: World, curve: Curve, goal: SearchQuery, deadline: Deadline = UNLIMITED, log: SearchLog | None = None
) -> SearchResult:
    """Search a motion.

    Args:
        log: Receives how pairs are closed; None if no proof is needed.

    Raises:
        ContradictionError: if Coal doesn't confirm what the search found.
    """
    return _MotionSearch(world, curve, goal, deadline, log or SearchLog.with_capacity(0)).run()


class _MotionSearch:
    """One search."""

    def __init__(self, world: World, curve: Curve, goal: SearchQuery, deadline: Deadline, log: SearchLog) -> None:
        self._log = log
        self._world, self._curve, self._goal, self._deadline = world, curve, goal, deadline
        self._in_time = goal.in_time and world.scene.moves
        robot, obstacles, movers, pairs, error = world_tables(world, in_time=self._in_time)
        self._layout = bezier_curve(curve)
        self._moving = MovingRobot(robot, obstacles, with_passing_speeds(world, curve, movers), pairs, self._layout)
        times = self._layout.times
        self._whole, self._ends = float(times[-1] - times[0]), times[[0, -1]]
        queries = [(*span, 0.0) for span in goal.spans] + [(*span, 1.0) for span in goal.spans[:1]]
        self._questions = np.full((len(queries), ANSWER), np.inf)
        self._questions[:, TIME], self._questions[:, PAIR] = np.nan, -1.0
        for row, (since, until, own) in zip(self._questions, queries, strict=True):
            row[[SINCE, UNTIL, OWN]] = self._parameter_at(since), self._parameter_at(until), own
        error += ARITHMETIC * float(np.abs(curve.pieces).max(initial=0.0))
        self._tolerance = max(TOLERANCE * world.group.size, 4.0 * error)
        self._verdict = np.zeros(VERDICT)
        margin = 0.0 if goal.min_clearance is None else goal.min_clearance
        self._verdict[[KINDS, MARGIN, ERROR, END]] = goal.kinds, margin, error, np.inf
        self._verdict[STAND_OFF] = with_coal_error(margin) - margin
        self._verdict[RESOLUTION] = -1.0 if goal.min_clearance is None else goal.resolution * world.group.size

    def run(self) -> SearchResult:
        samples = self._goal.samples
        parameters = np.array([self._parameter_at(time) for time in samples.tolist()]) if len(samples) else self._ends
        knots = self._layout.times if self._curve.tube is not None and self._curve.jumps else self._ends
        count = len(knots) - 1 if self._whole > 0.0 else 0
        distances, waiting = np.empty(len(parameters)), np.zeros((len(knots) + 3 * DEEPEST, INTERVAL))
        waiting[:count, BEGINS], waiting[:count, ENDS] = knots[-2::-1][:count], knots[:0:-1][:count]
        low, high = self._curve.box
        is_short = float((high - low).max(initial=0.0)) <= SHORT_MOTION
        longest = self._whole if is_short else COARSE_SHARE * self._whole
        looked = parameters
        while True:
            is_late = self._deadline.expired()
            if is_late and self._goal.min_clearance is not None:
                self._end_verdict(waiting, count, has_begun=not len(looked))
            shortest = STOPPED_SHARE * self._whole if is_late else 0.0
            count = prove_along(
                self._moving, self._tolerance, looked, OWN_SAMPLE_STRIDE, SEGMENTS_AT_ONCE, longest, shortest,
                self._questions, self._verdict, waiting, count, distances, *self._log,
            )  # fmt: skip
            if count <= 0:
                break
            looked = parameters[:0]
        for row in self._questions:
            row[BOUND] = min(row[BOUND], row[DISTANCE] - self._tolerance)
        answers = [self._as_smallest(row) for row in self._questions]
        own = answers.pop() if answers else Smallest()
        return SearchResult(self._name_verdict(), answers, own, distances if len(samples) else distances[:0])

    def _end_verdict(self, waiting: np.ndarray, count: int, *, has_begun: bool) -> None:
        """End the verdict where the first segment begins for which it isn't known, once time is up.

        If the search has begun, at first `LAST_SEGMENTS` more are examined for the verdict alone.
        """
        if has_begun and len(self._questions) and self._verdict[RESOLUTION] >= 0.0:
            waiting, none = waiting.copy(), np.empty((0, ANSWER))
            count = prove_along(
                self._moving, self._tolerance, self._ends[:0], OWN_SAMPLE_STRIDE, LAST_SEGMENTS, self._whole, 0.0, none,
                self._verdict, waiting, count, np.empty(0), *self._log,
            )  # fmt: skip
        begin = float(waiting[:count, BEGINS].min(initial=self._verdict[END]))
        if count > 0 and begin < self._verdict[END]:
            self._stopped = True
            self._verdict[END] = begin
        self._verdict[RESOLUTION] = -1.0

    _stopped = False

    def _parameter_at(self, time: float) -> float:
        layout = self._layout
        return time if layout.times is layout.clock else float(np.interp(time, layout.clock, layout.times))

    def _time_at(self, parameter: float) -> float:
        layout = self._layout
        return parameter if layout.times is layout.clock else float(np.interp(parameter, layout.times, layout.clock))

    def _as_smallest(self, row: np.ndarray) -> Smallest:
        pair = int(row[PAIR])
        pair = index_of_pair(self._world, pair) if pair >= 0 else -1
        return Smallest(float(row[DISTANCE]), float(row[BOUND]), self._time_at(float(row[TIME])), pair, self._tolerance)

    def _find_piece(self, parameter: float) -> tuple[int, float]:
        pieces, shares = find_pieces(self._layout.times, np.array([parameter]))
        return int(pieces[0]), float(shares[0])

    def _name_verdict(self) -> Verdict:
        verdict, segments = self._verdict, int(self._verdict[SEGMENTS]) + 2
        if self._stopped:
            at = self._find_piece(float(verdict[END]))
            z = self._curve.point(*at)
            return Verdict(Reason.STOPPED, segments, *at, at, None, z)
        if verdict[REASON] == FREE:
            return Verdict(Reason.FREE, segments)
        pair, parameter = int(verdict[CULPRIT]), float(verdict[PLACE])
        index = -1 if pair < 0 else index_of_pair(self._world, pair)
        reason = _REASONS.get(int(verdict[REASON]), Reason.UNDECIDED)
        if reason is Reason.UNDECIDED and index >= 0:
            reason, parameter = self._look_ahead(index, parameter)
        elif index >= 0:
            reason = self._confirm(reason, index, parameter)
        at = self._find_piece(parameter)
        names = None if index < 0 else self._world.pair_names(index)
        return Verdict(reason, segments, *at, self._find_piece(float(verdict[END])), names, self._curve.point(*at))

    def _confirm(self, reason: Reason, pair: int, parameter: float) -> Reason:
        found = self._ask_coal(pair, parameter)
        if found is None:
            kept = self._distance_to_keep(pair)
            names = self._world.pair_names(pair)
            raise ContradictionError(
                f"the search has {names[0]} and {names[1]} within {1000 * kept:.6g} mm at"
                f" {self._time_at(parameter):.6g} of the motion, and Coal hasn't",
                (self._world, self._curve, float(self._verdict[MARGIN])),
            )
        return found if found is not Reason.UNDECIDED else reason

    def _distance_to_keep(self, pair: int) -> float:
        return 0.0 if pair < self._world.pairs.n_self else float(self._verdict[MARGIN])

    def _ask_coal(self, pair: int, parameter: float) -> Reason | None:
        """Ask Coal about a pair: contact, too close, UNDECIDED within its accuracy, None if it is farther apart."""
        world, kept = self._world, self._distance_to_keep(pair)
        self._place_pair(pair, parameter)
        if world.touches(pair):
            return Reason.CONTACT
        if kept > 0.0 and world.penetration(pair, kept) is not None:
            return Reason.TOO_CLOSE
        allowed = with_coal_error(kept) + float(self._verdict[ERROR])
        return None if world.penetration(pair, allowed) is None else Reason.UNDECIDED

    def _place_pair(self, pair: int, parameter: float) -> None:
        world = self._world
        world.place(world.group.expand_from_local(self._curve.point(*self._find_piece(parameter))))
        if self._in_time:
            put_obstacle(world, pair, self._time_at(parameter))

    def _look_ahead(self, pair: int, parameter: float) -> tuple[Reason, float]:
        """Search for a contact shortly after an undecided place; return reason and parameter."""
        begin, last = float(self._verdict[END]), float(self._ends[1])
        step = max(parameter - begin, 1e-12 * self._whole)
        for doubling in range(LOOKAHEAD_PLACES + 1):
            ahead = parameter if doubling == 0 else min(parameter + 2.0 ** (doubling - 1) * step, last)
            found = self._ask_coal(pair, ahead)
            if found in (Reason.CONTACT, Reason.TOO_CLOSE):
                return found, ahead
        return Reason.UNDECIDED, parameter
