"""Rectangles in a scene on which the field is pictured: given, seen from above, or laid along a path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

MARGIN = 0.5
"""What a plane along a path shows around it, over the path's extent."""

LEAST_MARGIN = 0.3
"""The least of it [m]."""

STRAIGHT = 0.05
"""A path is straight if it strays from a line by less than this part of its length."""

_UPRIGHT = 0.3
"""The world's vertical leads in a plane where at least this part of it lies in the plane."""


@dataclass(frozen=True, eq=False)
class SlicePlane:
    """A rectangle in the world; a picture on it has its first row and column at the corner (3,) [m].

    The first row leads `across` (3,) to the last column, the first column `down` (3,), at right angles to that [m].
    """

    corner: np.ndarray
    across: np.ndarray
    down: np.ndarray

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [m]."""
        return float(np.linalg.norm(self.across)), float(np.linalg.norm(self.down))

    @property
    def pose(self) -> Any:
        """T_world_plane, a pinocchio.SE3: from the rectangle's centre, x to the right, y up, z to who looks at it."""
        x, y = self.across / self.size[0], -self.down / self.size[1]
        return pin.SE3(np.column_stack([x, y, np.cross(x, y)]), self.corner + 0.5 * (self.across + self.down))

    @property
    def corners(self) -> np.ndarray:
        """Of the picture: first, end of the first row, last, end of the first column; shape (4, 3) [m]."""
        corners: np.ndarray = self.corner + np.outer([0, 1, 1, 0], self.across) + np.outer([0, 0, 1, 1], self.down)
        return corners

    def pixels(self, resolution: int) -> tuple[int, int]:
        """Return rows and columns of a picture, by its pixels along the longer side; ValueError if not positive."""
        if resolution < 1:
            raise ValueError(f"`resolution` must be positive, got {resolution}")
        width, height = self.size
        return (
            max(1, round(resolution * height / max(width, height))),
            max(1, round(resolution * width / max(width, height))),
        )

    def points(self, rows: int, columns: int) -> np.ndarray:
        """Centres of the pixels, shape (rows, columns, 3) [m]."""
        s, t = (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows
        points: np.ndarray = self.corner + s[None, :, None] * self.across + t[:, None, None] * self.down
        return points

    def projected(self, points: np.ndarray, rows: int, columns: int) -> np.ndarray:
        """Project points of the world, shape (n, 3) [m], to column and row of a picture, shape (n, 2) [pixels]."""
        offsets = np.asarray(points, float) - self.corner
        return np.column_stack(
            [
                offsets @ self.across * (columns / (self.across @ self.across)),
                offsets @ self.down * (rows / (self.down @ self.down)),
            ]
        )


def planes_along(path: np.ndarray) -> tuple[SlicePlane, SlicePlane]:
    """Two planes in which a path can be followed: the one that fits it best, and the one across that along it.

    Both go through the middle of the tip's path, shape (n, 3) [m, world], and contain its main direction, so that a
    path that is nearly flat runs in the first and, from the side, along the second. For a straight path the first is as
    level as it can be. They show the path with a margin on all sides; up in the picture is up in the world, or, seen
    from above, the world's y. Raises ValueError if there are no positions, or one isn't finite.
    """
    path = np.asarray(path, dtype=np.float64)
    if path.ndim != 2 or path.shape[1] != 3 or not len(path) or not np.isfinite(path).all():
        raise ValueError(f"`path` must be finite positions, shape (n, 3), got shape {path.shape}")
    middle = 0.5 * (path.min(axis=0) + path.max(axis=0))
    _, strays, axes = np.linalg.svd(path - path.mean(axis=0), full_matrices=len(path) < 3)
    strays = np.r_[strays, np.zeros(3 - len(strays))]
    main = axes[0] if strays[0] > 0.0 else np.array([1.0, 0.0, 0.0])
    if strays[1] > STRAIGHT * strays[0]:
        aside = axes[1]
    else:
        level = np.cross([0.0, 0.0, 1.0], main)
        aside = level / np.linalg.norm(level) if np.linalg.norm(level) > STRAIGHT else np.array([0.0, 1.0, 0.0])
    normal = np.cross(main, aside)
    return _framed(path, middle, normal / np.linalg.norm(normal)), _framed(path, middle, aside)


def _framed(path: np.ndarray, middle: np.ndarray, normal: np.ndarray) -> SlicePlane:
    """The rectangle across a normal that shows a path with its margin, seen from above or from the front."""
    vertical = np.array([0.0, 0.0, 1.0])
    up = vertical - (normal @ vertical) * normal
    if np.linalg.norm(up) < _UPRIGHT:
        normal = normal if normal[2] > 0.0 else -normal
        up = np.array([0.0, 1.0, 0.0]) - normal[1] * normal
    up /= np.linalg.norm(up)
    right = np.cross(up, normal)
    spans = []
    for axis in (right, up):
        along = (path - middle) @ axis
        margin = max(LEAST_MARGIN, MARGIN * float(np.ptp(path @ axis)))
        spans.append((along.min() - margin, along.max() + margin))
    (left, past), (bottom, top) = spans
    return SlicePlane(middle + left * right + top * up, (past - left) * right, (bottom - top) * up)
