"""Hulls in the place of meshes: what keeps apart from a hull keeps apart from the mesh in it, and is sooner tested."""

from __future__ import annotations

from typing import Any

import coal


def with_hulls(geometry: Any) -> Any:
    """A copy of a Pinocchio geometry model in which each mesh that has a volume is its convex hull."""
    hulls = geometry.copy()
    for body in hulls.geometryObjects:
        body.geometry = _hull(body.geometry)
    return hulls


def _hull(shape: Any) -> Any:
    """The convex hull of a mesh, which keeps it once it is built; any other shape as it is."""
    if not isinstance(shape, coal.BVHModelBase):
        return shape
    if shape.convex is None:
        try:
            shape.buildConvexHull(True, "Qt")
        except RuntimeError:  # a flat mesh has no hull with a volume
            return shape
    return shape.convex
