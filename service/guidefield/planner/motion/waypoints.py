"""The waypoints of a path: its length, its straight pieces, its repetitions, and places along it.

Curves and timing (`timing.py`) need pieces of some length, so `REPEATED` has to be above 0. A goal within it of the
start counts as reached, so it has to be less than goals may be missed by; else first and last waypoint stay bit for
bit.
"""

from __future__ import annotations

from typing import cast

import numpy as np

from guidefield.robot.model.spaces import ChartCurves, ChartPoints

# a waypoint at most this far from the one before is the same [rad or m]: a nanometre at a metre's reach
REPEATED = 1e-9


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

    What is within `REPEATED` of the one before repeats it.
    """
    if len(path) > 1 and lengths_of(path).min() > REPEATED:
        return path
    kept = [path[0]]
    for waypoint in path[1:-1]:
        if np.linalg.norm(waypoint - kept[-1]) > REPEATED:
            kept.append(waypoint)
    goal = path[-1]
    while len(kept) > 1 and np.linalg.norm(goal - kept[-1]) <= REPEATED:
        kept.pop()
    if np.linalg.norm(goal - kept[-1]) > REPEATED:
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
