"""What is seen of a large surface from a ball: the triangles that are nearest to some place in it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.geometry.cache import is_large
from guidefield.geometry.distance_bodies import NO_TRIANGLES, Triangulated, are_wide
from guidefield.kernels.cover.nearest_somewhere import nearest_somewhere


class SeenSurface(NamedTuple):
    """A part of a surface.

    Attributes:
        parts: What is seen of each of its solids, or of the thin surface, with what these triangles are neighbours of.
        whole: All of it, vertices (v, 3) [m] and triangles (t, 3).
        box: Lower and upper corner about all of it, shape (2, 3) [m].
        triangles: All that is seen, shape (s, 3).
    """

    parts: tuple[Triangulated, ...]
    whole: tuple[np.ndarray, np.ndarray]
    box: np.ndarray
    triangles: np.ndarray


def seen_surface(
    vertices: np.ndarray, triangles: np.ndarray, solids: list[np.ndarray], centre: np.ndarray, radius: float
) -> SeenSurface:
    """Find what is seen: from everywhere in the ball each solid is as far as its seen part. Small ones are seen whole.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
        solids: The triangles of each solid, or all of them.
        centre: Of the ball, shape (3,) [m].
        radius: Of the ball [m].
    """
    parts = [_seen_part(vertices, solid, centre, radius) for solid in solids]
    box = np.array([vertices.min(axis=0), vertices.max(axis=0)])
    return SeenSurface(tuple(parts), (vertices, triangles), box, np.concatenate([part[1] for part in parts]))


def _seen_part(vertices: np.ndarray, triangles: np.ndarray, centre: np.ndarray, radius: float) -> Triangulated:
    wide = are_wide(vertices, triangles)  # what has no area counts for Coal alone, and hides nothing
    chosen = np.ones(len(triangles), bool)
    if is_large(int(wide.sum())):
        chosen[wide] = seen_of(vertices, triangles[wide], centre, radius)
    if chosen.all():
        return vertices, triangles, NO_TRIANGLES
    marked = np.zeros(len(vertices), bool)
    marked[triangles[chosen]] = True
    a, b, c = triangles.T
    beside = (marked[a] | marked[b] | marked[c]) & ~chosen
    return vertices, triangles[chosen], triangles[beside]


def seen_of(vertices: np.ndarray, corners: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Which parts of a surface or cloud are seen, shape (n,); see `nearest_somewhere`."""
    chosen = np.empty(len(corners), bool)
    vertices, corners = np.ascontiguousarray(vertices, float), np.ascontiguousarray(corners, np.int64)
    nearest_somewhere(vertices, corners, np.ascontiguousarray(centre, float), radius, chosen)
    return chosen
