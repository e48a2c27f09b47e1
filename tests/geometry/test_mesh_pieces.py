"""A mesh in convex parts as a tree: from disk it is what was computed, and parts hold the triangles that reach them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from guidefield.geometry import surfaces
from guidefield.geometry.decomposition import Decomposition, Part, decompose
from guidefield.geometry.mesh_pieces import pieces_tree, remembered_tree
from guidefield.geometry.mesh_tree import (
    BOXED,
    CLUSTERS,
    SPREAD_POINTS,
    Cluster,
    boxed_count,
    cluster_counts,
    spread_points,
    tree_written,
    triangle_tree,
)
from guidefield.geometry.solid import solid
from guidefield.kernels.cover.beyond_planes import not_beyond
from tests.collision.lanes.test_lanes import torus
from tests.geometry import solids


def ring() -> tuple[np.ndarray, np.ndarray, Decomposition]:
    vertices, triangles = (np.array(rows) for rows in torus(8, 5))
    return vertices, triangles, decompose(solid(vertices, triangles), 0.005, 4)


def test_a_tree_from_disk_is_the_one_that_was_computed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    vertices, triangles, cut = ring()
    made = pieces_tree(vertices, triangles, cut)
    for _ in range(2):
        found = remembered_tree(vertices, triangles, cut)
        for name in ("corners", "balls", "links", "pieces"):
            np.testing.assert_array_equal(getattr(found, name), getattr(made, name))
        assert list(found.hulls) == list(made.hulls)
        for node, hull in made.hulls.items():
            np.testing.assert_array_equal(found.hulls[node], hull)
    assert len(made.pieces) > 1
    assert len(list(tmp_path.rglob("tree-*"))) == 1


def test_a_sliver_of_a_hull_takes_no_triangle_from_a_part() -> None:
    box = surfaces.box((0.2, 0.2, 0.2))
    a, b = box.vertices[0], box.vertices[-1]  # through the middle: a plane that holds the line has half of it beyond
    for side in np.vstack([np.eye(3), -np.eye(3)]):
        thin = surfaces.surface(
            np.vstack([box.vertices, 0.5 * (a + b) + 1e-14 * side]),
            np.vstack([[[0, 7, 8]], [[7, 0, 8]], box.triangles]),
        )
        part = Part(thin, 0.0)
        alone = pieces_tree(box.vertices, box.triangles, Decomposition((part,), part))
        whole = pieces_tree(box.vertices, box.triangles)
        assert {row.tobytes() for row in alone.corners} == {row.tobytes() for row in whole.corners}


@pytest.mark.parametrize("seed", range(3))
def test_each_triangle_is_in_a_part(seed: int) -> None:
    vertices, triangles = solids.lying([solids.torus(), solids.channel(), solids.overlapping()][seed], seed)
    cut = decompose(solid(vertices, triangles), 0.001, 8)
    assert len(cut.parts) > 3
    pieces = pieces_tree(vertices, triangles, cut).corners
    assert {row.tobytes() for row in pieces} == {row.tobytes() for row in pieces_tree(vertices, triangles).corners}


def test_triangles_beyond_a_plane_are_left_out() -> None:
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(500, 3, 3))
    normals = rng.normal(size=(6, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    planes = np.column_stack([normals, np.full(6, 0.4)])
    kept = np.empty(500, np.bool_)
    not_beyond(corners.reshape(-1, 3), planes, 1e-6, kept)
    beyond = corners @ normals.T > 0.4 + 1e-6
    np.testing.assert_array_equal(kept, ~beyond.all(axis=1).any(axis=1))
    assert 0 < kept.sum() < 500


def test_points_of_a_piece_are_corners_of_its_triangles_and_reach_as_far() -> None:
    vertices, triangles, cut = ring()
    tree = pieces_tree(vertices, triangles, cut)
    held = []
    for piece in tree.pieces.tolist():
        points, waiting, corners = spread_points(tree, piece), [piece], []
        while waiting:
            left, right, triangle = tree.links[waiting.pop()]
            if left < 0:
                corners.append(tree.corners[triangle])
            else:
                waiting += [left, right]
        own = np.concatenate(corners)
        assert np.linalg.norm(own[:, None] - points, axis=2).min(axis=0).max() == 0.0
        np.testing.assert_array_equal(points.min(axis=0), own.min(axis=0))
        np.testing.assert_array_equal(points.max(axis=0), own.max(axis=0))
        assert len(points) <= SPREAD_POINTS
        held.append(len(corners))
    assert sum(held) == len(tree.corners)


@pytest.mark.parametrize("count", [1, 2, 5, 6, 21, 43, 200, 1001])
def test_clusters_are_as_many_as_were_counted(count: int) -> None:
    tree = triangle_tree(np.random.default_rng(count).normal(size=(count, 3, 3)))
    assert cluster_counts(count) == [len(nodes) for nodes, _ in tree.clusters]
    assert (tree.links[:, 0] >= 0).sum() == count - 1


@pytest.mark.parametrize("count", [1, 85, 86, 171, 1001, 2048, 2049, 5000])
def test_nodes_that_may_get_a_box_are_told_with_all_that_is_below(count: int) -> None:
    triangles, told = np.random.default_rng(count).normal(size=(count, 3, 3)), list[Cluster]()
    balls, links = np.empty((2 * count - 1, 4)), np.empty((2 * count - 1, 3), np.int64)
    tree_written(triangles, balls, links, told.append)
    assert boxed_count(count) == sum(len(nodes) for nodes, _ in told)
    for nodes, members in told:
        for node, row in zip(nodes.tolist(), members, strict=True):
            waiting, below = [node], set[int]()
            while waiting:
                left, right, triangle = links[waiting.pop()].tolist()
                below.update([triangle] if left < 0 else [])
                waiting += [] if left < 0 else [left, right]
            assert set(row.tolist()) == below
            assert CLUSTERS[-1] < len(below) <= BOXED
