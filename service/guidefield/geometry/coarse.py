"""The solid of a fine mesh with fewer triangles: what is found with it holds for the mesh, but for a known reach."""

from __future__ import annotations

import dataclasses

import numpy as np

from guidefield.geometry.closed import boundary, compact, merged_points
from guidefield.geometry.solid import Solid, solid
from guidefield.geometry.surfaces import Floats, Integers

CELL = 1e-3
"""Vertices within a cell of a grid of this width are merged [m]."""

FINE = 4000
"""A mesh of fewer triangles is left as it is."""

WORTH = 0.5
"""At most this share of a mesh's triangles has to be left."""


def coarse_solid(vertices: Floats, triangles: Integers) -> Solid | None:
    """Merge the vertices of each cell of a grid in their mean, and build the solid that is bounded then.

    Points of a triangle move no further than its corners do, along straight lines, and edges that cancelled still do.
    So mesh and solid are within `Solid.reach` of each other, and wind equally often about all points further from
    both. Source: J. Rossignac and P. Borrel, "Multi-resolution 3D approximations for rendering complex scenes", 1993.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).

    Returns:
        The solid; None of a mesh that isn't fine or has a gap, or where too many triangles are left.

    Raises:
        ValueError: if a vertex is not finite.
    """
    if len(triangles) < FINE:
        return None
    vertices, triangles, _ = compact(vertices, triangles)
    _, place = merged_points(np.floor(vertices / CELL))
    merged = place[triangles]
    a, b, c = merged.T
    merged = merged[(a != b) & (b != c) & (c != a)]
    if not 0 < len(merged) <= WORTH * len(triangles) or len(boundary(triangles)):
        return None
    counts = np.bincount(place)
    means = np.column_stack([np.bincount(place, axis) / counts for axis in vertices.T])
    try:
        body = solid(means, merged)
    except ValueError:  # nothing with an area is left
        return None
    return dataclasses.replace(body, reach=float(np.linalg.norm(means[place] - vertices, axis=1).max()))
