"""Flat surfaces of few triangles as parts, all of them together: the trees over their triangles are one forest."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from guidefield.collision.convex_parts import tree_layout, write_clusters, write_triangles
from guidefield.collision.lanes.surface_tables import CLUSTER, cluster_rows
from guidefield.geometry.entries import in_memory
from guidefield.geometry.mesh_tree import CLUSTERS, Cluster, mesh_of_nodes, tree_written
from guidefield.kernels.collide.balls import BALL_ROW
from guidefield.kernels.collide.parts import BLOCKS, FIRST_BLOCK, LINK, OWN, PART, SHAPE, Parts
from guidefield.kernels.simd.blocks import BLOCK


class FlatParts(NamedTuple):
    """The parts of a flat surface, as if there were no other.

    The nodes (k,) stand for it, and the rows are the numbers of the box about each, shape (k, PRIMITIVE).
    """

    parts: Parts
    nodes: np.ndarray
    rows: np.ndarray


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
        """Return the rows of each mesh, of an array in that order in which each row has so many elements."""
        return [rows[begin:end] for begin, end in pairwise((width * self.starts).tolist())]


def flat_forest(surfaces: Sequence[np.ndarray]) -> list[FlatParts]:
    """Build the parts of flat surfaces from the corners of their triangles, shape (t, 3, 3) [m] each."""
    corners, counts = np.ascontiguousarray(np.concatenate(surfaces)), np.array([len(surface) for surface in surfaces])
    mesh_of_node, mesh_of_triangle = mesh_of_nodes(counts), np.repeat(np.arange(len(counts)), counts)
    balls, links = np.empty((len(mesh_of_node), BALL_ROW)), np.empty((len(mesh_of_node), LINK), np.int64)
    clusters = tree_written(corners, balls, links, counts=counts).clusters
    hulls = _smallest(clusters, counts)
    made = in_memory(tree_layout(len(corners), len(balls), [len(nodes) for nodes, _ in hulls]))
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


def _smallest(clusters: tuple[Cluster, ...], counts: np.ndarray) -> tuple[Cluster, ...]:
    """Return clusters without the roots that are in smaller ones: their corners would be written three times."""
    found = [clusters[0]]
    for (nodes, members), smaller in zip(clusters[1:], CLUSTERS, strict=False):
        is_new = (nodes >= len(counts)) | (counts[np.minimum(nodes, len(counts) - 1)] > smaller)
        found.append((nodes[is_new], members[is_new]))
    return tuple(found)
