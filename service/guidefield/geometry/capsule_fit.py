"""A small capsule that contains points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.geometry.axes import across
from guidefield.geometry.directions import furthest, spread_directions
from guidefield.geometry.surfaces import Floats
from guidefield.kernels.cover.enclosing_circle import SLACK, enclosing_circle

_ROUNDING = 16.0 * float(np.finfo(np.float64).eps)
"""The same for points that lie close together far from the origin, over their coordinates."""

_RADII = 1.0 + 0.25 * np.linspace(0.0, 1.0, 11) ** 2
"""Radii to try, as multiples of the least: a wider capsule may be shorter; 1.225 makes a cube's a ball."""

_DIRECTIONS = spread_directions(512)
"""Of many points those furthest in these directions choose the direction of the axis."""

_FIRST_TILT = 0.2
_LAST_TILT = 0.01
"""Steps of the search for the best direction [rad]."""


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within `radius` of the segment from `p0` to `p1`.

    Attributes:
        p0: One end of the axis, shape (3,) [m], in the frame of what it contains.
        p1: The other, shape (3,) [m]; may be the same.
        radius: [m].
    """

    p0: Floats
    p1: Floats
    radius: float

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        length = float(np.linalg.norm(self.p1 - self.p0))
        return np.pi * self.radius**2 * (length + 4.0 / 3.0 * self.radius)

    def distance(self, points: Floats) -> Floats:
        """Signed distance of points from the surface, shape (n,) [m]; negative inside.

        Args:
            points: Shape (n, 3) [m], in the capsule's frame.
        """
        axis = self.p1 - self.p0
        square = float(axis @ axis)
        offsets = points - self.p0
        along = np.clip(offsets @ axis / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(points))
        distances: Floats = np.linalg.norm(offsets - along[:, None] * axis, axis=1) - self.radius
        return distances


def fit_capsule(points: Floats) -> Capsule:
    """A capsule that contains all points, of locally least volume over the directions of its axis.

    The search starts from the best principal axis of the points. The same points give the same capsule.

    Args:
        points: Shape (n, 3), n >= 1 [m], in any frame; the capsule is in the same.

    Raises:
        ValueError: if there is no point, or one is not finite.
    """
    cloud = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if len(cloud) == 0 or not np.isfinite(cloud).all():
        raise ValueError("a capsule needs at least one point, and all finite")
    few = cloud
    if len(cloud) > len(_DIRECTIONS):
        few = cloud[furthest(cloud, _DIRECTIONS / np.maximum(np.ptp(cloud, axis=0), 1e-9))]
    few = np.unique(few, axis=0)
    centred = few - few.mean(axis=0)
    principal = np.linalg.svd(centred.T @ centred)[2]
    best, direction = _tilted(few, min(principal, key=lambda axis: _along(few, axis).volume))
    return best if len(cloud) <= len(_DIRECTIONS) else _along(cloud, direction)


def _tilted(cloud: Floats, direction: Floats) -> tuple[Capsule, Floats]:
    """The best capsule that tilting the direction, less and less, leads to, and its direction."""
    best = _along(cloud, direction)
    tilt = _FIRST_TILT
    while tilt > _LAST_TILT:
        first, second = across(direction)
        tilts = [direction + tilt * side for side in (first, -first, second, -second)]
        trials = [(_along(cloud, tilted), tilted) for tilted in (t / np.linalg.norm(t) for t in tilts)]
        trial, tilted = min(trials, key=lambda pair: pair[0].volume)
        if trial.volume < best.volume:
            best, direction = trial, tilted
        else:
            tilt *= 0.5
    return best, direction


def _along(cloud: Floats, direction: Floats) -> Capsule:
    """The capsule of least volume with its axis along a unit direction, through the middle of the enclosing circle."""
    frame = np.vstack([across(direction), direction])
    local = cloud @ frame.T
    centre, radius = _enclosing_circle(local[:, :2])
    radii = radius * _RADII
    # A point is inside if the axis comes to within `reach` of its height.
    squares = ((local[:, :2] - centre) ** 2).sum(axis=1)
    reach = np.sqrt(np.maximum((radii * radii)[:, None] - squares, 0.0))
    low, high = (local[:, 2] + reach).min(axis=1), (local[:, 2] - reach).max(axis=1)
    best = int(np.argmin(radii**2 * (np.maximum(high - low, 0.0) + 4.0 / 3.0 * radii)))
    heights = (low[best], high[best]) if low[best] < high[best] else [0.5 * (low[best] + high[best])] * 2
    ends = np.array([[*centre, height] for height in heights]) @ frame
    ends.setflags(write=False)
    farthest = float(Capsule(ends[0], ends[1], 0.0).distance(cloud).max())
    return Capsule(ends[0], ends[1], farthest * SLACK + _ROUNDING * float(np.abs(cloud).max()))


def _enclosing_circle(points: Floats) -> tuple[Floats, float]:
    """The smallest circle around points in the plane, shape (n, 2): centre (2,) and radius."""
    circle = np.empty(3)
    enclosing_circle(np.ascontiguousarray(points), circle)
    return circle[:2], float(circle[2])
