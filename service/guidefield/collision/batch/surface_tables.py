"""The triangles of a mesh, and the balls of a cloud, as trees of parts for kernels; large ones are kept on disk.

The arrays are kernels/collide/parts.py's `Parts`, laid out by `part_tables.tree_layout`; boxes and hulls contain the
triangles below them, in single precision too (`SINGLE_ROUNDING`). `CLUSTER` is time, `SAMPLED_TRIANGLES`, at least 1,
also which distance within its `TOLERANCE` prove/search.py finds. A change of this file makes what is on disk anew.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from guidefield.collision.part_tables import tree_layout, write_boxes, write_clusters, write_triangles
from guidefield.geometry.cache import Allocate, Arrays, Layout, allocate_in_memory, is_large, make_in_place
from guidefield.geometry.convex import (
    CLUSTERS,
    Cluster,
    OnNodes,
    cluster_counts,
    count_boxed,
    mesh_of_nodes,
    write_tree,
)
from guidefield.kernels.collide.parts import (
    BALL_ROW,
    BLOCKS,
    FIRST_BLOCK,
    LINK,
    OWN,
    PART,
    RADIUS,
    ROUND as PART_ROUND,
    SHAPE,
    Parts,
)
from guidefield.kernels.collide.primitive import CENTRE, HALVES, PRIMITIVE, ROUND
from guidefield.kernels.cover.ball_cover import cluster_reaches, cluster_spreads
from guidefield.kernels.simd.packing import BLOCK
from guidefield.parallel import run_parallel
from guidefield.read_only import read_only
from guidefield.scene.cloud import Cloud
from guidefield.scene.obstacle import Obstacle

CLUSTER = 1  # index in `mesh_tree.CLUSTERS` of the clusters that get a box each
SAMPLED_TRIANGLES = 32  # triangles of a large node that choose the axes of its box: more fit closer, and take longer
SINGLE_ROUNDING = 2.0**-20  # share of its largest coordinate by which a box in single precision is made larger


def large_surface(obstacle: Obstacle) -> Arrays:
    """Return the tables of the tree over an obstacle's triangles, and of the boxes that stand for it where it stands.

    The arrays of `Parts` by name; `nodes` that stand for it (k,), the `rows` of a box about each as `collide.primitive`
    has them (k, PRIMITIVE), and `boxes` along the world's axes about these, lower and upper corner (k, 6) [m].
    """

    def write(allocate: Allocate) -> Arrays:
        corners = np.take(obstacle.vertices, obstacle.triangles, axis=0)
        boxed = count_boxed(len(corners)) if obstacle.solid else 0
        return _write_boxed_tree(corners, boxed, allocate)

    return _write_or_recall("lanes", obstacle, write, {"place": np.array(obstacle.placement.homogeneous, float)})


def cloud_parts(obstacle: Obstacle, cloud: Cloud) -> Parts:
    """Return the balls of a cloud: triangles whose corners are one point, rounded by the balls' radius."""

    def write(allocate: Allocate) -> Arrays:
        corners = np.repeat(cloud.points[:, None], 3, axis=1)
        made = allocate(_layout(len(corners)))
        _write_tree(corners, made)
        made["numbers"].reshape(-1, PART)[:, PART_ROUND] = cloud.radius
        made["balls"].reshape(-1, BALL_ROW)[:, RADIUS] += cloud.radius
        return made

    made = _write_or_recall("balls", obstacle, write, {"radius": np.array(cloud.radius)})
    return Parts(**{name: made[name] for name in Parts._fields})


def _write_or_recall(kind: str, obstacle: Obstacle, write: Callable[[Allocate], Arrays], more: Arrays) -> Arrays:
    """Return what `write` makes, read-only; of a large obstacle from disk if it was made before."""
    content = obstacle.recipe.content
    if content and is_large(obstacle.faces):
        return make_in_place(kind, {"content": np.frombuffer(content, np.uint8), **more}, write)
    made = write(allocate_in_memory)
    read_only(*made.values())
    return made


def _write_boxed_tree(corners: np.ndarray, boxed: int, allocate: Allocate) -> Arrays:
    """Return the tables of triangles (t, 3, 3) in the world, with boxes about `boxed` large nodes: all, or none.

    A closed mesh gets them: a place inside is nearly as far from much of it, and balls about large nodes tell little.
    """
    count = cluster_counts(len(corners))[CLUSTER]
    of_boxes = {"nodes": ("<i8", (count,)), "primitives": ("<f4", (count, PRIMITIVE)), "boxes": ("<f4", (count, 6))}
    made = allocate({**_layout(len(corners), boxed), **of_boxes})
    nodes, about = list[np.ndarray](), list[np.ndarray]()

    def stand_in(cluster: Cluster) -> None:
        rows = cluster_rows(corners, cluster[1])
        made["nodes"][:], made["primitives"][:], made["boxes"][:] = cluster[0], rows, boxes_about(rows)

    def keep(cluster: Cluster) -> None:
        nodes.append(cluster[0])
        about.append(box_corners(corners, cluster[1]))

    callbacks = (keep,) if boxed else ()
    _write_tree(corners, made, lambda clusters: stand_in(clusters[CLUSTER]), *callbacks)
    if boxed:
        write_boxes(np.concatenate(nodes), np.concatenate(about), made)
    return made


def _layout(triangles: int, boxed: int = 0) -> Layout:
    return tree_layout(triangles, 2 * triangles - 1, cluster_counts(triangles), boxes=boxed)


def _write_tree(
    corners: np.ndarray,
    made: Arrays,
    more: Callable[[tuple[Cluster, ...]], None] = lambda _: None,
    boxed: OnNodes = lambda _: None,
) -> None:
    """Write the tree over triangles (t, 3, 3), and whatever else is written of its clusters at the same time.

    `boxed` receives nodes as by `write_tree`.
    """
    balls, links = made["balls"].reshape(-1, BALL_ROW), made["links"].reshape(-1, LINK)
    clusters = write_tree(corners, balls, links, boxed).clusters
    run_parallel(
        lambda: write_triangles(corners, made), lambda: more(clusters), lambda: write_clusters(corners, clusters, made)
    )


def cluster_rows(corners: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Return boxes about clusters (k, most) of triangles (t, 3, 3) [m], along the axes in which their corners spread.

    Their numbers are as `collide.primitive` has them, shape (k, PRIMITIVE).
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
    """Return corners (k, 8, 3) [m] of boxes about clusters (k, most) of triangles (t, 3, 3), with `SINGLE_ROUNDING`.

    Their axes are the principal ones of `SAMPLED_TRIANGLES`.
    """
    members = np.ascontiguousarray(members, np.int64)
    some, count = np.ascontiguousarray(members[:, :: -(-members.shape[1] // SAMPLED_TRIANGLES)]), len(members)
    centres, spreads, reaches = np.empty((count, 3)), np.empty((count, 3, 3)), np.empty((count, 2, 3))
    cluster_spreads(corners, some, centres, spreads)
    axes = np.linalg.eigh(spreads)[1].swapaxes(1, 2).copy()
    cluster_reaches(corners, members, centres, axes, reaches)
    largest = np.abs(centres).max(axis=1) + np.abs(reaches).max(axis=(1, 2))
    reaches += SINGLE_ROUNDING * largest[:, None, None] * np.array([[-1.0], [1.0]])
    signs = np.array(list(itertools.product((0, 1), repeat=3)))
    found: np.ndarray = centres[:, None] + reaches[:, signs, np.arange(3)] @ axes
    return found


def boxes_about(rows: np.ndarray) -> np.ndarray:
    """Return boxes along the world's axes about boxes or balls (k, PRIMITIVE): the least x, y, z, then the largest."""
    axes = np.abs(rows[:, :CENTRE].reshape(-1, 3, 3))
    reach = np.einsum("kji,kj->ki", axes, rows[:, HALVES:ROUND]) + rows[:, ROUND, None]
    centres = rows[:, CENTRE:HALVES]
    return np.hstack([centres - reach, centres + reach])


class FlatParts(NamedTuple):
    """The parts of a flat surface, as if there were no other."""

    parts: Parts
    nodes: np.ndarray  # that stand for it, shape (k,)
    rows: np.ndarray  # numbers of the box about each, shape (k, PRIMITIVE)


class _Sorted:
    """Rows of a forest in the `order` of their meshes; those of a mesh keep their order.

    `starts` are the first of each of the meshes, then how many rows there are; `place` that of each among its mesh's.
    """

    def __init__(self, meshes: np.ndarray, count: int) -> None:
        self.order = np.argsort(meshes, kind="stable")
        self.starts = np.concatenate([[0], np.cumsum(np.bincount(meshes, minlength=count))])
        self.place = np.empty(len(meshes), np.int64)
        self.place[self.order] = np.arange(len(meshes))
        self.place -= self.starts[meshes]

    def split(self, rows: np.ndarray, width: int = 1) -> list[np.ndarray]:
        return [rows[begin:end] for begin, end in pairwise((width * self.starts).tolist())]


def flat_forest(surfaces: Sequence[np.ndarray]) -> list[FlatParts]:
    """Build the parts of flat surfaces from the corners of their triangles, shape (t, 3, 3) [m] each."""
    corners, counts = np.ascontiguousarray(np.concatenate(surfaces)), np.array([len(surface) for surface in surfaces])
    mesh_of_node, mesh_of_triangle = mesh_of_nodes(counts), np.repeat(np.arange(len(counts)), counts)
    balls, links = np.empty((len(mesh_of_node), BALL_ROW)), np.empty((len(mesh_of_node), LINK), np.int64)
    clusters = write_tree(corners, balls, links, counts=counts).clusters
    hulls = _without_small_roots(clusters, counts)
    made = allocate_in_memory(tree_layout(len(corners), len(balls), [len(nodes) for nodes, _ in hulls]))
    made["links"][:] = links.ravel()
    write_triangles(corners, made)
    write_clusters(corners, hulls, made)
    links, shapes = made["links"].reshape(-1, LINK), made["shapes"].reshape(-1, SHAPE)
    mesh_of_part = np.concatenate([mesh_of_triangle, *(mesh_of_node[nodes] for nodes, _ in hulls)])
    nodes, parts = _Sorted(mesh_of_node, len(counts)), _Sorted(mesh_of_part, len(counts))
    blocks = _Sorted(np.repeat(mesh_of_part, shapes[:, BLOCKS]), len(counts))
    links[:, :OWN] = np.where(links[:, :OWN] < 0, -1, nodes.place[links[:, :OWN]])
    links[:, OWN] = np.where(links[:, OWN] < 0, -1, parts.place[links[:, OWN]])
    with_blocks = shapes[:, BLOCKS] > 0
    shapes[with_blocks, FIRST_BLOCK] = blocks.place[shapes[with_blocks, FIRST_BLOCK]]
    ordered = Parts(
        balls=balls[nodes.order].ravel(),
        links=links[nodes.order].ravel(),
        shapes=shapes[parts.order].ravel(),
        numbers=made["numbers"].reshape(-1, PART)[parts.order].ravel(),
        vertices=made["vertices"].reshape(-1, BLOCK)[blocks.order].ravel(),
    )
    single = np.flatnonzero(counts == 1)
    standing, members = clusters[CLUSTER]
    rows = [cluster_rows(corners, one) for one in ((np.cumsum(counts) - 1)[single][:, None], members) if len(one)]
    standing = np.concatenate([single, standing])  # the roots come first
    stand_ins = _Sorted(mesh_of_node[standing], len(counts))
    numbers, places = np.concatenate(rows)[stand_ins.order], nodes.place[standing][stand_ins.order]
    for array in (*ordered, numbers, places):
        array.setflags(write=False)
    tables = map(
        Parts,
        nodes.split(ordered.balls, BALL_ROW),
        nodes.split(ordered.links, LINK),
        parts.split(ordered.shapes, SHAPE),
        parts.split(ordered.numbers, PART),
        blocks.split(ordered.vertices, BLOCK),
    )
    return list(map(FlatParts, tables, stand_ins.split(places), stand_ins.split(numbers)))


def _without_small_roots(clusters: tuple[Cluster, ...], counts: np.ndarray) -> tuple[Cluster, ...]:
    """Return clusters without the roots that are in smaller ones: their corners would be written three times."""
    found = [clusters[0]]
    for (nodes, members), smaller in zip(clusters[1:], CLUSTERS, strict=False):
        is_new = (nodes >= len(counts)) | (counts[np.minimum(nodes, len(counts) - 1)] > smaller)
        found.append((nodes[is_new], members[is_new]))
    return tuple(found)
