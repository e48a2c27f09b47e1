"""The curves of a recording: clearance, potential, joints, and how close they come to their limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.memo import memoized_by_value
from guidefield.messages.replies import Trajectory
from guidefield.planner.quality import ClearanceProfile
from guidefield.planner.task.trace import Step, evenly
from guidefield.recorder.chunks import STEP, Color, path_times, rgba, still, timed
from guidefield.recorder.motion import Curves, Motion, curves, position_rows
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.spaces import Configurations

CLEAR = 0.10
"""Distance [m] from which the segment to the closest obstacle is drawn in plain green."""
PLOTTED = 600
"""Numbers in a plot of all joints, about."""
LEAST_PLOTTED = 40
"""Rows in such a plot, if there are as many."""
OBSTACLE_COLOR = (94, 184, 255, 255)
SELF_COLOR = (190, 160, 250, 255)
REQUIRED_COLOR = (235, 87, 87, 255)
POTENTIAL_COLOR = (255, 176, 84, 255)
LIMIT_COLOR = (150, 150, 150, 255)


def clearance(profile: ClearanceProfile, required: float) -> Iterator[Chunk]:
    """Distance to obstacles and to the robot itself over the motion, and what was asked for [m]; the potential [m]."""
    times = path_times(profile.times)
    names, colors = ["to obstacles", "to itself"], [OBSTACLE_COLOR, SELF_COLOR]
    rows = [profile.obstacle_distance, profile.self_distance]
    if required > 0.0:
        names, colors = [*names, "asked for"], [*colors, REQUIRED_COLOR]
        rows.append(np.full(len(profile.times), required))
    yield from _curves("/plots/clearance", times, np.column_stack(rows), names, colors)
    moments, values = profile.potential
    yield from _curves("/plots/potential", path_times(moments), values, ["U, along the motion"], [POTENTIAL_COLOR])


def closest_pair(profile: ClearanceProfile, size: float) -> Chunk:
    """The segment between the robot and the obstacle closest to it, over the motion: red where it is short."""
    there = np.array([pair is not None for pair in profile.obstacle_pair])
    there &= np.isfinite(profile.witness).all(axis=(1, 2)) & np.isfinite(profile.obstacle_distance)
    labels = [
        f"{1e3 * distance:.0f} mm  {pair[0]} - {pair[1]}"
        for distance, pair, shown in zip(profile.obstacle_distance, profile.obstacle_pair, there, strict=True)
        if shown and pair is not None
    ]
    columns = rr.LineStrips3D.columns(
        strips=profile.witness[there],
        colors=[_warmth(distance) for distance in profile.obstacle_distance[there]],
        labels=labels,
        radii=np.full(int(there.sum()), 0.003 * size),
    )
    return timed("/path/closest_pair", [path_times(profile.times)], columns.partition(there.astype(int)))


def joints(group: PlanningGroup, motion: Motion, trajectory: Trajectory | None) -> Iterator[Chunk]:
    """Joint positions, velocities and accelerations, as they are and as shares of their limits: -1 lower, 1 upper."""
    names, rates = group.position_names, group.velocity_names
    if trajectory is None or not trajectory.times:
        rows = position_rows(group, motion.configurations)
        yield from _curves("/plots/position", path_times(motion.times), rows, names, palette(len(names)))
        return
    curve = thinned(curves(group, trajectory), PLOTTED // len(names))
    times = path_times(curve.times)
    yield from _curves("/plots/position", times, curve.positions, names, palette(len(names)))
    shares = {}
    if group.is_euclidean and np.isfinite(group.upper - group.lower).any():
        with np.errstate(invalid="ignore"):  # joints without limits have no share of them
            shares["position"] = (2.0 * curve.positions - group.lower - group.upper) / (group.upper - group.lower)
    for kind, values, limits in (
        ("velocity", curve.velocities, group.velocity_limits),
        ("acceleration", curve.accelerations, group.acceleration_limits),
    ):
        yield from _curves(f"/plots/{kind}", times, values, rates, palette(len(rates)))
        shares[kind] = values / limits
    for kind, share in shares.items():
        bounded = np.column_stack([share, np.tile([-1.0, 1.0], (len(share), 1))])
        colors = [*palette(len(rates)), LIMIT_COLOR, LIMIT_COLOR]
        yield from _curves(f"/plots/use/{kind}", times, bounded, [*rates, "lower limit", "upper limit"], colors)


def thinned(curve: Curves, most: int) -> Curves:
    """Every so manieth row of curves, their first and last among them, so that there are at most so many."""
    rows = evenly(len(curve.times), max(most, LEAST_PLOTTED))
    return Curves(curve.times[rows], curve.positions[rows], curve.velocities[rows], curve.accelerations[rows])


def step_positions(group: PlanningGroup, configurations: Configurations, numbers: np.ndarray) -> Chunk:
    """`/plots/position` over `STEP`: configurations (n, nq) after steps of the planner of these numbers (n,)."""
    times = rr.TimeColumn(STEP, sequence=numbers)
    return timed("/plots/position", [times], _rows(position_rows(group, configurations)))


def step_potential(steps: Sequence[tuple[int, Step]]) -> Iterator[Chunk]:
    """Potential of the robot after each of the planner's steps, where it was evaluated."""
    known = [(number, step.potential) for number, step in steps if step.potential is not None]
    if known:
        numbers, values = zip(*known, strict=True)
        times = rr.TimeColumn(STEP, sequence=numbers)
        yield from _curves("/planner/potential", times, np.array(values), ["U, after the step"], [POTENTIAL_COLOR])


def palette(count: int) -> list[Color]:
    """Colours (RGBA) that can be told apart as thin lines on a dark ground."""
    colors: list[Color] = []
    for number in range(count):
        hue, lightness = (0.56 + number / count) % 1.0, 0.66 if number % 2 else 0.60
        colors.append(rgba(hue, lightness, 0.75))
    return colors


def _curves(
    path: str, times: rr.TimeColumn, values: np.ndarray, names: Sequence[str], colors: Sequence[Color]
) -> Iterator[Chunk]:
    """Values (n,) or (n, k) over n times, with the names of the k curves; what isn't finite is left open."""
    rows = np.asarray(values, float).reshape(len(values), -1)
    rows = np.where(np.isfinite(rows), rows, np.nan)
    yield _lines(path, tuple(names), tuple(colors))
    yield timed(path, [times], _rows(rows))


@memoized_by_value(256)
def _lines(path: str, names: tuple[str, ...], colors: tuple[Color, ...]) -> Chunk:
    """Names and colours of curves: those of the same joints are in many recordings."""
    return still(path, rr.SeriesLines(names=names, colors=colors))


def _rows(rows: np.ndarray) -> Any:
    """Columns of one batch of k values per row, for rows (n, k)."""
    return rr.Scalars.columns(scalars=rows.ravel()).partition([rows.shape[1]] * len(rows))


def _warmth(distance: float) -> Color:
    """Green from `CLEAR` on, over amber to red at contact."""
    return rgba(0.36 * float(np.clip(distance / CLEAR, 0.0, 1.0)), 0.68, 0.9)
