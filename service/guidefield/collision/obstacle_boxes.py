"""Boxes about obstacles: along the world's axes, by which they are found, and along their own, which are closer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from guidefield.collision.box_tree import BoxTree
from guidefield.kept import kept_with
from guidefield.messages import scene as messages
from guidefield.scene.carried import Rows, carried
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene

ROUNDING = 1e-9
"""What boxes along the world's axes are wider by, of a metre and of each metre that they are from the origin."""


class OwnBoxes(NamedTuple):
    """Boxes about obstacles along their own axes, and what is about these along the world's.

    Attributes:
        axes: Their axes as columns, shape (n, 3, 3).
        middles: Their middles in the world, shape (n, 3) [m].
        halves: Half extents, shape (n, 3) [m]; those of a half-space are infinite.
        centres: The middles along the axes, shape (n, 3) [m].
        low, high: Corners of boxes along the world's axes that contain them, a hair wider than they have to be, shape
            (n, 3) [m, world].
    """

    axes: np.ndarray
    middles: np.ndarray
    halves: np.ndarray
    centres: np.ndarray
    low: np.ndarray
    high: np.ndarray


class ObstacleBoxes:
    """Boxes about the obstacles of a scene, as they are placed at first.

    Args:
        own: As `own_boxes` has them.
    """

    def __init__(self, own: OwnBoxes) -> None:
        self._own = own

    def overlapping(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which obstacles may be in which of some boxes along the world's axes.

        Args:
            low: Their lower corners, shape (q, 3) [m, world].
            high: Their upper corners, shape (q, 3) [m, world].

        Returns:
            Index of a box and index of an obstacle, both of shape (k,), in this order.
        """
        asked, found = self.tree.overlapping(low, high)
        if not len(self.endless):
            return asked, self.bounded[found]
        asked = np.concatenate([asked, np.repeat(np.arange(len(low)), len(self.endless))])
        found = np.concatenate([self.bounded[found], np.tile(self.endless, len(low))])
        order = np.lexsort((found, asked))
        return asked[order], found[order]

    def gaps(self, points: np.ndarray, obstacles: np.ndarray) -> np.ndarray:
        """Distances of points from the boxes about obstacles along their own axes: 0 inside.

        Args:
            points: Shape (m, k, 3) [m, world].
            obstacles: Index of an obstacle for each row, shape (m,).

        Returns:
            Shape (m, k) [m]; of a half-space 0, for its box is endless.
        """
        axes, centres, halves = self.along_own_axes
        along = np.matmul(points, axes[obstacles]) - centres[obstacles, None]
        outside = np.maximum(np.abs(along) - halves[obstacles, None], 0.0)
        found: np.ndarray = np.sqrt(np.einsum("mki,mki->mk", outside, outside))
        return found

    @cached_property
    def along_own_axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The boxes along the obstacles' own axes.

        Returns:
            Their axes as columns, shape (o, 3, 3), centres along them and half extents, both of shape (o, 3) [m]; the
            extents of a half-space are infinite.
        """
        return self._own.axes, self._own.centres, self._own.halves

    @cached_property
    def endless(self) -> np.ndarray:
        """Those without an end, ascending indices, shape (e,)."""
        return np.flatnonzero(self._is_endless)

    @cached_property
    def bounded(self) -> np.ndarray:
        """The others, shape (b,)."""
        return np.flatnonzero(~self._is_endless)

    @cached_property
    def tree(self) -> BoxTree:
        """A tree of the boxes about those, along the world's axes."""
        corners = self._own.low, self._own.high
        return BoxTree.of(*(corners if not len(self.endless) else (one[self.bounded] for one in corners)))

    @cached_property
    def _is_endless(self) -> np.ndarray:
        return np.asarray(np.isinf(self._own.halves).any(axis=1))


@kept_with
def obstacle_boxes(scene: Scene) -> ObstacleBoxes:
    """The boxes about a scene's obstacles; made once for each scene."""
    return ObstacleBoxes(own_boxes(scene))


def _over(known: OwnBoxes, rows: Rows, scene: Scene) -> OwnBoxes:
    fresh = _own_boxes([scene.obstacles[index] for index in rows.fresh.tolist()])
    return OwnBoxes(*(rows.of(array, others) for array, others in zip(known, fresh, strict=True)))


@carried(_over)
def own_boxes(scene: Scene) -> OwnBoxes:
    """The boxes about a scene's obstacles, made once."""
    return _own_boxes(scene.obstacles)


def boxes_along_axes(obstacles: Sequence[Obstacle]) -> tuple[np.ndarray, np.ndarray]:
    """Boxes along the world's axes that contain obstacles, a hair wider than they have to be.

    Of primitives they are made of what is declared, many at once.

    Args:
        obstacles: Bounded obstacles.

    Returns:
        Lower and upper corners, both of shape (n, 3) [m, world].
    """
    boxes = _own_boxes(obstacles)
    return boxes.low, boxes.high


def _own_boxes(obstacles: Sequence[Obstacle]) -> OwnBoxes:
    """The same of any obstacles.

    Of primitives they are made of what is declared, many at once.
    """
    count = len(obstacles)
    axes, middles, halves = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3))
    kinds = np.array([_KINDS.get(type(one.message), -1) for one in obstacles], int)
    for kind, half_extents in enumerate(_HALVES):
        rows = np.flatnonzero(kinds == kind)
        if len(rows):
            declared: list[Any] = [obstacles[row].message for row in rows.tolist()]
            axes[rows] = _axes(declared)
            middles[rows] = [one.position for one in declared]
            halves[rows] = [half_extents(one) for one in declared]
    for row in np.flatnonzero(kinds < 0).tolist():
        axes[row], middles[row], halves[row] = _own_box(obstacles[row])
    with np.errstate(invalid="ignore"):  # of what is endless
        reach = np.einsum("nij,nj->ni", np.abs(axes), halves)
        reach[np.isinf(halves)] = np.inf
    low, high = middles - reach, middles + reach
    wider = ROUNDING * (1.0 + np.maximum(np.abs(low), np.abs(high)))
    return OwnBoxes(axes, middles, halves, np.einsum("ni,nij->nj", middles, axes), low - wider, high + wider)


def _axes(declared: list[Any]) -> np.ndarray:
    """The axes of primitives of one kind as columns, shape (n, 3, 3)."""
    if isinstance(declared[0], messages.Sphere):
        return np.tile(np.eye(3), (len(declared), 1, 1))
    turned = np.array([one.quaternion_xyzw for one in declared], float)
    x, y, z, w = (turned / np.linalg.norm(turned, axis=1, keepdims=True)).T
    rotations = np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
    return rotations.transpose(2, 0, 1)


_KINDS: dict[type, int] = {messages.Box: 0, messages.Sphere: 1, messages.Cylinder: 2, messages.Capsule: 3}

_HALVES: tuple[Callable[[Any], tuple[float, float, float]], ...] = (
    lambda m: (0.5 * m.size[0], 0.5 * m.size[1], 0.5 * m.size[2]),
    lambda m: (m.radius, m.radius, m.radius),
    lambda m: (m.radius, m.radius, 0.5 * m.length),
    lambda m: (m.radius, m.radius, 0.5 * m.length + m.radius),
)
"""Half extents of a primitive's box along its own axes [m], by `_KINDS`."""


def _own_box(obstacle: Obstacle) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The box about one that is no bounded primitive: axes as columns, its middle in the world, half extents [m]."""
    axes = np.array(obstacle.placement.rotation)
    if isinstance(obstacle.message, messages.HalfSpace):
        return axes, np.zeros(3), np.full(3, np.inf)
    low, high = obstacle.box
    return axes, obstacle.placement.act(0.5 * (low + high)), 0.5 * (high - low) + obstacle.rounding
