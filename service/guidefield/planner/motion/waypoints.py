"""Waypoints of a path spread evenly along it, some of them kept where they are."""

from __future__ import annotations

import numpy as np

from guidefield.robot.model.spaces import ChartCurves, ChartPoints


def length_of(path: ChartPoints, units: np.ndarray | float = 1.0) -> float:
    """Length of a path of chart points (n, nv), by a group's metric where its units (nv,) are given [rad or m]."""
    along = (path[1:] - path[:-1]) / units
    return float(np.sqrt(np.einsum("ij,ij->i", along, along)).sum())


def cut(path: ChartPoints, chosen: np.ndarray, longest: float) -> tuple[ChartPoints, np.ndarray]:
    """A path with some of its segments cut evenly into pieces.

    Args:
        path: Chart points, shape (n, nv).
        chosen: Which segments are cut, shape (n - 1,).
        longest: Length of a piece at most [rad or m].

    Returns:
        Chart points (k, nv), those of the path bit for bit; where these are among them, shape (n,).
    """
    along = np.diff(path, axis=0)
    pieces = np.where(chosen, np.maximum(1, np.ceil(np.linalg.norm(along, axis=1) / longest)), 1).astype(int)
    indices = np.r_[0, np.cumsum(pieces)]
    of = np.repeat(np.arange(len(along)), pieces)
    shares = (np.arange(indices[-1]) - indices[of]) / pieces[of]
    return np.vstack([path[of] + shares[:, None] * along[of], path[-1:]]), indices


def respaced(path: ChartPoints, kept: np.ndarray, segments: int) -> tuple[ChartPoints, np.ndarray]:
    """A path cut into segments of about equal length.

    Each stretch between two kept waypoints is cut evenly, into at least one segment.

    Args:
        path: Chart points, shape (n, nv), n >= 2 [rad or m].
        kept: Indices of waypoints that stay, ascending, the first and the last among them, shape (m,).
        segments: About how many segments there are to be.

    Returns:
        Chart points, shape (k, nv), the kept ones bit for bit what they were; their indices, shape (m,).
    """
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    at = lengths[kept]
    shares = np.diff(at) / max(lengths[-1], 1e-300)
    counts = np.maximum(1, np.round(shares * segments)).astype(int)
    indices = np.r_[0, np.cumsum(counts)]
    places = np.concatenate(
        [np.linspace(start, end, count, endpoint=False) for start, end, count in zip(at, at[1:], counts, strict=False)]
        + [at[-1:]]
    )
    points = np.column_stack([np.interp(places, lengths, column) for column in path.T])
    points[indices] = path[kept]
    return points, indices


def polyline(path: ChartPoints) -> ChartCurves:
    """Straight pieces between chart points, shape (n, nv), as Bezier control points, shape (n - 1, 2, nv).

    A single point is one piece.
    """
    if len(path) == 1:
        return np.repeat(path[None], 2, axis=1)
    return np.stack([path[:-1], path[1:]], axis=1)
