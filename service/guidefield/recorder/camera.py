"""From where to look: the side from which the scene hides least of the motion, and what stands in the way even so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from guidefield.recorder.blueprint import Eye
from guidefield.scene.obstacle import Obstacle

AZIMUTHS = 16
ELEVATIONS = (0.35, 0.65)
"""Angles above the horizon that are tried [rad]."""

PREFERRED_AZIMUTH = 1.96
"""How far from the direction of the motion the eye stands best, seen from above [rad]: to its side, a little behind."""

PREFERENCE = 1.2
"""Share of hidden points that the preferred direction makes up for."""

DISTANCE = 1.9
"""How far the eye is, as a multiple of the radius of what it looks at."""

SMALLEST_RADIUS = 0.35
"""Radius that is looked at even if less moves [m]."""

SAMPLES = 8
"""Points of the tip's way that are looked for."""

MOST_TRIANGLES = 1500
"""Triangles that may hide something; of more, the largest."""

HIDING_SHARE = 0.1
"""Share of the tip's way that an obstacle hides before it is drawn translucent."""


def choose_eye(tip: np.ndarray, robot: np.ndarray, landmarks: np.ndarray, obstacles: Sequence[Obstacle]) -> Eye:
    """Choose from where to look at a motion.

    Args:
        tip: The tip's way, shape (n, 3) [m, world].
        robot: Points of the robot on the way, shape (m, 3) [m, world]; they are to be in the picture too.
        landmarks: Other points that are, shape (k, 3) [m, world], k may be 0: where the motion was to lead.
        obstacles: What may hide the motion.
    """
    seen = np.vstack([tip, robot, landmarks])
    lowest, highest = seen.min(axis=0), seen.max(axis=0)
    target = 0.5 * (lowest + highest)
    distance = DISTANCE * max(0.5 * float(np.linalg.norm(highest - lowest)) + 0.15, SMALLEST_RADIUS)
    points = tip[np.unique(np.linspace(0, len(tip) - 1, SAMPLES).astype(int))]
    corners, owners = _occluders(obstacles)
    forward = np.vstack([tip, landmarks]).mean(axis=0) - robot.mean(axis=0)
    heading = float(np.arctan2(forward[1], forward[0]))
    directions, preferences = _directions(heading)
    eyes = target + distance * directions
    hits = _hits(eyes, points, corners)
    best = int(np.argmin(hits.any(axis=2).mean(axis=1) - PREFERENCE * preferences))
    return Eye(eyes[best], target, _hiding(hits[best], owners, obstacles))


def _directions(heading: float) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (e, 3) from the target to the eye, and how much each is preferred, from 0 to 1, shape (e,)."""
    directions, preferences = [], []
    for elevation in ELEVATIONS:
        for azimuth in np.linspace(-np.pi, np.pi, AZIMUTHS, endpoint=False):
            off = abs(abs(azimuth) - PREFERRED_AZIMUTH) / np.pi
            side = 0.05 if azimuth < 0.0 else 0.0  # of two mirrored views, always the same one
            flat = heading + azimuth
            level = np.cos(elevation)
            direction = np.array([level * np.cos(flat), level * np.sin(flat), np.sin(elevation)])
            directions.append(direction)
            preferences.append(1.0 - off - side)
    return np.array(directions), np.array(preferences)


def _occluders(obstacles: Sequence[Obstacle]) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (t, 3, 3) of all obstacles, the largest first, and the index of each one's obstacle (t,).

    Clouds, which are mostly gaps, hide nothing.
    """
    solid = [index for index, obstacle in enumerate(obstacles) if obstacle.cloud is None]
    if not solid:
        return np.empty((0, 3, 3)), np.empty(0, int)
    corners = np.concatenate([obstacles[index].vertices[obstacles[index].triangles] for index in solid])
    owners = np.repeat(solid, [len(obstacles[index].triangles) for index in solid])
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    largest = np.argsort(-areas, kind="stable")[:MOST_TRIANGLES]
    return corners[largest], owners[largest]


def _hits(eyes: np.ndarray, points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Which triangles (t, 3, 3) cut the segments from eyes (e, 3) to points (n, 3): shape (e, n, t).

    Source: T. Möller, B. Trumbore, Fast, Minimum Storage Ray/Triangle Intersection, 1997.
    """
    rays = points - eyes[:, None]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    offset = eyes[:, None] - corners[:, 0]
    turned = np.cross(offset, first)
    determinant = -rays @ np.cross(first, second).T
    inverse = 1.0 / np.where(np.abs(determinant) < 1e-12, np.inf, determinant)
    u = rays @ np.cross(second, offset).swapaxes(1, 2) * inverse
    v = rays @ turned.swapaxes(1, 2) * inverse
    along = np.einsum("etk,tk->et", turned, second)[:, None] * inverse
    inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (inverse != 0.0)
    cut: np.ndarray = inside & (along > 1e-6) & (along < 1.0 - 1e-6)
    return cut


def _hiding(hits: np.ndarray, owners: np.ndarray, obstacles: Sequence[Obstacle]) -> frozenset[str]:
    """Names of the obstacles some triangle of which, one of (t,), hides many of the points (n, t)."""
    cutting = np.flatnonzero(hits.any(axis=0))
    shares = {index: hits[:, owners == index].any(axis=1).mean() for index in np.unique(owners[cutting]).tolist()}
    return frozenset(obstacles[index].name for index, share in shares.items() if share > HIDING_SHARE)
