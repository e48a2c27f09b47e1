"""Areas, volumes and closedness of triangulated surfaces, straight from their definitions."""

from collections import Counter

import numpy as np

from guidefield.geometry.surfaces import Surface


def areas(surface: Surface) -> np.ndarray:
    """Area of every triangle."""
    a, b, c = surface.corners.transpose(1, 0, 2)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def volume(surface: Surface) -> float:
    """Enclosed volume, positive if the triangles are counter-clockwise from outside."""
    corners = surface.corners - surface.vertices.mean(axis=0)
    return float(np.linalg.det(corners).sum() / 6.0)


def is_closed(surface: Surface) -> bool:
    """Whether every edge is used once in each direction."""
    a, b, c = surface.triangles.T
    edges = Counter([*zip(a, b, strict=True), *zip(b, c, strict=True), *zip(c, a, strict=True)])
    return all(count == 1 and edges[end, start] == 1 for (start, end), count in list(edges.items()))
