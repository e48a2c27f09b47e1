"""Cores that hold bodies: the hull of some corners with a disc at each point, and what is within a radius of that."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import coal
import numpy as np

from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.messages import scene as messages
from guidefield.read_only import read_only
from guidefield.scene.carried import Rows, carried
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene

MOST_CORNERS = 512
"""Of a hull of more its box is the core: to look at all of its corners takes as long as Coal does."""


class Core(NamedTuple):
    """What a body is in, in its own frame.

    Attributes:
        corners: Shape (k, 3) [m]; none where nothing so simple holds it.
        disc: Radius of a disc about the frame's last axis [m].
        rounded: Radius of a ball [m].
        filled: Whether the body fills it.
    """

    corners: np.ndarray
    disc: float = 0.0
    rounded: float = 0.0
    filled: bool = True


def core_of(shape: Any) -> Core:
    """The core of a Coal shape."""
    core = _core_of(shape)
    swept = shape.getSweptSphereRadius() if hasattr(shape, "getSweptSphereRadius") else 0.0
    return core._replace(rounded=core.rounded + swept)


def _core_of(shape: Any) -> Core:
    if isinstance(shape, coal.Convex):
        points = np.array(shape.points(), float)
        return Core(points) if len(points) <= MOST_CORNERS else Core(_box_of(points), filled=False)
    if isinstance(shape, coal.Box):
        return Core(_SIGNS * np.array(shape.halfSide, float))
    if isinstance(shape, coal.Sphere):
        return Core(np.zeros((1, 3)), rounded=shape.radius)
    if isinstance(shape, coal.Capsule):
        return Core(_ENDS * shape.halfLength, rounded=shape.radius)
    if isinstance(shape, coal.Cylinder):
        return Core(_ENDS * shape.halfLength, disc=shape.radius)
    return Core(np.empty((0, 3)), filled=False)


def _box_of(points: np.ndarray) -> np.ndarray:
    """The corners of the box along the axes about points (k, 3), shape (8, 3) [m]."""
    corners: np.ndarray = np.where(_SIGNS > 0.0, points.max(axis=0), points.min(axis=0))
    return corners


_SIGNS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_ENDS = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])


class Cores(NamedTuple):
    """The cores of obstacles, their corners those of boxes along their own axes.

    Of what is neither a ball, a cylinder nor a capsule the box about it is the core.

    Attributes:
        halves: Half extents of the boxes, shape (o, 3) [m].
        discs: Radii of discs about the last axis, shape (o,) [m].
        rounded: Radii of balls, shape (o,) [m]; infinite for those without an end.
        filled: Whether what Coal knows of the obstacle fills its core, 1 or 0, shape (o,).
    """

    halves: np.ndarray
    discs: np.ndarray
    rounded: np.ndarray
    filled: np.ndarray


def _over(known: Cores, rows: Rows, scene: Scene) -> Cores:
    fresh = _cores([scene.obstacles[index] for index in rows.fresh], obstacle_boxes(scene).halves[rows.fresh])
    return _frozen(Cores(*(rows.carry(array, others) for array, others in zip(known, fresh, strict=True))))


@carried(_over)
def obstacle_cores(scene: Scene) -> Cores:
    """The cores of a scene's obstacles."""
    return _frozen(_cores(scene.obstacles, obstacle_boxes(scene).halves))


def _frozen(cores: Cores) -> Cores:
    read_only(*cores)
    return cores


_ROUND: dict[type, int] = {messages.Sphere: 1, messages.Cylinder: 2, messages.Capsule: 3, messages.Box: 4}


def _cores(obstacles: Sequence[Obstacle], halves: np.ndarray) -> Cores:
    """The same of any obstacles, with the half extents of their boxes, shape (o, 3) [m]."""
    kinds = np.array([_ROUND.get(type(one.message), 0) if one.placed else 0 for one in obstacles], np.int64)
    balls, cylinders, capsules = (kinds == kind for kind in (1, 2, 3))
    cores, discs, rounded = halves.copy(), np.zeros(len(halves)), np.zeros(len(halves))
    discs[cylinders] = halves[cylinders, 0]
    rounded[balls | capsules] = halves[balls | capsules, 0]
    cores[balls] = 0.0
    cores[cylinders | capsules, :2] = 0.0
    cores[capsules, 2] -= rounded[capsules]
    rounded[np.isinf(halves).any(axis=1)] = np.inf
    return Cores(cores, discs, rounded, (kinds > 0).astype(np.int64))
