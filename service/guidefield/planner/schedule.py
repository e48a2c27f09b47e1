"""The earliest schedule along a path that meets nothing that moves, and the motion that keeps it.

A schedule is found on cells of the path and slices of time (kernels/timing/path_parameterization.py), by the numbers of
`SCHEDULE` (slices.py). Its motion (`retime`) keeps the limits of rates exactly, or there is none; where the rate
changes its curve is beside the path a little, so it is certified anew. `KNOTS` changes how close it is to the schedule,
and how often it keeps limits; `ROUNDING` has to stay below `LIMIT_TOLERANCE` of prove/verdict.py, the certificate's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.deadline import Deadline
from guidefield.kernels.timing import path_parameterization as kernel
from guidefield.planner.motion.limit_load import TOLERANCE, measure_limit_load
from guidefield.planner.motion.timing import SHORTEST_PIECE
from guidefield.planner.motion.trajectory import Trajectory, bezier, piece_accelerations
from guidefield.planner.slices import SCHEDULE, Slices
from guidefield.planner.task.problem import Problem
from guidefield.prove.curve import excesses
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.joints import LocalPoint, LocalPoints, LocalRate, LocalRates

KNOTS = 8  # knots in a step: with more the rate is followed more closely, by more pieces to certify
ROUNDING = 1e-12  # a curve that is beyond a limit by no more than this keeps it [rad or m]

Knots = tuple[np.ndarray, LocalPoints, LocalRates]


class Occupancy:
    """The free cells of a path in each slice of time, computed on demand.

    Cells are of equal length by the group's metric; of a motion too short for that, of equal time.

    Args:
        leave_by: The time until which the start is certainly free [s].
        arrive_from: The time from which the end certainly stays free [s].
        free_at_rest: Whether the whole path is certified among the obstacles once they have come to rest.
    """

    def __init__(
        self,
        group: PlanningGroup,
        motion: Trajectory,
        slices: Slices,
        leave_by: float,
        arrive_from: float,
        *,
        free_at_rest: bool,
    ) -> None:
        self._times = np.linspace(motion.times[0], motion.times[-1], SCHEDULE.fine * len(motion.times) + 2)
        moves = np.linalg.norm(np.diff(motion.evaluate(self._times)[0], axis=0) / group.units, axis=1)
        travelled = np.r_[0.0, np.cumsum(moves)]
        self.count = int(np.clip(math.ceil(travelled[-1] * SCHEDULE.resolution) + 1, 3, SCHEDULE.most_cells))
        along = travelled / travelled[-1] if travelled[-1] > 0.0 else np.linspace(0.0, 1.0, len(travelled))
        self._cells = along * (self.count - 1)
        self.at = np.interp(np.arange(self.count), self._cells, self._times)
        self._zs = motion.evaluate(self.at)[0]
        self.slices, self.leave_by, self.arrive_from = slices, leave_by, arrive_from
        self.free_at_rest = free_at_rest
        self._rows = np.empty((0, self.count), np.uint8)
        self._blocks: dict[int, np.ndarray] = {}
        self._taken_out: list[tuple[int, int]] = []

    def cells(self, times: np.ndarray) -> np.ndarray:
        """The motion's cells at its own times (k,) [s], shape (k,)."""
        cells: np.ndarray = np.round(np.interp(times, self._times, self._cells)).astype(np.int64)
        return cells

    def free(self, first: int, last: int, deadline: Deadline) -> np.ndarray | None:
        """The free cells in slices from one up to another, shape (last - first, cells), uint8.

        Args:
            deadline: Checked before each slice that isn't known; there is no answer, None, if it has passed.
        """
        more: list[np.ndarray] = []
        for index in range(len(self._rows), last):
            if deadline.expired():
                break
            more.append(self._row(index))
        if more:
            self._rows = np.concatenate([self._rows, np.array(more, np.uint8)])
        return np.ascontiguousarray(self._rows[first:last]) if len(self._rows) >= last else None

    def take_out(self, time: float, along: float) -> None:
        """Exclude a place, the motion's own time [s], at a time [s]: the certificate refused it."""
        place = int(time / self.slices.length), int(self.cells(np.array([along]))[0])
        self._taken_out.append(place)
        for index in range(max(0, place[0] - 1), min(len(self._rows), place[0] + 2)):
            self._rows[index, self._about(place[1])] = 0

    def point(self, cell: int) -> np.ndarray:
        """The local coordinates (nv,) of a cell."""
        point: np.ndarray = self._zs[cell]
        return point

    def _about(self, cell: int) -> slice:
        """The cells from one before to one after; never the ends, whose times are known for certain."""
        return slice(max(1, cell - 1), min(self.count - 1, cell + 2))

    def _find_reached(self, index: int) -> int:
        """The cells that a schedule may reach in a slice: none is faster than the motion, but places are rounded."""
        time = self._times[0] + (index + 2) * self.slices.length
        return min(int(np.searchsorted(self.at, time, side="right")) + 1, self.count)

    def _near(self, block: int) -> np.ndarray:
        """Cells that aren't free all along in some slices together: others are skipped in each of them."""
        if block not in self._blocks:
            reached = self._find_reached((block + 1) * SCHEDULE.together - 1)
            touching = self.slices.touching(block, self._zs[:reached], SCHEDULE.together)
            self._blocks[block] = np.flatnonzero(touching)
        return self._blocks[block]

    def _row(self, index: int) -> np.ndarray:
        row, reached = np.zeros(self.count, np.uint8), self._find_reached(index)
        row[:reached] = 1
        if not (self.free_at_rest and index >= self.slices.resting_from):
            near = self._near(index // SCHEDULE.together)
            near = near[: np.searchsorted(near, reached)]
            if len(near):
                row[near] = ~self.slices.touching(index, self._zs[near])
        row[0] = (index + 1) * self.slices.length <= self.leave_by
        row[-1] = index * self.slices.length >= self.arrive_from
        for slice_index, cell in self._taken_out:
            if abs(slice_index - index) <= 1:
                row[self._about(cell)] = 0
        return row


@dataclass(frozen=True, eq=False)
class Schedule(ReadOnly):
    """The motion's own time as a function of time: a rate at each step."""

    motion: Trajectory
    departure: float  # until then the robot waits where it starts [s]
    duration: float  # how long it is on its way then [s]
    step: float  # length of a step [s]
    # at the beginning of each step since the departure, and at the end of the last one, shape (k + 1,)
    rates: np.ndarray

    @property
    def arrival(self) -> float:
        """Its arrival [s]."""
        return self.departure + self.duration

    @property
    def constant(self) -> bool:
        """True if its rate never changes."""
        return bool(np.all(self.rates == self.rates[0]))

    def at(self, times: np.ndarray, window: float) -> tuple[np.ndarray, np.ndarray]:
        """The motion's own times at times (k,), and the rates, averaged over a window of at most a step."""
        (before, sums_before), (after, sums_after) = (self._moments(times + side * window) for side in (-0.5, 0.5))
        return (sums_after - sums_before) / window, (after - before) / window

    def _moments(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The motion's own times and their integral since the departure; it goes on evenly before and after."""
        h, rates = self.step, self.rates
        change = np.diff(rates)
        places = np.r_[0.0, np.cumsum(h * (rates[:-1] + 0.5 * change))]
        sums = np.r_[0.0, np.cumsum(h * (places[:-1] + h * (rates[:-1] / 2.0 + change / 6.0)))]
        index = np.clip(np.floor(times / h).astype(np.int64), 0, len(change) - 1)
        t = times - index * h
        # beyond the ends no rate changes: the first and the last step are even
        share = change[index] / h
        v = rates[index]
        place = places[index] + t * (v + 0.5 * t * share)
        return place, sums[index] + t * (places[index] + t * (0.5 * v + t * share / 6.0))


@dataclass(frozen=True)
class Stuck:
    """The end of a search for a schedule that did not arrive."""

    cell: int  # the farthest that was reached
    spent: bool = False  # whether the deadline passed


def choose_step(group: PlanningGroup) -> float:
    """The duration of a step of schedules for a group [s]."""
    slowest = float((group.velocity_limits / group.acceleration_limits).max())
    wanted = SCHEDULE.braking / SCHEDULE.rates * slowest
    return float(np.clip(wanted, SCHEDULE.shortest_step, SCHEDULE.longest_step))


def count_slices(step: float) -> int:
    """The number of slices of a step."""
    return math.ceil(step / SCHEDULE.slice_length)


def schedule_at_one_rate(problem: Problem, motion: Trajectory, occupancy: Occupancy) -> Schedule | Stuck:
    """The earliest schedule that waits at the start and then goes along the path at one rate."""
    places = _places(motion, choose_step(problem.group))
    none = np.zeros((places, SCHEDULE.rates + 1), np.int64)
    return _search(problem, motion, occupancy, none, none)


def schedule_at_any_rate(
    problem: Problem, motion: Trajectory, room: float, occupancy: Occupancy, by: float = np.inf
) -> Schedule | Stuck:
    """The earliest schedule that changes its rate within the limits of acceleration and jerk.

    Args:
        room: Share of the motion's own rate that it doesn't exceed; the rest of the limits is for changes of rate.
        by: A schedule that arrives later is of no use [s].
    """
    slower = Trajectory(motion.times / room, motion.positions, motion.velocities * room)
    return _search(problem, slower, occupancy, *_changes(problem, slower), room, by)


def depart_after(motion: Trajectory, departure: float, step: float) -> Schedule:
    """The schedule that waits until a departure [s], and then goes as the motion goes; a step is so long [s]."""
    return Schedule(motion, departure, motion.duration, step, np.ones(math.ceil(motion.duration / step) + 1))


def _places(motion: Trajectory, step: float) -> int:
    return math.ceil(motion.duration / _spacing(step) * (1.0 - 1e-12))


def _spacing(step: float) -> float:
    """Between two places [s]."""
    return 0.5 * step / SCHEDULE.rates


def _changes(problem: Problem, motion: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """The least and most rates by which a schedule may change in a step, at each place at each rate.

    With the motion's own time s, its rate v and its change u the robot's acceleration is q'' v^2 + q' u, and its jerk
    q''' v^3 + 3 q'' v u + q' du/dt, where u changes within a step by no more than twice what it may be. Limits of what
    the motion does as a whole are of the same form in v^2 and u; those of speed are kept at every rate up to 1.
    """
    group, step = problem.group, choose_step(problem.group)
    at = _spacing(step) * np.arange(_places(motion, step))
    points, first, second = motion.evaluate(at)
    kept = np.broadcast_to(group.acceleration_limits, first.shape)
    curve_limits = [limit.along(points, first, second)[1:] for limit in problem.motion_limits]
    on_u, on_x, below, above = map(np.hstack, zip((first, second, kept, kept), *curve_limits, strict=True))
    rates = np.arange(SCHEDULE.rates + 1)[:, None] / SCHEDULE.rates
    unit = 1.0 / SCHEDULE.rates / step
    by_u = np.abs(on_u)[:, None] * unit
    curved = np.sign(on_u)[:, None] * on_x[:, None] * rates**2
    upper, lower = (np.where(on_u < 0.0, *sides)[:, None] for sides in ((below, above), (above, below)))
    with np.errstate(divide="ignore", invalid="ignore"):
        most = ((upper - curved) / by_u).min(axis=2, initial=SCHEDULE.changes)
        least = ((-lower - curved) / by_u).max(axis=2, initial=-SCHEDULE.changes)
        if problem.jerk_limits is not None:
            start, end = piece_accelerations(motion.times, motion.positions, motion.velocities)
            jerk = (end - start) / np.diff(motion.times)[:, None]
            third = np.abs(jerk[np.clip(np.searchsorted(motion.times, at, side="right") - 1, 0, len(jerk) - 1)])
            along = np.abs(first)[:, None] * unit
            needed = 3.0 * np.abs(second)[:, None] * rates * unit + 2.0 * along / step
            allowed = ((problem.jerk_limits - third[:, None] * rates**3) / needed).min(axis=2, initial=np.inf)
            most, least = np.minimum(most, allowed), np.maximum(least, -allowed)
    changes = [np.trunc(np.nan_to_num(one)).astype(np.int64) for one in (np.minimum(least, 0.0), np.maximum(most, 0.0))]
    for one in changes:
        one[0] = 0
    return changes[0], changes[1]


def _search(
    problem: Problem,
    motion: Trajectory,
    occupancy: Occupancy,
    lowest: np.ndarray,
    highest: np.ndarray,
    room: float = 1.0,
    by: float = np.inf,
) -> Schedule | Stuck:
    step = choose_step(problem.group)
    spacing, per_step = _spacing(step), count_slices(step)
    cells = occupancy.cells(spacing * room * np.arange(len(lowest)))
    horizon = min(max(problem.scene.end, 0.0) + SCHEDULE.slack * motion.duration + 1.0, by)
    costs = np.full((len(lowest), SCHEDULE.rates + 1), kernel.UNREACHED)
    if occupancy.leave_by <= 0.0:
        return Stuck(0)
    costs[0] = 0
    scratch, arrival, parents = np.empty_like(costs), np.array([-1, 0, 0, 0]), []
    most = min(SCHEDULE.most_steps, SCHEDULE.most_states // costs.size)
    for begin in range(0, min(math.ceil(horizon / step), most), SCHEDULE.steps_at_once):
        slices, deadline = (begin * per_step, (begin + SCHEDULE.steps_at_once) * per_step), problem.deadline
        free = None if deadline.expired() else occupancy.free(*slices, deadline)
        if free is None:
            return Stuck(int(cells[arrival[3]]), spent=True)
        parents.append(np.zeros((SCHEDULE.steps_at_once, *costs.shape), np.int8))
        kernel.earliest_schedule(
            cells,
            lowest,
            highest,
            free,
            per_step,
            motion.duration / spacing,
            occupancy.arrive_from / step,
            begin,
            costs,
            scratch,
            parents[-1],
            arrival,
        )
        if arrival[0] >= 0:
            steps, place, rate = begin + int(arrival[0]), int(arrival[1]), int(arrival[2])
            return _trace(motion, step, steps, place, rate, np.concatenate(parents))
        if not (costs < kernel.UNREACHED).any():
            break
    return Stuck(int(cells[arrival[3]]))


def _trace(motion: Trajectory, step: float, steps: int, place: int, rate: int, parents: np.ndarray) -> Schedule:
    last = (motion.duration / _spacing(step) - place) / (2.0 * rate)
    rates = [rate, rate]
    at = steps
    while place > 0:
        at -= 1
        change = int(parents[at, place, rate])
        place, rate = place - 2 * rate + change, rate - change
        rates.append(rate)
    duration = (steps - at + last) * step
    return Schedule(motion, at * step, duration, step, np.array(rates[::-1]) / SCHEDULE.rates)


def find_leaving(
    knots: np.ndarray, values: LocalPoints, slopes: LocalRates, lower: LocalPoint, upper: LocalPoint
) -> np.ndarray:
    """Find coordinates of a Hermite curve, knots (n,), values and slopes (n, c), that leave limits (c,): shape (c,)."""
    beyond, _ = excesses(bezier(knots, values, slopes), lower, upper)
    left: np.ndarray = np.any(beyond > ROUNDING, axis=0)
    return left


def clamp_smoothly(
    knots: np.ndarray, values: LocalPoints, slopes: LocalRates, lower: LocalPoint, upper: LocalPoint
) -> tuple[LocalPoints, LocalRates]:
    """A C² cubic curve as of `find_leaving` brought within limits, still C²: values and slopes (n, c), its ends kept.

    Its de Boor points are brought within, in whose hull it is. With steps h, that of knot i is b - (h_{i-1} / h_i) (c -
    b), b and c being the inner control points of the piece that begins there (Farin, Curves and Surfaces for CAGD,
    2002, chapter 8).
    """
    h, inner = np.diff(knots)[:, None], bezier(knots, values, slopes)[:, 1:3]
    before, after = np.vstack([np.zeros(1), h]), np.vstack([h, np.zeros(1)])  # steps about each knot
    points = inner[:, 0] - before[:-1] / h * (inner[:, 1] - inner[:, 0])
    points = np.clip(np.vstack([points, inner[-1:, 1]]), lower, upper)
    along = np.diff(points, axis=0) / (before[:-1] + h + after[1:])
    first, second = points[:-1] + before[:-1] * along, points[:-1] + (before[:-1] + h) * along
    kept = values.copy()
    kept[1:-1] = second[:-1] + h[:-1] / (h[:-1] + h[1:]) * (first[1:] - second[:-1])
    rates = np.vstack([(first - kept[:-1]) / h, (kept[-1:] - second[-1:]) / h[-1:]])
    return kept, 3.0 * rates


def bound_slopes(
    knots: np.ndarray, values: LocalPoints, slopes: LocalRates, lower: LocalPoint, upper: LocalPoint
) -> LocalRates:
    """Slopes (n, c) with which a cubic Hermite curve through values as of `find_leaving` keeps limits; not always C².

    The control points next to a knot, a third of a step along the slope away from its value, are brought within.
    """
    thirds = np.diff(knots)[:, None] / 3.0
    above, below = np.maximum(upper - values, 0.0), np.maximum(values - lower, 0.0)
    most, least = np.full(values.shape, np.inf), np.full(values.shape, -np.inf)
    most[:-1], least[:-1] = above[:-1] / thirds, -below[:-1] / thirds
    most[1:], least[1:] = np.minimum(most[1:], below[1:] / thirds), np.maximum(least[1:], -above[1:] / thirds)
    bounded: LocalRates = np.clip(slopes, least, most)
    return bounded


def fit_smooth_spline(times: np.ndarray, positions: LocalPoints) -> tuple[LocalPoints, LocalRates]:
    """Positions and velocities (n, nv) of the C² cubic through points at even times, at rest at both ends.

    No acceleration at an end takes away the freedom of the point next to it, which moves a little. With step h and
    v = 0 at both ends the velocities solve v_{i-1} + 4 v_i + v_{i+1} = 3 (q_{i+1} - q_{i-1}) / h; q_1 = q_0 + h v_1 / 3
    makes the acceleration at the start vanish, and the same holds at the end.
    """
    n, h = len(times), float(times[1] - times[0])
    right = 3.0 * (positions[2:] - positions[:-2]) / h
    lower, upper = np.ones(n - 2), np.ones(n - 2)
    lower[1], right[1] = 2.0, 3.0 * (positions[3] - positions[0]) / h
    upper[-2], right[-2] = 2.0, 3.0 * (positions[-1] - positions[-4]) / h
    velocities = cast(LocalRates, np.zeros_like(positions))
    velocities[1:-1] = _tridiagonal(lower, 4.0, upper, right)
    moved = positions.copy()
    moved[1] = positions[0] + h * velocities[1] / 3.0
    moved[-2] = positions[-1] - h * velocities[-2] / 3.0
    return moved, velocities


def _tridiagonal(lower: np.ndarray, diagonal: float, upper: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a diagonally dominant tridiagonal system for several right-hand sides (n, c), by Thomas' algorithm."""
    n = len(right)
    pivots, solution = np.full(n, diagonal), right.copy()
    for i in range(1, n):
        ratio = lower[i] / pivots[i - 1]
        pivots[i] -= ratio * upper[i - 1]
        solution[i] -= ratio * solution[i - 1]
    solution[-1] /= pivots[-1]
    for i in range(n - 2, -1, -1):
        solution[i] = (solution[i] - upper[i] * solution[i + 1]) / pivots[i]
    return solution


def retime(problem: Problem, schedule: Schedule) -> Trajectory | None:
    """The motion of a schedule, from time 0 on; None where its changes of rate exceed a limit.

    Where the rate never changes it is the schedule's motion later, and perhaps slower, bit for bit the same curve.
    Else the rate is averaged over a step, so that accelerations are continuous where those of the schedule's motion
    are.
    """
    motion = schedule.motion
    if schedule.constant:
        rate = float(schedule.rates[0])
        times = (motion.times - motion.times[0]) / rate
        return wait_until_begin(Trajectory(schedule.departure + times, motion.positions, motion.velocities * rate))
    knots = (
        _through_samples(problem, schedule) if problem.jerk_limits is not None else _through_knots(problem, schedule)
    )
    group = problem.group
    jerks = cast(LocalRate, np.full(group.nv, np.inf)) if problem.jerk_limits is None else problem.jerk_limits
    if measure_limit_load(*knots, group.velocity_limits, group.acceleration_limits, jerks) > 1.0 + TOLERANCE:
        return None
    times, positions, velocities = knots
    return wait_until_begin(Trajectory(schedule.departure + times, positions, velocities))


def _sample(schedule: Schedule, times: np.ndarray) -> tuple[LocalPoints, LocalRates]:
    motion = schedule.motion
    own, rates = schedule.at(times, schedule.step)
    own = np.clip(own * (motion.duration / own[-1]), 0.0, motion.duration) + motion.times[0]
    positions, velocities, _ = motion.evaluate(own)
    return positions, cast(LocalRates, velocities * rates[:, None])


def _through_knots(problem: Problem, schedule: Schedule) -> Knots:
    """The cubic Hermite curve through the motion's own knots, and where the rate begins to change or ends to."""
    motion, step = schedule.motion, schedule.step
    even = np.arange(0.0, schedule.duration, step / KNOTS)
    fine = np.linspace(0.0, schedule.duration, 4 * len(even) + 1)
    own = np.maximum.accumulate(schedule.at(fine, step)[0])
    among = np.interp(motion.times - motion.times[0], own, fine)
    times = np.unique(np.concatenate([even, among, [0.0, schedule.duration]]))
    kept = np.r_[True, np.diff(times) > SHORTEST_PIECE]
    kept[-1] = True
    times = times[kept]
    if len(times) > 2 and times[-1] - times[-2] <= SHORTEST_PIECE:
        times = np.delete(times, -2)
    positions, velocities = _sample(schedule, times)
    velocities[[0, -1]] = 0.0
    lower, upper = problem.group.lower, problem.group.upper
    changed = find_leaving(times, positions, velocities, lower, upper)
    if changed.any():
        velocities[:, changed] = bound_slopes(
            times, positions[:, changed], velocities[:, changed], lower[changed], upper[changed]
        )
    return times, positions, velocities


def _through_samples(problem: Problem, schedule: Schedule) -> Knots:
    """The cubic spline through even samples that is twice continuously differentiable, at rest at both ends."""
    count = max(8, math.ceil(KNOTS * schedule.duration / schedule.step))
    times = np.linspace(0.0, schedule.duration, count + 1)
    positions, velocities = fit_smooth_spline(times, _sample(schedule, times)[0])
    lower, upper = problem.group.lower, problem.group.upper
    changed = find_leaving(times, positions, velocities, lower, upper)
    if changed.any():
        positions[:, changed], velocities[:, changed] = clamp_smoothly(
            times, positions[:, changed], velocities[:, changed], lower[changed], upper[changed]
        )
    return times, positions, velocities


def wait_until_begin(motion: Trajectory) -> Trajectory:
    """The motion from time 0 on: until its own begins the robot waits at its start."""
    if motion.times[0] <= 0.0:
        return motion
    still = np.zeros_like(motion.velocities[:1])
    return Trajectory(
        np.concatenate([[0.0], motion.times]),
        cast(LocalPoints, np.concatenate([motion.positions[:1], motion.positions])),
        cast(LocalRates, np.concatenate([still, motion.velocities])),
    )
