"""The waypoints of a path: its length, its straight pieces, and places along them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.robot.model.spaces import ChartCurves, ChartPoints


@dataclass(frozen=True)
class CurveSettings:
    """Of the curve along a path."""

    # of its control points, at most [rad or m]. On 100 public problems of four robots, nothing optimised: with 0.18
    # motions take 1 to 4 % longer; with 0.5 they take 1 to 4 % less, and one in six more is refused at first, whose
    # certificates take longer
    spacing: float = 0.3
    # a waypoint at most this far from the one before is the same [rad or m]: a nanometre at a metre's reach
    repeated: float = 1e-9


CURVE = CurveSettings()


@dataclass(frozen=True)
class TimingSettings:
    """Of the fastest motion along a curve."""

    # of the curve's length against its own parameter, for the steps of the grid. With 0 motions along a line of uneven
    # places take up to 15 % longer; with 300 those that turn back up to 10 %
    length_weight: float = 300.0
    # of the grid, on each piece of the curve: with 6 motions round many corners take 2 % longer, with 24 they take 1 %
    # less and their timing twice as long ..
    steps_a_piece: int = 10
    least_steps: int = 64  # .. and at least so many in all of it. Unrecorded
    # of the motion: the most of them; where jerk is limited, the number with which it is the shortest. With at most 96
    # motions take 1 % less; with 12 as well those within 50 rad/s³ take 5 % less, but are farther from the path
    pieces: tuple[int, ...] = (16, 24, 32, 48, 64)
    # no controller follows shorter ones, and their accelerations, second differences of positions, would be a matter of
    # rounding [s]
    shortest_piece: float = 2e-4


TIMING = TimingSettings()


def length_of(path: ChartPoints, units: np.ndarray | float = 1.0) -> float:
    """Length of a path of chart points (n, nv), by a group's metric where its units (nv,) are given [rad or m]."""
    along = (path[1:] - path[:-1]) / units
    return float(np.sqrt(np.einsum("ij,ij->i", along, along)).sum())


def lengths_of(path: ChartPoints) -> np.ndarray:
    """Lengths of the straight pieces of a path of chart points (n, nv), shape (n - 1,) [rad or m]."""
    along = path[1:] - path[:-1]
    lengths: np.ndarray = np.sqrt((along * along).sum(axis=1))
    return lengths


def polyline(path: ChartPoints) -> ChartCurves:
    """Straight pieces between chart points, shape (n, nv), as Bezier control points, shape (n - 1, 2, nv).

    A single point is one piece.
    """
    if len(path) == 1:
        return np.repeat(path[None], 2, axis=1)
    return np.stack([path[:-1], path[1:]], axis=1)


def remove_repetitions(path: ChartPoints) -> ChartPoints:
    """The waypoints (n, nv) of a path without repetitions, first and last kept; a single one if they are all the same.

    What is within `CURVE.repeated` of the one before repeats it.
    """
    if len(path) > 1 and lengths_of(path).min() > CURVE.repeated:
        return path
    kept = [path[0]]
    for waypoint in path[1:-1]:
        if np.linalg.norm(waypoint - kept[-1]) > CURVE.repeated:
            kept.append(waypoint)
    goal = path[-1]
    while len(kept) > 1 and np.linalg.norm(goal - kept[-1]) <= CURVE.repeated:
        kept.pop()
    if np.linalg.norm(goal - kept[-1]) > CURVE.repeated:
        kept.append(goal)
    return cast(ChartPoints, np.array(kept))


def subdivide(path: ChartPoints, spacing: float, sizes: np.ndarray | float = 1.0) -> ChartPoints:
    """Places along a path (n, nv), its waypoints among them, evenly on each straight piece and at most so far apart.

    There are three at least. Coordinates count by their sizes (nv,), where these are given.
    """
    lengths = lengths_of(cast(ChartPoints, path / sizes))
    parts = np.maximum(np.ceil(lengths / spacing).astype(np.int64), 2 if len(path) == 2 else 1)
    piece = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(piece)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[piece]
    inner = path[piece] + share[:, None] * (path[piece + 1] - path[piece])
    return cast(ChartPoints, np.concatenate([inner, path[-1:]]))
