"""Point clouds: judged as small bodies around their points, charged as the surface that they were taken from."""

from __future__ import annotations

import math

import numpy as np

from guidefield.geometry import surfaces
from guidefield.geometry.charge_cloud import cloud_rows, spacings
from guidefield.scene.charges import Charges

MOST_POINTS = 5_000
"""Larger clouds are refused: thin them out."""

CORNERS = 12
"""Vertices of the body of each point."""

_DENSEST = 0.01
"""Least spacing that a cloud's charges count with, over its radius."""

_SPHERE = math.sqrt(4.0 * math.pi)
"""Side of the square with the area of a sphere, over its radius."""


def cloud_surface(points: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Icosahedra that contain the balls around the points.

    Their vertices stand 1.26 radii from the points: a cloud is judged that much larger, never smaller.

    Args:
        points: Shape (n, 3) [m], in any frame.
        radius: Of the balls [m].

    Returns:
        Vertices in the points' frame, shape (12 n, 3) [m], and triangles, shape (20 n, 3).
    """
    ball = surfaces.sphere(1.0, subdivisions=0)
    a, b, c = ball.corners[0]
    inner = float(abs(np.cross(b - a, c - a) @ a) / np.linalg.norm(np.cross(b - a, c - a)))
    vertices = points[:, None] + (radius / inner) * ball.vertices
    triangles = CORNERS * np.arange(len(points))[:, None, None] + ball.triangles
    return vertices.reshape(-1, 3), triangles.reshape(-1, 3)


def cloud_balls(vertices: np.ndarray) -> tuple[np.ndarray, float]:
    """Balls that contain the bodies of a cloud.

    Args:
        vertices: Those of `cloud_surface`, shape (12 n, 3) [m], in any frame.

    Returns:
        Centres in that frame, shape (n, 3), and the one radius of all [m].
    """
    bodies = vertices.reshape(-1, CORNERS, 3)
    centres = bodies.mean(axis=1)
    return centres, float(np.linalg.norm(bodies - centres[:, None], axis=2).max())


def cloud_charges(points: np.ndarray, radius: float) -> Charges:
    """Every point with the area that is nearest to it on the surface, at most that of its own ball.

    Args:
        points: Shape (n, 3) [m, world].
        radius: Of the balls around them [m].
    """
    return Charges(cloud=cloud_rows(points, spacings(points, _DENSEST * radius, _SPHERE * radius)))
