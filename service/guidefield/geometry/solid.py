"""The body that a surface of triangles bounds, the depth of points in it, and a cache in memory of meshes' solids.

Covers, inscribed balls and convex parts of links are certain as far as `Solid.depths` is: never too large, and a
surface without a closed piece has no inside. `CELL`, `FINE` and `WORTH` decide when a simpler surface replaces a fine
mesh; by how much at most is its `reach`, which every user adds to its margin.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from guidefield.geometry.cache import allocate_in_memory
from guidefield.geometry.closed import (
    WIDEST_CRACK,
    boundary,
    closing_lids,
    compact,
    crack_lids,
    crossings,
    find_connected,
    merged_points,
    seams,
    volume,
    volumes,
)
from guidefield.geometry.distance_bodies import NO_TRIANGLES, are_wide, surfaces_in, write_surfaces
from guidefield.geometry.surfaces import Floats, Integers, Surface, surface
from guidefield.kernels.cover.inscribed import depths_at, distances_at, largest_distance
from guidefield.kernels.distance.triangle_distance import SurfaceTables
from guidefield.kernels.distance.winding import ray_winding
from guidefield.memory import BYTES_PER_SOLID_FACE, SOLIDS, BoundedMap, content_key


@dataclass(frozen=True)
class Nested:
    """The triangles (k,) of a surface that are in none of its inner pieces; number and volume [m^3] of these pieces."""

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


def fill_hollows(body: Solid) -> Solid:
    """Return a body with its sealed hollows filled: inner walls stay, but depths and distances are as of the outside.

    A cover of it contains the body, and has fewer balls, for walls may be thin.
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
WORTH = 0.5  # most of a mesh's triangles, as a share, that may be left


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
    """Return `fill_hollows` of the near solid of a mesh, from the cache if it is there."""

    def fill() -> Solid:
        return fill_hollows(near_solid_of_mesh(vertices, triangles, widest_gap))

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


MOST_SOLIDS = 64
"""Of more solids all but the largest count as one, whose depths may be too small: queries go through each solid."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A body: the union of the solids that closed pieces of a surface bound; of an open surface, the surface alone."""

    surface: Surface  # distinct vertices; the triangles, those of one solid together, counter-clockwise from outside
    owners: Integers  # for each triangle, which solid's it is, shape (t,)
    lids: int  # how many of the triangles close gaps
    closed: bool  # whether it has an inside
    tables: SurfaceTables  # the triangles with an area as the distance kernels read them
    spans: Integers  # where the tree of each solid stands in the tables, shape (k, 4)
    # how far points of a finer mesh that it represents are from it, and the other way round, at most [m]
    reach: float = 0.0

    @cached_property
    def area(self) -> float:
        """Area of the surface [m^2]."""
        return self.surface.area

    def depths(self, points: Floats) -> Floats:
        """Return the radius of a ball about each point (n, 3) in the body, or minus its distance outside, (n,) [m].

        Where solids overlap, a larger ball may be within their union.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        depths = np.empty(len(points))
        if self.closed:
            depths_at(points, self.tables, self.spans, depths)
            return depths
        return -self.distances(points)

    def distances(self, points: Floats) -> Floats:
        """Return distances of points (n, 3) from the surface, from inside or outside, shape (n,) [m]."""
        distances = np.empty(len(points))
        distances_at(np.ascontiguousarray(points, dtype=np.float64), self.tables, self.spans, distances)
        return distances


def solid(vertices: Floats, triangles: Integers, widest_gap: float = 0.0) -> Solid:
    """Build the body that triangles (t, 3) of vertices (v, 3) bound; vertices at one place become one.

    A surface is closed if every edge is run through as often in one direction as in the other. Gaps of an extent up to
    `widest_gap` [m] are closed by lids, and so are cracks between corners that should be one. A piece that encloses a
    negative volume is a hollow of the solid that it lies in; in none, it is inside out, and turned back.

    Raises:
        ValueError: if there is no triangle with an area, or a vertex is not finite.
    """
    vertices, triangles, _ = compact(vertices, triangles)
    if not are_wide(vertices, triangles).any():
        raise ValueError("a surface needs a triangle with an area")
    lids, widest = _lids(vertices, triangles, widest_gap)
    closed = widest <= widest_gap
    owners = np.zeros(len(triangles), np.int64)
    if closed:
        triangles, owners = _solids(vertices, np.concatenate([triangles, lids]))
        order = np.argsort(owners, kind="stable")
        triangles, owners = triangles[order], owners[order]
    owners.setflags(write=False)
    tables, spans = surface_tables(vertices, triangles, owners)
    return Solid(surface(vertices, triangles), owners, len(lids) if closed else 0, closed, tables, spans)


def _lids(vertices: Floats, triangles: Integers, widest_gap: float) -> tuple[Integers, float]:
    """Return triangles that close the surface, and the largest extent of a gap [m]; cracks have none."""
    joined, _ = seams(vertices, triangles, min(widest_gap, WIDEST_CRACK))
    thin = crack_lids(triangles, joined)
    lids, widest = closing_lids(vertices, np.concatenate([triangles, thin]))
    return np.concatenate([thin, lids]), widest


def _solids(vertices: Floats, triangles: Integers) -> tuple[Integers, Integers]:
    """Return the triangles, those of a solid counter-clockwise from outside, and for each the solid it belongs to."""
    if volume(vertices, triangles) < 0.0:
        triangles = triangles[:, ::-1]
    _, piece = np.unique(find_connected(len(vertices), triangles)[triangles[:, 0]], return_inverse=True)
    piece = piece.reshape(-1)
    members = np.split(np.argsort(piece, kind="stable"), np.cumsum(np.bincount(piece))[:-1])
    enclosed = volumes(vertices, [triangles[own] for own in members])
    owner = np.arange(len(members))
    around = _Around(vertices, [triangles[own] for own in members], np.array(enclosed))
    for k in np.flatnonzero(np.array(enclosed) < 0.0).tolist():
        holding = around(k)
        if holding is not None:
            owner[k] = holding
        else:
            triangles[members[k]] = triangles[members[k]][:, ::-1]
    distinct = np.unique(owner)
    if len(distinct) > MOST_SOLIDS:  # by their volumes; the union of the small ones winds about what any of them does
        small = distinct[np.argsort(-np.abs(np.array(enclosed))[distinct], kind="stable")[MOST_SOLIDS - 1 :]]
        owner[np.isin(owner, small)] = small[0]
    _, owners = np.unique(owner[piece], return_inverse=True)
    return np.ascontiguousarray(triangles), owners.reshape(-1).astype(np.int64)


class _Around:
    """Finds the smallest solid that a piece of a closed surface, which crosses none, lies within."""

    def __init__(self, vertices: Floats, pieces: list[Integers], volumes: Floats) -> None:
        self._vertices, self._pieces = vertices, pieces
        corners = [vertices[piece].reshape(-1, 3) for piece in pieces]
        self._low = np.array([own.min(axis=0) for own in corners])
        self._high = np.array([own.max(axis=0) for own in corners])
        self._solids = np.array([k for k in np.argsort(volumes, kind="stable") if volumes[k] > 0.0], np.int64)
        self._tables: dict[int, tuple[SurfaceTables, Integers] | None] = {}

    def __call__(self, piece: int) -> int | None:
        low, high = self._low[self._solids], self._high[self._solids]
        boxed = ((low <= self._low[piece]) & (high >= self._high[piece])).all(axis=1)
        x, y, z = self._vertices[self._pieces[piece][0]].mean(axis=0).tolist()
        for solid in self._solids[boxed].tolist():
            if solid not in self._tables:
                own = self._pieces[solid]
                wide = are_wide(self._vertices, own).any()
                owners = np.zeros(len(own), np.int64)
                self._tables[solid] = surface_tables(self._vertices, own, owners) if wide else None
            tables = self._tables[solid]
            if tables is not None and ray_winding(x, y, z, tables[0], tuple(tables[1][0].tolist())) > 0:
                return int(solid)
        return None


def surface_tables(vertices: Floats, triangles: Integers, owners: Integers) -> tuple[SurfaceTables, Integers]:
    """Return triangles (t, 3) of some area as tables, a tree for each owner (t,), and the trees' places (k, 4)."""
    wide = are_wide(vertices, triangles)
    triangles, owners = triangles[wide], owners[wide]
    each = np.split(triangles[np.argsort(owners, kind="stable")], np.cumsum(np.unique_counts(owners).counts)[:-1])
    made = write_surfaces([(vertices, own, NO_TRIANGLES) for own in each], allocate_in_memory)
    counts = np.array([(len(one.tables.nodes), len(one.tables.corners)) for one in surfaces_in(made)])
    first = np.cumsum(counts, axis=0) - counts
    spans = np.column_stack([first[:, 0], (counts[:, 0] + 1) // 2, first[:, 1], counts[:, 1]])
    tables = SurfaceTables(made["nodes"], made["corners"], made["normals"])
    for array in (*tables, spans):
        array.setflags(write=False)
    return tables, spans


TOLERANCE = 1e-4  # how much too large a stand-off may be given, as a share of the surface's extent, of 1 m at least
"""With more, fewer meshes of links are judged by their hulls (robot/model/collision_shapes.py)."""


def stand_off(
    around: Surface, body: Solid, enough: float = np.inf, tolerance: float = TOLERANCE, share: float = 0.0
) -> float:
    """Return the largest distance of points of a surface from a body (one-sided Hausdorff) [m], never too small.

    What is inside of a closed body is at no distance. The surface alone counts: what it encloses can't be reached from
    outside but through an opening about as narrow.

    Args:
        around: A surface about the body or a part of it, its hull for example.
        enough: A stand-off beyond this [m] is not measured further.
        tolerance: How much too large it may be given, as `TOLERANCE`.
        share: How much too large it may be given as a share of it, where that is more.
    """
    triangles = np.ascontiguousarray(around.corners.reshape(-1, 9))
    extent = float(np.ptp(around.vertices, axis=0).max())
    allowed = tolerance * max(1.0, extent)
    return float(largest_distance(triangles, body.tables, body.spans, body.closed, allowed, share, enough))
