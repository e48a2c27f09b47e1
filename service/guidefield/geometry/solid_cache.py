"""A cache of the solids of meshes: the hull, the cover and the convex parts of a mesh are found from the same one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from guidefield.bounded_map import BYTES_PER_SOLID_FACE, SOLIDS, BoundedMap, content_key
from guidefield.geometry.closed import boundary, compact, merged_points
from guidefield.geometry.nested import filled
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


_SOLIDS: BoundedMap[tuple[object, ...], Solid] = BoundedMap(SOLIDS)


def solid_of_mesh(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
    """Return `solid` of these arguments, from the cache if it is there."""
    return _find((content_key(vertices, triangles), widest_gap), lambda: _solid(vertices, triangles, widest_gap))


def near_solid_of_mesh(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
    """Return the `coarse_solid` of a mesh, from the cache if it is there; `solid_of_mesh` if it has none."""

    def build() -> Solid:
        return coarse_solid(vertices, triangles) or solid_of_mesh(vertices, triangles, widest_gap)

    return _find((content_key(vertices, triangles), widest_gap, "near"), build)


def filled_solid_of_mesh(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
    """Return the `filled` near solid of these arguments, from the cache if it is there."""

    def fill() -> Solid:
        return filled(near_solid_of_mesh(vertices, triangles, widest_gap))

    return _find((content_key(vertices, triangles), widest_gap, "filled"), fill)


def clear_solids() -> None:
    """Empty the cache, when all that needs the solids of a robot has been found."""
    _SOLIDS.clear()


def _solid(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
    """Build a solid; one that is closed without its gaps is the same with them."""
    if (
        widest_gap > 0.0
        and (closed := _SOLIDS.get((content_key(vertices, triangles), 0.0))) is not None
        and closed.closed
    ):
        return closed
    return solid(vertices, triangles, widest_gap)


def _find(key: tuple[object, ...], build: Callable[[], Solid]) -> Solid:
    return _SOLIDS.find(key, build, lambda one: BYTES_PER_SOLID_FACE * len(one.owners))
