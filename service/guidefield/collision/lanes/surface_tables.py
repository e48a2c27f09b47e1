"""The triangles of a mesh, and the balls of a cloud, as tables for kernels; those of large ones are kept on disk."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from guidefield.collision.convex_parts import tree_layout, write_boxes, write_clusters, write_triangles
from guidefield.geometry.cache import is_large, made_in_place
from guidefield.geometry.entries import Arrays, Layout, Room, in_memory
from guidefield.geometry.mesh_tree import Cluster, Told, boxed_count, cluster_counts, tree_written
from guidefield.kernels.collide.balls import BALL_ROW, RADIUS
from guidefield.kernels.collide.parts import LINK, PART, ROUND as PART_ROUND, Parts
from guidefield.kernels.collide.primitive import CENTRE, HALVES, PRIMITIVE, ROUND
from guidefield.kernels.cover.cluster_boxes import cluster_reaches, cluster_spreads
from guidefield.parallel import run_parallel
from guidefield.read_only import read_only
from guidefield.scene.cloud import Cloud
from guidefield.scene.obstacle import Obstacle

CLUSTER = 1
"""Which of the mesh trees' `CLUSTERS` stand behind one box each."""

SOME = 32
"""Of so many triangles of a large node the corners tell along which axes its box is. Unrecorded."""

SINGLE = 2.0**-20
"""By which share of the largest length in it a box of vertices in single precision is made larger."""


def large_surface(obstacle: Obstacle) -> Arrays:
    """The tables of the tree over an obstacle's triangles, and of the boxes that stand for it where it stands.

    The arrays of `Parts` by name; `nodes` that stand for it (k,), numbers of the box about each as `collide.primitive`
    has them (k, PRIMITIVE), and `boxes` along the world's axes about these, lower and upper corner (k, 6) [m].
    """

    def write(room: Room) -> Arrays:
        corners = np.take(obstacle.vertices, obstacle.triangles, axis=0)
        boxed = boxed_count(len(corners)) if obstacle.solid else 0
        return _write_boxed_tree(corners, boxed, room)

    return _write_or_recall("lanes", obstacle, write, {"place": np.array(obstacle.placement.homogeneous, float)})


def cloud_parts(obstacle: Obstacle, cloud: Cloud) -> Parts:
    """The balls of a cloud: triangles whose corners are one, rounded by their radius."""

    def write(room: Room) -> Arrays:
        corners = np.repeat(cloud.points[:, None], 3, axis=1)
        made = room(_layout(len(corners)))
        _write_tree(corners, made)
        made["numbers"].reshape(-1, PART)[:, PART_ROUND] = cloud.radius
        made["balls"].reshape(-1, BALL_ROW)[:, RADIUS] += cloud.radius
        return made

    made = _write_or_recall("balls", obstacle, write, {"radius": np.array(cloud.radius)})
    return Parts(**{name: made[name] for name in Parts._fields})


def _write_or_recall(kind: str, obstacle: Obstacle, write: Callable[[Room], Arrays], more: Arrays) -> Arrays:
    """What is written, read-only; of a large obstacle from disk if it was asked for before."""
    content = obstacle.recipe.content
    if content and is_large(obstacle.faces):
        return made_in_place(kind, {"content": np.frombuffer(content, np.uint8), **more}, write)
    made = write(in_memory)
    read_only(*made.values())
    return made


def _write_boxed_tree(corners: np.ndarray, boxed: int, room: Room) -> Arrays:
    """The tables of triangles (t, 3, 3) in the world, with boxes about so many large nodes: all of them, or none.

    About what is closed many places are nearly as far from much of it, and balls about large nodes tell little.
    """
    count = cluster_counts(len(corners))[CLUSTER]
    of_boxes = {"nodes": ("<i8", (count,)), "primitives": ("<f4", (count, PRIMITIVE)), "boxes": ("<f4", (count, 6))}
    made = room({**_layout(len(corners), boxed), **of_boxes})
    nodes, about = list[np.ndarray](), list[np.ndarray]()

    def stand_in(cluster: Cluster) -> None:
        rows = cluster_rows(corners, cluster[1])
        made["nodes"][:], made["primitives"][:], made["boxes"][:] = cluster[0], rows, boxes_about(rows)

    def keep(cluster: Cluster) -> None:
        nodes.append(cluster[0])
        about.append(box_corners(corners, cluster[1]))

    told = (keep,) if boxed else ()
    _write_tree(corners, made, lambda clusters: stand_in(clusters[CLUSTER]), *told)
    if boxed:
        write_boxes(np.concatenate(nodes), np.concatenate(about), made)
    return made


def _layout(triangles: int, boxed: int = 0) -> Layout:
    return tree_layout(triangles, 2 * triangles - 1, cluster_counts(triangles), boxes=boxed)


def _write_tree(
    corners: np.ndarray,
    made: Arrays,
    more: Callable[[tuple[Cluster, ...]], None] = lambda _: None,
    boxed: Told = lambda _: None,
) -> None:
    """Write the tree over triangles (t, 3, 3), and whatever else is written of its clusters at the same time.

    `boxed` is told of nodes as by `tree_written`.
    """
    balls, links = made["balls"].reshape(-1, BALL_ROW), made["links"].reshape(-1, LINK)
    clusters = tree_written(corners, balls, links, boxed).clusters
    run_parallel(
        lambda: write_triangles(corners, made), lambda: more(clusters), lambda: write_clusters(corners, clusters, made)
    )


def cluster_rows(corners: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Boxes about clusters (k, most) of triangles (t, 3, 3) [m], along the axes in which their corners spread.

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


def box_corners(corners: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Corners (k, 8, 3) of boxes about clusters (k, most) of triangles (t, 3, 3), along the axes of some [m].

    The boxes are larger by what single precision may take from them.
    """
    members = np.ascontiguousarray(members, np.int64)
    some, count = np.ascontiguousarray(members[:, :: -(-members.shape[1] // SOME)]), len(members)
    centres, spreads, reaches = np.empty((count, 3)), np.empty((count, 3, 3)), np.empty((count, 2, 3))
    cluster_spreads(corners, some, centres, spreads)
    axes = np.linalg.eigh(spreads)[1].swapaxes(1, 2).copy()
    cluster_reaches(corners, members, centres, axes, reaches)
    largest = np.abs(centres).max(axis=1) + np.abs(reaches).max(axis=(1, 2))
    reaches += SINGLE * largest[:, None, None] * np.array([[-1.0], [1.0]])
    signs = np.array(list(itertools.product((0, 1), repeat=3)))
    found: np.ndarray = centres[:, None] + reaches[:, signs, np.arange(3)] @ axes
    return found


def boxes_about(rows: np.ndarray) -> np.ndarray:
    """The boxes along the world's axes about boxes or balls (k, PRIMITIVE): the least x, y, z, then the largest."""
    axes = np.abs(rows[:, :CENTRE].reshape(-1, 3, 3))
    reach = np.einsum("kji,kj->ki", axes, rows[:, HALVES:ROUND]) + rows[:, ROUND, None]
    centres = rows[:, CENTRE:HALVES]
    return np.hstack([centres - reach, centres + reach])
