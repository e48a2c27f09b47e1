"""Trees of meshes that are cut into convex parts, kept on disk."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.cache import remembered
from guidefield.geometry.convex import hull_planes
from guidefield.geometry.decomposition import Decomposition, Part
from guidefield.geometry.elements import Pieces, bisected
from guidefield.geometry.entries import Arrays
from guidefield.geometry.mesh_tree import CLUSTERS, MeshTree, joined, mesh_tree, polytope_about
from guidefield.kernels.cover.beyond_planes import not_beyond

LONGEST = 0.16
"""Longest edge of a mesh's triangles, as a share of its extent.

With half of it a UR5 has three times the triangles, and connections take as long.
"""

ROUNDING = 1e-6
"""By how much a triangle has to be beyond a part's plane to be left out [m]."""


MOST_PLANES = 64
"""A triangle comes into a part if none of the planes of so many of its faces, the largest, has it beyond."""


def pieces_tree(vertices: np.ndarray, faces: np.ndarray, cut: Decomposition | None = None) -> MeshTree:
    """The tree of a mesh, over its convex parts if it is cut. Long triangles are halved: balls about them are large.

    Args:
        vertices: Shape (v, 3) [m].
        faces: Corners of each triangle, shape (t, 3).
        cut: Convex parts that together contain it.
    """
    whole = Pieces(vertices[faces], np.arange(len(faces)))
    pieces = bisected(whole, LONGEST * float(np.ptp(vertices, axis=0).max()))
    if cut is None:
        return mesh_tree(pieces.corners)
    own = [(_in_part(pieces.corners, part), part) for part in cut.parts]
    trees = [
        mesh_tree(corners, polytope_about(np.asarray(part.hull.vertices)))
        for corners, part in own
        if len(corners)  # a part of the inside only has nothing of the surface
    ]
    return joined(trees, polytope_about(np.asarray(cut.hull.hull.vertices)))


def remembered_tree(vertices: np.ndarray, faces: np.ndarray, cut: Decomposition) -> MeshTree:
    """`pieces_tree` of a mesh that is cut, from disk if it was asked for before."""
    parts = (cut.hull, *cut.parts)
    inputs = {
        "vertices": vertices,
        "faces": faces,
        "hulls": np.concatenate([np.asarray(part.hull.vertices) for part in parts]),
        "counts": np.array([len(part.hull.vertices) for part in parts]),
    }
    return _restored(remembered("tree", inputs, lambda: _stored(pieces_tree(vertices, faces, cut))))


def _in_part(corners: np.ndarray, part: Part) -> np.ndarray:
    """Return the triangles, of some with corners (n, 3, 3), that aren't beyond one of a part's planes."""
    kept = np.empty(len(corners), np.bool_)
    not_beyond(corners.reshape(-1, 3), hull_planes(part.hull, MOST_PLANES), ROUNDING, kept)
    inside: np.ndarray = corners[kept]
    return inside


def _stored(tree: MeshTree) -> Arrays:
    """A tree's arrays, its polytopes one after the other."""
    return {
        "corners": tree.corners,
        "balls": tree.balls,
        "links": tree.links.astype(np.int64),
        "pieces": tree.pieces,
        "hulls": np.concatenate([np.empty((0, 3)), *tree.hulls.values()]),
        "nodes": np.array(list(tree.hulls), np.int64),
        "counts": np.array([len(vertices) for vertices in tree.hulls.values()], np.int64),
        **{f"nodes {most}": nodes for most, (nodes, _) in zip(CLUSTERS, tree.clusters, strict=True)},
        **{f"members {most}": rows for most, (_, rows) in zip(CLUSTERS, tree.clusters, strict=True)},
    }


def _restored(arrays: Arrays) -> MeshTree:
    hulls = np.split(arrays["hulls"], np.cumsum(arrays["counts"])[:-1])
    polytopes = dict(zip(arrays["nodes"].tolist(), hulls, strict=False))
    clusters = tuple((arrays[f"nodes {most}"], arrays[f"members {most}"]) for most in CLUSTERS)
    return MeshTree(arrays["corners"], arrays["balls"], arrays["links"], polytopes, arrays["pieces"], clusters)
