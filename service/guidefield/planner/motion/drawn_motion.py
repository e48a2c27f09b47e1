"""The curve that a controller draws through the rows, or between the commands, that it is sent of a motion.

Rows are the motion's own knots and places evenly between them, so that a cubic or quintic of a cubic piece is that very
piece: only where the acceleration jumps, at a knot, a quintic draws another curve, with the mean of both accelerations
there. ros2_control's JointTrajectoryController draws straight pieces through positions, cubic ones through positions
and velocities, and quintic ones through accelerations too.

Commands are at the ticks of a clock, the last one at the goal. A zero-order hold steps to the next at each tick: from
one tick to the next each joint is anywhere between the command of the tick before and that of this one, on its own.

This curve is what is certified for an execution, so it has to be the controller's; `SPANS_AT_ONCE` is memory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.errors import MalformedRequest
from guidefield.messages.execution import MOST_SENT_ROWS
from guidefield.planner.motion.submitted_motion import CurveKind, StraightMotion, SubmittedMotion
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.task.problem import ROUNDING, ControllerModel, Interpolation
from guidefield.prove.curve import find_pieces, largest_magnitudes, restrict_curves
from guidefield.read_only import ReadOnly
from guidefield.robot.model.joints import LocalPoints, LocalRates

SPANS_AT_ONCE = 20_000  # spans between knots measured together: some 10 MB of control points


@dataclass(frozen=True, eq=False)
class DrawnMotion(ReadOnly):
    """The rows or commands that a controller is sent of a motion, and the curve that it draws."""

    times: np.ndarray  # of rows or commands, shape (n,), strictly increasing [s]
    positions: LocalPoints  # shape (n, nv) [rad or m]
    velocities: LocalRates | None  # shape (n, nv) [rad/s or m/s]; None where they aren't read
    accelerations: LocalRates | None  # shape (n, nv) [rad/s² or m/s²]; None where they aren't read
    motion: SubmittedMotion  # what is drawn, with the tube about it
    parts: int = 1  # into which the span between two rows is divided


@dataclass(frozen=True, eq=False)
class Deviations(ReadOnly):
    """The largest deviation of a motion from another at the same times, by coordinate, shape (nv,)."""

    values: np.ndarray  # [rad or m]
    times: np.ndarray  # when [s]


def draw(
    planned: Trajectory | StraightMotion,
    rows: np.ndarray,
    execution: ControllerModel,
    parts: int = 1,
    accelerations: LocalRates | None = None,
) -> DrawnMotion:
    """Draw a motion as a controller does.

    Args:
        planned: The motion, with velocities where the interpolation reads them.
        rows: Numbers of its knots, shape (n,), by which places along what is drawn are named.
        parts: Into how many even parts the span between two rows is divided on; of ticks 1.
        accelerations: At its knots, shape (n, nv) [rad/s² or m/s²]; None: those of the motion.

    Raises:
        MalformedRequest: if there are more than `MOST_SENT_ROWS`.
    """
    if (count := execution.count_rows(planned.times, parts)) > MOST_SENT_ROWS:
        rate = "" if execution.rate is None else f" at {execution.rate:g} Hz"
        raise MalformedRequest(
            f"`execution` makes {count:.6g} rows of {planned.duration:.6g} s{rate}; at most {MOST_SENT_ROWS} are sent",
            path="$.execution",
        )
    kind, tolerance = execution.interpolation, execution.tube
    if kind.holds:
        times, commands = _commands(planned, execution)
        if kind is Interpolation.ZERO_ORDER_HOLD:
            after = np.append(times, times[-1] + 1.0 / _rate_of(execution))
            reached = cast(LocalPoints, np.concatenate([commands[:1], commands]))
            drawn = SubmittedMotion(
                CurveKind.STEPS, reached, np.interp(after, planned.times, rows), after, tolerance=tolerance
            )
        else:
            row_numbers = np.interp(times, planned.times, rows)
            drawn = SubmittedMotion(CurveKind.LINEAR, commands, row_numbers, times, tolerance=tolerance)
        return DrawnMotion(times, commands, None, None, drawn)
    times = _row_times(planned.times, execution, parts)
    row_numbers = np.interp(times, planned.times, rows)
    if kind is Interpolation.LINEAR or isinstance(planned, StraightMotion):
        positions = planned.evaluate(times)[0]
        positions[-1] = planned.positions[-1]
        drawn = SubmittedMotion(CurveKind.LINEAR, positions, row_numbers, times, tolerance=tolerance)
        return DrawnMotion(times, positions, None, None, drawn, parts)
    positions, velocities, rises = _states(planned, times, accelerations)
    if kind is Interpolation.CUBIC:
        drawn = SubmittedMotion(CurveKind.HERMITE, positions, row_numbers, times, velocities, tolerance=tolerance)
        return DrawnMotion(times, positions, velocities, None, drawn, parts)
    drawn = SubmittedMotion(CurveKind.QUINTIC, positions, row_numbers, times, velocities, rises, tolerance)
    return DrawnMotion(times, positions, velocities, rises, drawn, parts)


def draw_plan(planned: Trajectory, execution: ControllerModel, parts: int) -> DrawnMotion:
    """Draw a plan's motion as a controller does; see `draw`."""
    return draw(planned, np.arange(len(planned.times)), execution, parts)


def _rate_of(execution: ControllerModel) -> float:
    assert execution.rate is not None, "ticks have a rate"
    return execution.rate


def _commands(planned: Trajectory | StraightMotion, execution: ControllerModel) -> tuple[np.ndarray, LocalPoints]:
    """Ticks from the motion's begin on, and where it is then; the last one is not before its end, and at its goal."""
    rate, begin = _rate_of(execution), float(planned.times[0])
    count = max(1, math.ceil(planned.duration * rate * (1.0 - ROUNDING)))
    times = begin + np.arange(count + 1) / rate
    positions = planned.evaluate(np.minimum(times, planned.times[-1]))[0]
    positions[0], positions[-1] = planned.positions[0], planned.positions[-1]
    return times, positions


def _row_times(knots: np.ndarray, execution: ControllerModel, parts: int) -> np.ndarray:
    spans = np.diff(knots)
    if not len(spans):
        return knots
    counts = np.ones(len(spans), np.int64)
    if execution.rate is not None:
        counts = np.maximum(np.ceil(spans * execution.rate * (1.0 - ROUNDING)).astype(np.int64), 1)
    counts *= parts
    piece = np.repeat(np.arange(len(spans)), counts)
    within = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    times = knots[piece] + within * (spans / counts)[piece]
    times[within == 0] = knots[:-1]
    return np.append(times, knots[-1])


def _states(
    planned: Trajectory, times: np.ndarray, accelerations: LocalRates | None
) -> tuple[LocalPoints, LocalRates, LocalRates]:
    """States at times (n,), the knots among them: unchanged there, else with the mean acceleration."""
    q, v, a = planned.evaluate(times)
    at = np.searchsorted(times, planned.times)
    q[at], v[at] = planned.positions, planned.velocities
    a[at] = planned.mean_accelerations if accelerations is None else accelerations
    return q, v, a


def deviations(planned: Trajectory | StraightMotion, drawn: SubmittedMotion) -> Deviations:
    """Measure the deviation of the drawn curve from the planned motion at the same times, exactly, without tolerance.

    The planned motion stands before its begin and after its end; so does the other one.
    """
    times = drawn.scheduled.piece_times()
    knots = np.unique(np.concatenate([planned.piece_times(), times]))
    if len(knots) < 2:
        apart = np.abs(planned.positions[0] - drawn.positions[0])
        return Deviations(apart, np.repeat(planned.times[:1], len(apart)))
    parts = [
        _deviations_at(planned, drawn, knots[k : k + SPANS_AT_ONCE + 1])
        for k in range(0, len(knots) - 1, SPANS_AT_ONCE)
    ]
    values, moments = (np.array(each) for each in zip(*parts, strict=True))
    largest, columns = np.argmax(values, axis=0), np.arange(values.shape[1])
    return Deviations(values[largest, columns], moments[largest, columns])


def _deviations_at(
    planned: Trajectory | StraightMotion, drawn: SubmittedMotion, knots: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The largest deviation of each coordinate between some of all knots (n,) of both motions, and when, (nv,) each."""
    times = drawn.scheduled.piece_times()
    mine, own = _between(planned.bezier(), planned.piece_times(), knots), _between(drawn.pieces, times, knots)
    order = max(mine.shape[1], own.shape[1])
    apart = _elevate_degree(mine, order) - _elevate_degree(own, order)
    beside = None
    if drawn.kind is CurveKind.STEPS:
        at = find_pieces(times, 0.5 * (knots[1:] + knots[:-1]))[0]
        beside = 0.5 * np.abs(drawn.straight[at, 1] - drawn.straight[at, 0])
    values, piece, places = largest_magnitudes(apart, beside)
    return values, knots[piece] + places * (knots[piece + 1] - knots[piece])


def _between(pieces: np.ndarray, times: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Control points of a motion between each two of some times (n,), shape (n - 1, k, nv)."""
    piece = find_pieces(times, 0.5 * (knots[1:] + knots[:-1]))[0]
    begins, spans = times[piece], times[piece + 1] - times[piece]
    spans = np.where(spans > 0.0, spans, np.inf)
    low, high = (np.clip((some - begins) / spans, 0.0, 1.0) for some in (knots[:-1], knots[1:]))
    return restrict_curves(pieces[piece], low, high)


def _elevate_degree(curves: np.ndarray, order: int) -> np.ndarray:
    while (degree := curves.shape[1]) < order:
        share = (np.arange(1, degree) / degree)[:, None]
        inner = share * curves[:, :-1] + (1.0 - share) * curves[:, 1:]
        curves = np.concatenate([curves[:, :1], inner, curves[:, -1:]], axis=1)
    return curves
