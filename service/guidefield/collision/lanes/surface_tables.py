"""The triangles of a large obstacle as tables for the lane kernels; those of a mesh are kept on disk."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from guidefield.collision.convex_parts import tree_layout, write_tree
from guidefield.geometry.cache import is_large, made_in_place
from guidefield.geometry.entries import Arrays, Room, in_memory
from guidefield.geometry.mesh_tree import cluster_counts, tree_written
from guidefield.kernels.collide.balls import BALL_ROW
from guidefield.kernels.collide.parts import LINK
from guidefield.kernels.collide.primitive import CENTRE, HALVES, PRIMITIVE, ROUND
from guidefield.kernels.cover.cluster_boxes import cluster_reaches, cluster_spreads
from guidefield.scene.obstacle import Obstacle

CLUSTER = 1
"""Which of the mesh trees' `CLUSTERS` stand behind one box each."""


def large_surface(obstacle: Obstacle, step: Callable[[], None]) -> Arrays:
    """The tables of the tree over an obstacle's triangles, and of the boxes that stand for it.

    Args:
        obstacle: It; where it stands.
        step: Called before each step; may raise.

    Returns:
        The arrays of `Parts` by name; the nodes that stand for it, shape (k,), the numbers of the box about each, as
        `collide.primitive` has them, shape (k, PRIMITIVE), and the boxes along the world's axes about these, lower and
        upper corner, shape (k, 6) [m].
    """

    def write(room: Room) -> Arrays:
        return _written(np.take(obstacle.vertices, obstacle.triangles, axis=0), step, room)

    if not obstacle.recipe.content or not is_large(obstacle.faces):
        return write(in_memory)
    place = np.array(obstacle.placement.homogeneous, float)
    return made_in_place("lanes", {"content": np.frombuffer(obstacle.recipe.content, np.uint8), "place": place}, write)


def _written(corners: np.ndarray, step: Callable[[], None], room: Room) -> Arrays:
    """The same of triangles (t, 3, 3) in the world."""
    count, nodes = len(corners), 2 * len(corners) - 1
    clusters = cluster_counts(count)
    boxes = clusters[CLUSTER]
    made = room(
        {
            **tree_layout(count, nodes, clusters),
            "nodes": ("<i8", (boxes,)),
            "primitives": ("<f4", (boxes, PRIMITIVE)),
            "boxes": ("<f4", (boxes, 6)),
        }
    )
    tree = tree_written(corners, made["balls"].reshape(-1, BALL_ROW), made["links"].reshape(-1, LINK), step)
    step()
    write_tree(corners, tree.clusters, made)
    made["nodes"][:], members = tree.clusters[CLUSTER]
    rows = cluster_rows(corners, members)
    made["primitives"][:], made["boxes"][:] = rows, boxes_about(rows)
    return made


def cluster_rows(corners: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Boxes about clusters of triangles, along the axes in which their corners spread.

    Args:
        corners: Of all triangles, shape (t, 3, 3) [m].
        members: The triangles of each cluster, shape (k, most).

    Returns:
        The numbers of each, as `collide.primitive` has them, shape (k, PRIMITIVE).
    """
    corners, members = np.ascontiguousarray(corners, float), np.ascontiguousarray(members, np.int64)
    count = len(members)
    centres, spreads = np.empty((count, 3)), np.empty((count, 3, 3))
    cluster_spreads(corners, members, centres, spreads)
    axes, reaches = np.linalg.eigh(spreads)[1].swapaxes(1, 2).copy(), np.empty((count, 2, 3))
    cluster_reaches(corners, members, centres, axes, reaches)
    low, high = reaches[:, 0], reaches[:, 1]
    rows = np.zeros((count, PRIMITIVE))
    rows[:, :CENTRE] = axes.reshape(-1, 9)
    rows[:, CENTRE:HALVES] = centres + np.einsum("ki,kij->kj", 0.5 * (low + high), axes)
    rows[:, HALVES:ROUND] = 0.5 * (high - low)
    return rows


def boxes_about(rows: np.ndarray) -> np.ndarray:
    """The boxes along the world's axes about boxes or balls (k, PRIMITIVE): the least x, y, z, then the largest."""
    axes = np.abs(rows[:, :CENTRE].reshape(-1, 3, 3))
    reach = np.einsum("kji,kj->ki", axes, rows[:, HALVES:ROUND]) + rows[:, ROUND, None]
    centres = rows[:, CENTRE:HALVES]
    return np.hstack([centres - reach, centres + reach])
