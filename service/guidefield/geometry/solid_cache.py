"""A cache of the solids of meshes, whole, coarse or without what lies within: all is found from the same ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from guidefield.bounded_map import BYTES_PER_SOLID_FACE, SOLIDS, BoundedMap, content_key
from guidefield.geometry.closed import boundary, compact, find_connected, merged_points, volumes
from guidefield.geometry.crossings import crossings
from guidefield.geometry.solid import Solid, solid, surface_tables
from guidefield.geometry.surfaces import Floats, Integers


@dataclass(frozen=True)
class Nested:
    """The triangles (k,) of a surface in none of its inner pieces; number and volume [m^3] of these."""

    outer: Integers
    pieces: int
    volume: float


def find_nested(vertices: Floats, triangles: Integers) -> Nested:
    """Find the connected pieces of a surface, (v, 3) and (t, 3), within a closed piece of it, for certain.

    All vertices of such a piece are inside and no two triangles cross. What is open by the least crack has no inside
    here.
    """
    distinct, corners, given = compact(vertices, triangles)
    _, piece = np.unique(find_connected(len(distinct), corners)[corners[:, 0]], return_inverse=True)
    members = np.split(np.argsort(piece, kind="stable"), np.cumsum(np.bincount(piece))[:-1]) if len(piece) else []
    within = _Within(distinct, [corners[own] for own in members])
    inner = [k for k in range(len(members)) if within(k)]
    kept = np.ones(len(triangles), bool)
    for k in inner:
        kept[given[members[k]]] = False
    enclosed = sum(map(abs, volumes(distinct, [corners[members[k]] for k in inner])))
    return Nested(np.flatnonzero(kept), len(inner), float(enclosed))


class _Within:
    def __init__(self, vertices: Floats, pieces: list[Integers]) -> None:
        self._vertices, self._pieces = vertices, pieces
        corners = [vertices[piece].reshape(-1, 3) for piece in pieces]
        self._low = np.array([own.min(axis=0) for own in corners]).reshape(-1, 3)
        self._high = np.array([own.max(axis=0) for own in corners]).reshape(-1, 3)

    def __call__(self, piece: int) -> bool:
        about = ((self._low < self._low[piece]) & (self._high > self._high[piece])).all(axis=1)
        return any(self._is_around(k, piece) for k in np.flatnonzero(about).tolist())

    def _is_around(self, outer: int, inner: int) -> bool:
        around, within = self._pieces[outer], self._pieces[inner]
        if len(boundary(around)):
            return False
        try:
            body = solid(self._vertices, around)
        except ValueError:  # no triangle of it has an area
            return False
        if not (body.depths(self._vertices[np.unique(within)]) > 0.0).all():
            return False
        corners = self._vertices[around]
        near = (corners.min(axis=1) <= self._high[inner]) & (corners.max(axis=1) >= self._low[inner])
        found = crossings(*compact(self._vertices, np.concatenate([within, around[near.all(axis=1)]]))[:2])
        across = (found.pairs[:, 0] < len(within)) & (found.pairs[:, 1] >= len(within))
        return found.complete and not across.any()


def filled(body: Solid) -> Solid:
    """Return a body without its sealed hollows: inner walls stay, but depths and distances are as of the outside.

    What contains it contains the body, and takes less of it, for walls may be thin.
    """
    if not body.closed:
        return body
    outer = find_nested(body.surface.vertices, body.surface.triangles)
    if not outer.pieces:
        return body
    left = np.unique(body.owners[outer.outer])
    place = np.zeros(body.owners.max() + 1, np.int64)  # what lies within is the first's: any but its own, which is gone
    place[left] = np.arange(len(left))
    owners = place[body.owners]
    owners.setflags(write=False)
    tables, spans = surface_tables(body.surface.vertices, body.surface.triangles[outer.outer], owners[outer.outer])
    return dataclasses.replace(body, owners=owners, tables=tables, spans=spans)


CELL = 1e-3  # vertices within a cell of a grid of this width are merged [m]
FINE = 4000  # a mesh of fewer triangles is left as it is
WORTH = 0.5  # at most this share of a mesh's triangles has to be left


def coarse_solid(vertices: Floats, triangles: Integers) -> Solid | None:
    """Merge the vertices (v, 3) of each cell of a grid in their mean; build the solid of triangles (t, 3) then.

    Points of a triangle move no further than its corners do, along straight lines, and edges that cancelled still do.
    So mesh and solid are within `Solid.reach` of each other, and wind equally often about all points further from both
    (J. Rossignac and P. Borrel, "Multi-resolution 3D approximations for rendering complex scenes", 1993). None of a
    mesh that isn't fine or has a gap, or where too many triangles are left.
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


def fill_solid_of_mesh(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
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
