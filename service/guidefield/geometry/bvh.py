"""Triangles as a bounding volume hierarchy of Coal's: what is judged of a mesh, of links and obstacles alike."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np


def bvh(vertices: np.ndarray, triangles: np.ndarray) -> Any:
    """Build a Coal tree of oriented boxes over triangles: surfaces only, no inside.

    Args:
        vertices: Shape (v, 3) [m], in the shape's frame.
        triangles: Indices of vertices, shape (t, 3).
    """
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(len(triangles), len(vertices))
    tree.addVertices(np.ascontiguousarray(vertices, float))
    tree.addTriangles(np.ascontiguousarray(triangles, np.int64))
    tree.endModel()
    tree.computeLocalAABB()
    return tree
