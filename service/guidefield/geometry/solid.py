"""The body that a surface of triangles bounds, and how deep a point is in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from guidefield.geometry.cache import in_memory
from guidefield.geometry.closed import (
    WIDEST_CRACK,
    closing_lids,
    compact,
    crack_lids,
    find_connected,
    seams,
    volume,
    volumes,
)
from guidefield.geometry.surface_rows import NO_TRIANGLES, are_wide, surfaces_in, write_surfaces
from guidefield.geometry.surfaces import Floats, Integers, Surface, surface
from guidefield.kernels.cover.inscribed import depths_at, distances_at, largest_distance
from guidefield.kernels.distance.ray_winding import windings_at
from guidefield.kernels.distance.triangle_distance import SurfaceTables

MOST_SOLIDS = 64
"""Of more solids all but the largest count as one, in which depths are then less: every look goes through each."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A body: the union of the solids that closed pieces of a surface bound; of an open surface, the surface alone."""

    surface: Surface  # distinct vertices; the triangles, those of one solid together, counter-clockwise from outside
    owners: Integers  # for each triangle, which solid's it is, shape (t,)
    lids: int  # how many triangles close gaps
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
    """Triangles that close the surface, and the largest extent of a gap [m]; one no wider than a crack has none."""
    joined, _ = seams(vertices, triangles, min(widest_gap, WIDEST_CRACK))
    thin = crack_lids(triangles, joined)
    lids, widest = closing_lids(vertices, np.concatenate([triangles, thin]))
    return np.concatenate([thin, lids]), widest


def _solids(vertices: Floats, triangles: Integers) -> tuple[Integers, Integers]:
    """Triangles, those of a solid counter-clockwise from outside, and for each the solid it belongs to."""
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
        point = np.ascontiguousarray(self._vertices[self._pieces[piece][0]].mean(axis=0)[None])
        winding = np.empty(1, np.int64)
        for solid in self._solids[boxed].tolist():
            if solid not in self._tables:
                own = self._pieces[solid]
                wide = are_wide(self._vertices, own).any()
                owners = np.zeros(len(own), np.int64)
                self._tables[solid] = surface_tables(self._vertices, own, owners) if wide else None
            tables = self._tables[solid]
            if tables is not None:
                windings_at(point, tables[0], tuple(tables[1][0].tolist()), winding)
                if winding[0] > 0:
                    return int(solid)
        return None


def surface_tables(vertices: Floats, triangles: Integers, owners: Integers) -> tuple[SurfaceTables, Integers]:
    """Return triangles (t, 3) of some area as tables, a tree for each owner (t,), and the trees' places (k, 4)."""
    wide = are_wide(vertices, triangles)
    triangles, owners = triangles[wide], owners[wide]
    each = np.split(triangles[np.argsort(owners, kind="stable")], np.cumsum(np.unique_counts(owners).counts)[:-1])
    made = write_surfaces([(vertices, own, NO_TRIANGLES) for own in each], in_memory)
    counts = np.array([(len(one.tables.nodes), len(one.tables.corners)) for one in surfaces_in(made)])
    first = np.cumsum(counts, axis=0) - counts
    spans = np.column_stack([first[:, 0], (counts[:, 0] + 1) // 2, first[:, 1], counts[:, 1]])
    tables = SurfaceTables(made["nodes"], made["corners"], made["normals"])
    for array in (*tables, spans):
        array.setflags(write=False)
    return tables, spans


TOLERANCE = 1e-4
"""How much too large a stand-off may be given [m], for each metre that the surface extends and for one at least."""


def stand_off(
    around: Surface, body: Solid, enough: float = np.inf, tolerance: float = TOLERANCE, share: float = 0.0
) -> float:
    """Return the largest distance of points of a surface from a body [m], never too small.

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
