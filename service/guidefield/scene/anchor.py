"""A place from which the sides of a solid are told to what stays in a ball, see `kernels.distance.ray_winding`."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.surface_rows import are_wide
from guidefield.kernels.cover.anchors import distance_to_triangles
from guidefield.kernels.cover.winding import winding_by_angles
from guidefield.kernels.distance.ray_winding import ANCHOR, BALL, PLACE, REACH, ROOM, TURNS

_GOOD = 0.05
"""The ball's centre serves if so large a share of its radius about it is free. Unrecorded."""

_WHOLE = 0.01
"""How far a winding number may be from a whole one."""


def anchor_of(vertices: np.ndarray, triangles: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """The anchor of a solid: the ball's centre, or of some places around that where most is free.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Those of the solid, shape (t, 3).
        centre: Of the ball, shape (3,) [m].
        radius: Of the ball [m].

    Returns:
        Shape (ANCHOR,); with no room where nothing is known.
    """
    wide = triangles[are_wide(vertices, triangles)]
    surface, row = (np.ascontiguousarray(vertices, float), np.ascontiguousarray(wide, np.int64)), np.zeros(ANCHOR)
    row[BALL:REACH], row[REACH] = centre, radius
    for off in np.vstack([np.zeros(3), 0.5 * np.eye(3), -0.5 * np.eye(3)]):
        x, y, z = (float(one) for one in centre + radius * off)
        free = min(distance_to_triangles(x, y, z, *surface), radius * (1.0 - float(np.linalg.norm(off))))
        if 0.5 * free > row[ROOM]:
            row[PLACE:ROOM], row[ROOM] = (x, y, z), 0.5 * free
        if row[ROOM] >= 0.5 * _GOOD * radius:
            break
    turns = winding_by_angles(row[PLACE], row[PLACE + 1], row[PLACE + 2], *surface) if row[ROOM] > 0.0 else 0.0
    row[TURNS] = round(turns)
    if abs(turns - row[TURNS]) > _WHOLE:
        row[ROOM] = 0.0
    return row


def no_anchor(*_: object) -> np.ndarray:
    """That of what has no sides: zeros, shape (ANCHOR,)."""
    return np.zeros(ANCHOR)
