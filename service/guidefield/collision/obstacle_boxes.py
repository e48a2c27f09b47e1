"""Boxes about obstacles, the broad phase: a tree of those along the world's axes, and those along their own axes.

Trees are read by kernels/collide/broadphase.py and near_pairs.py. Boxes may be larger than obstacles, never smaller;
`CHILDREN`, at least 2, and `_BITS` are time alone. A tree that was updated is the one that would be built anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from guidefield.geometry.curve_order import CurveOrder, along_curve, change_along
from guidefield.kernels.collide.near_pairs import BoxedObstacles
from guidefield.kernels.collide.primitive import along_both, primitive_boxes
from guidefield.kernels.distance.bvh import boxes_above, overlaps_in_tree
from guidefield.read_only import ReadOnly, read_only
from guidefield.scene.incremental import Rows, incremental
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene, rows_of

CHILDREN = 16  # boxes behind one box of the next level
FIRST_OVERLAPS = 16  # overlaps of each box that memory is first made for; if there are more, they are found again
_BITS = 16  # bits of one coordinate of a place on the curve along which boxes are sorted; at most `curve_order.FINEST`


@dataclass(frozen=True, eq=False)
class BoxTree(ReadOnly):
    """Boxes in the order of their centres along a Morton curve, and above them boxes about every `CHILDREN` of them.

    `nodes` are lower, then upper corners (m, 6) [m], level by level from the boxes themselves up to one of `CHILDREN`
    at most; `firsts` tells where each level begins, then the number of all.
    """

    along: CurveOrder
    nodes: np.ndarray
    firsts: np.ndarray

    @classmethod
    def of(cls, boxes: np.ndarray) -> BoxTree:
        """Sort boxes, lower, then upper corners, shape (n, 6), finite [m]."""
        along = along_curve(0.5 * (boxes[:, :3] + boxes[:, 3:]), _BITS)
        nodes, firsts = _allocate_nodes(len(boxes))
        if len(boxes):
            np.take(boxes, along.order, axis=0, out=nodes[: len(boxes)], mode="clip")
        boxes_above(nodes, firsts, CHILDREN)
        return cls(along, nodes, firsts)

    def update(self, rows: Rows, fresh: np.ndarray) -> BoxTree | None:
        """Return the tree after some boxes were replaced by (k, 6) [m]; None if building it anew takes less time."""
        if not rows.count or not rows.before:
            return None
        along, runs, turn = change_along(
            self.along, rows.now, rows.fresh, 0.5 * (fresh[:, :3] + fresh[:, 3:]), rows.count
        )
        nodes, firsts = _allocate_nodes(rows.count)
        boxes = nodes[: rows.count]
        Rows(runs, rows.before).carry(self.boxes, fresh[turn], boxes)
        if not along.is_of(boxes):
            return None
        boxes_above(nodes, firsts, CHILDREN)
        return BoxTree(along, nodes, firsts)

    @property
    def order(self) -> np.ndarray:
        """Index of each box as it was given, in the order in which the tree has them, shape (n,)."""
        return self.along.order

    @property
    def boxes(self) -> np.ndarray:
        """The boxes themselves, shape (n, 6)."""
        return self.nodes[: len(self.along.order)]

    def overlapping(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the boxes that overlap or touch query boxes with corners (q, 3) [m].

        Returns indices of the query box and of the box as it was given, both of shape (k,), sorted in this order.
        """
        low, high = np.ascontiguousarray(low, float), np.ascontiguousarray(high, float)
        pairs = np.empty((FIRST_OVERLAPS * len(low), 2), np.int64)
        count = overlaps_in_tree(self.nodes, self.firsts, CHILDREN, low, high, pairs)
        if count > len(pairs):
            pairs = np.empty((count, 2), np.int64)
            overlaps_in_tree(self.nodes, self.firsts, CHILDREN, low, high, pairs)
        queries, found = pairs[:count, 0], self.order[pairs[:count, 1]]
        sorted_ = np.lexsort((found, queries))
        return queries[sorted_], found[sorted_]


def _allocate_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Allocate the nodes of a tree over a given number of boxes, shape (m, 6), and say where its levels begin."""
    sizes = [count]
    while sizes[-1] > CHILDREN:
        sizes.append(-(-sizes[-1] // CHILDREN))
    firsts = np.cumsum([0, *sizes])
    return np.empty((int(firsts[-1]), 6)), firsts


ROUNDING = 1e-9
"""Boxes along the world's axes are wider by this times 1 m plus their distance from the origin, for rounding."""


class OwnBoxes(NamedTuple):
    """Boxes about obstacles along their own axes, and boxes along the world's axes about these."""

    axes: np.ndarray  # their axes as columns, row by row, shape (n, 9)
    centres: np.ndarray  # coordinates of the middles along those axes, shape (n, 3) [m]
    halves: np.ndarray  # half extents along them, shape (n, 3) [m]; those of a half-space are infinite
    # lower, then upper corners of boxes along the world's axes about them, a hair wider, shape (n, 6) [m]
    boxes: np.ndarray


@dataclass(frozen=True, eq=False)
class ObstacleBoxes(ReadOnly):
    """Boxes about the obstacles of a scene in their first placements, as of `OwnBoxes`.

    The tree is of those along the world's axes about the `bounded` ones; the others are `endless`; ascending indices.
    """

    axes: np.ndarray
    centres: np.ndarray
    halves: np.ndarray
    endless: np.ndarray
    bounded: np.ndarray
    tree: BoxTree

    @classmethod
    def of(cls, own: OwnBoxes) -> ObstacleBoxes:
        """Build them from boxes along the obstacles' own axes."""
        endless, bounded = _split(own.halves)
        return cls(*own[:-1], endless, bounded, BoxTree.of(own.boxes[bounded] if len(endless) else own.boxes))

    def update(self, rows: Rows, own: OwnBoxes) -> ObstacleBoxes | None:
        """Return the boxes after some obstacles were replaced by others with `own` boxes; None to build them anew."""
        halves, (others, finite) = rows.carry(self.halves, own.halves), _split(own.halves)
        if len(self.endless) or len(others):
            endless, bounded = _split(halves)
            tree = self.tree.update(rows.among(self.bounded, bounded), own.boxes[finite])
        else:
            endless, bounded, tree = others, np.arange(rows.count), self.tree.update(rows, own.boxes)
        if tree is None:
            return None
        return ObstacleBoxes(
            axes=rows.carry(self.axes, own.axes),
            centres=rows.carry(self.centres, own.centres),
            halves=halves,
            endless=endless,
            bounded=bounded,
            tree=tree,
        )

    def overlapping(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the obstacles that may be in query boxes along the world's axes: indices of both (k,), in this order."""
        queries, found = self.tree.overlapping(low, high)
        if not len(self.endless):
            return queries, self.bounded[found]
        queries = np.concatenate([queries, np.repeat(np.arange(len(low)), len(self.endless))])
        found = np.concatenate([self.bounded[found], np.tile(self.endless, len(low))])
        order = np.lexsort((found, queries))
        return queries[order], found[order]

    def gaps(self, points: np.ndarray, obstacles: np.ndarray) -> np.ndarray:
        """Return distances of points (m, k, 3) from the box about one obstacle for each row; (m, k) [m], 0 inside."""
        along = np.matmul(points, self.axes.reshape(-1, 3, 3)[obstacles]) - self.centres[obstacles, None]
        outside = np.maximum(np.abs(along) - self.halves[obstacles, None], 0.0)
        found: np.ndarray = np.sqrt(np.einsum("mki,mki->mk", outside, outside))
        return found

    @cached_property
    def tables(self) -> BoxedObstacles:
        """The boxes as kernels read them."""
        order = self.tree.order
        made = BoxedObstacles(
            axes=self.axes,
            centres=self.centres,
            halves=self.halves,
            nodes=self.tree.nodes,
            levels=self.tree.firsts,
            children=CHILDREN,
            order=self.bounded[order] if len(self.endless) else order,
            apart=self.endless,
        )
        read_only(*made)
        return made


def _split(halves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of endless boxes, by half extents (n, 3), and those of the others; ascending."""
    endless = np.isinf(halves).any(axis=1)
    return np.flatnonzero(endless), np.flatnonzero(~endless)


def _over(known: ObstacleBoxes, rows: Rows, scene: Scene) -> ObstacleBoxes | None:
    return known.update(rows, own_boxes([scene.obstacles[index] for index in rows.fresh]))


@incremental(_over)
def obstacle_boxes(scene: Scene) -> ObstacleBoxes:
    """Build the boxes about a scene's obstacles; once for each scene."""
    return ObstacleBoxes.of(own_boxes(scene.obstacles))


def own_boxes(obstacles: Sequence[Obstacle]) -> OwnBoxes:
    """Build boxes about obstacles; those of primitives from what is declared, many at once."""
    placed, count = rows_of(obstacles), len(obstacles)
    axes, middles, halves = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3))
    primitive_boxes(placed, axes, middles, halves)
    for row, one in enumerate(obstacles):
        if not one.placed:
            axes[row], middles[row], halves[row] = _own_box(one)
    centres, boxes = np.empty((count, 3)), np.empty((count, 6))
    columns = axes.reshape(count, 9)
    along_both(columns, middles, halves, ROUNDING, centres, boxes)
    return OwnBoxes(columns, centres, halves, boxes)


def _own_box(obstacle: Obstacle) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the box about an obstacle that is no primitive: axes as columns, middle in the world, half extents [m]."""
    low, high = obstacle.box
    middle, half = 0.5 * (low + high), 0.5 * (high - low) + obstacle.rounding
    return np.array(obstacle.placement.rotation), obstacle.placement.act(middle), half
