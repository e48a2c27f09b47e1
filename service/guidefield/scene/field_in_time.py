"""The field of a scene at points of several times: moving obstacles are evaluated in their own frames."""

from __future__ import annotations

from typing import Any

import numpy as np

from guidefield.geometry.far_tree import with_far_trees
from guidefield.kernels.field.field import field_at_points
from guidefield.kernels.field.field_tables import FieldTables, single_precision
from guidefield.memo import memoized
from guidefield.scene.scene import Scene

Origin = tuple[float, float, float]


@memoized
def single_tables(scene: Scene, origin: Origin) -> FieldTables:
    """Return the scene's field in single precision, relative to an origin near the points of interest [m, world]."""
    return single_precision(scene.tables, np.array(origin))


@memoized
def coarse_tables(scene: Scene, origin: Origin) -> FieldTables:
    """Return the same with expansions for all that is far away, for pictures: see `with_far_trees`."""
    return single_precision(with_far_trees(scene.tables), np.array(origin))


def field_in_time(
    scene: Scene, points: np.ndarray, times: np.ndarray | None, origin: Origin
) -> tuple[np.ndarray, np.ndarray]:
    """Return potential (n, p) [1/m] and gradient (n, p, 3) [1/m^2] at points (n, p, 3) to a few thousandths.

    Each row of points has its time [s], (n,); None: all obstacles are at their first placements. The origin is a place
    in the midst of the points [m, world].
    """
    field = field_at_points(coarse_tables(scene.resting, origin), points.reshape(-1, 3))
    potential, gradient = field.potential.reshape(points.shape[:2]), field.gradient.reshape(points.shape)
    if scene.moves:
        for_movers = field_of_movers(scene, points, times)
        potential, gradient = potential + for_movers[0], gradient + for_movers[1]
    return potential, gradient


def field_of_movers(scene: Scene, points: np.ndarray, times: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return what the moving obstacles add to the field; the arguments and the result are those of `field_in_time`."""
    potential, gradient = np.zeros(points.shape[:2]), np.zeros(points.shape)
    for tables, motion in _movers(scene):
        moves = [_move(motion, time) for time in ([-np.inf] * len(points) if times is None else times.tolist())]
        rotations, translations = np.array([m[:3, :3] for m in moves]), np.array([m[:3, 3] for m in moves])
        in_its_frame = (points - translations[:, None]) @ rotations
        field = field_at_points(tables, in_its_frame.reshape(-1, 3))
        potential += field.potential.reshape(points.shape[:2])
        gradient += field.gradient.reshape(points.shape) @ rotations.swapaxes(1, 2)
    return potential, gradient


def _move(motion: Any, time: float) -> np.ndarray:
    """Return the motion of an obstacle from its first placement to that at a time [s], shape (4, 4)."""
    move: np.ndarray = (motion.at(time) * motion.placements[0].inverse()).homogeneous
    return move


@memoized
def _movers(scene: Scene) -> tuple[tuple[FieldTables, Any], ...]:
    movers = [(index, scene.obstacles[index]) for index in scene.others]
    return tuple(
        (single_precision(scene.of([index]).tables, one.placement.translation), one.motion)
        for index, one in movers
        if one.motion is not None
    )
