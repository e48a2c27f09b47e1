"""The surface of a mesh obstacle: judged (closed, convex, crossing itself), divided into solids; a cropped part of it.

Facts of a large mesh, and its cleaned surface, are cached on disk by the hash of what was declared, and of this code:
no old ones are read. Names and types of these arrays are read again in `_restore` and `_LargeMesh.surface`. `crop.py`
makes the parts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from guidefield.geometry.cache import Arrays, find_or_compute, is_large
from guidefield.geometry.charged import field_tables
from guidefield.geometry.closed import drop_unused, find_connected, numbered_edges, volumes
from guidefield.geometry.convex import convex_hull
from guidefield.geometry.distance_bodies import Triangulated
from guidefield.geometry.mesh_surface import (
    MeshSurface,
    crossing_warnings,
    has_area,
    hull_shape,
    join_mesh,
    surface_of,
)
from guidefield.geometry.surfaces import extents
from guidefield.kernels.field.field import field_at_points
from guidefield.messages.scene import Points, Triangles
from guidefield.parallel import run_parallel
from guidefield.scene.obstacle_message import corners_in, count_of, points_in

Whole = Callable[[], tuple[np.ndarray, np.ndarray]]
"""Makes the vertices (v, 3) [m] and triangles (t, 3) of a surface; not before they are needed."""


@dataclass(frozen=True, eq=False)
class JudgedMesh:
    """The facts of a mesh, which for a large one are read from disk without its triangles."""

    count: int  # of triangles
    extent: float  # the largest along an axis [m]
    solid: bool  # this and the next two as `MeshSurface` has them
    hull: Any | None
    warnings: tuple[str, ...]
    surface: Whole  # makes or reads vertices (v, 3) [m] and triangles (t, 3)
    content: bytes = b""  # hash of a large mesh


@dataclass(frozen=True, eq=False)
class CroppedSurface:
    """A part of a surface."""

    # the kept triangles of each of its solids that is near, or of the thin surface, with their neighbours; all of the
    # same vertices
    parts: tuple[Triangulated, ...]
    anchors: np.ndarray  # rows of `winding.ANCHOR` columns for each solid; zeros of one that is kept whole
    box: np.ndarray  # lower and upper corner about all of the surface, shape (2, 3) [m]
    whole: Whole  # make all of the surface, and the triangles of each of its solids
    solids: Callable[[], list[np.ndarray]]
    content: bytes  # the key of the part on disk; empty if it isn't kept there

    @property
    def count(self) -> int:
        """Number of kept triangles."""
        return sum(len(triangles) for _, triangles, _ in self.parts)

    @cached_property
    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices, each used, (v, 3) [m] and triangles (t, 3)."""
        alone = drop_unused(self.parts[0][0], np.concatenate([triangles for _, triangles, _ in self.parts]))
        for array in alone:
            array.setflags(write=False)
        return alone


def judge_mesh(points: Points, corners: Triangles, content: bytes) -> JudgedMesh | None:
    """Judge declared points and triangles as `mesh_surface`, and warn where these cross; None if they have no area.

    The facts of a large mesh are read from disk, by its hash `content`, if it was judged before.
    """
    if not is_large(count_of(corners)):
        surface = _judge(points_in(points), corners_in(corners))
        return None if surface is None else as_judged(surface)
    large = _LargeMesh(points, corners, content)
    return _restore(find_or_compute("mesh", large.known, large.find_facts), lambda: large.surface, content)


class _LargeMesh:
    """A mesh whose surface is kept on disk, and judged at most once."""

    def __init__(self, points: Points, corners: Triangles, content: bytes) -> None:
        self._points, self._corners = points, corners
        self.known = {"content": np.frombuffer(content, np.uint8)}

    @cached_property
    def _judgement(self) -> MeshSurface | None:
        return _judge(points_in(self._points), corners_in(self._corners))

    @cached_property
    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        found = find_or_compute("surface", self.known, lambda: _arrays_of(self._judgement))
        vars(self).pop("_judgement", None)
        return found["vertices"], found["triangles"].astype(np.int64)

    def find_facts(self) -> Arrays:
        made = _facts_of(self._judgement)
        if self._judgement is not None:
            _ = self.surface
        return made


def as_judged(surface: MeshSurface) -> JudgedMesh:
    """Return the facts of a surface that is in memory."""
    whole = surface.vertices, surface.triangles
    extent, count = extent_of(surface.vertices), len(surface.triangles)
    return JudgedMesh(count, extent, surface.solid, surface.hull, surface.warnings, lambda: whole)


def extent_of(points: np.ndarray) -> float:
    """Return the largest extent along an axis of points (n, 3) [m]."""
    return float(extents(points).max())


def _judge(vertices: np.ndarray, triangles: np.ndarray) -> MeshSurface | None:
    mesh = join_mesh(vertices, triangles)
    if not is_large(len(triangles)) or not has_area(mesh.vertices, mesh.triangles):
        surface = surface_of(mesh)
        crossing = () if surface is None or surface.hull is not None else crossing_warnings(mesh)
    else:
        surfaces, warnings = list[MeshSurface | None](), list[tuple[str, ...]]()
        run_parallel(lambda: warnings.append(crossing_warnings(mesh)), lambda: surfaces.append(surface_of(mesh)))
        (surface,), (crossing,) = surfaces, warnings
    if surface is None or surface.hull is not None:
        return surface
    return replace(surface, warnings=(*surface.warnings, *crossing))


def _facts_of(surface: MeshSurface | None) -> Arrays:
    """Return the facts of a surface as arrays; no triangles if there is none."""
    if surface is None:
        return {"count": np.zeros(1, np.int64)}
    return {
        "count": np.array([len(surface.triangles)]),
        "extent": np.array([extent_of(surface.vertices)]),
        "solid": np.array([surface.solid]),
        "convex": np.array([surface.hull is not None]),
        "warnings": np.frombuffer("\n".join(surface.warnings).encode(), np.uint8),
    }


def _arrays_of(surface: MeshSurface | None) -> Arrays:
    assert surface is not None, "what has no area has no surface"
    return {"vertices": surface.vertices, "triangles": surface.triangles.astype(np.int32)}


def _restore(facts: Arrays, surface: Whole, content: bytes) -> JudgedMesh | None:
    count = int(facts["count"][0])
    if count == 0:
        return None
    hull = hull_shape(convex_hull(surface()[0])) if facts["convex"][0] else None
    warnings = tuple(facts["warnings"].tobytes().decode().splitlines())
    return JudgedMesh(count, float(facts["extent"][0]), bool(facts["solid"][0]), hull, warnings, surface, content)


def solids_of(vertices: np.ndarray, triangles: np.ndarray) -> list[np.ndarray]:
    """Return the triangles of each solid: a piece that encloses a volume, with the hollows that lie within it.

    The triangles (t, 3) are of a closed mesh. Solids that touch at corners or along edges are pieces of their own.
    """
    labels = _label_pieces(len(vertices), triangles)
    if (labels == labels[0]).all():
        return [triangles]
    order = np.argsort(labels, kind="stable")
    parts = np.split(triangles[order], np.flatnonzero(np.diff(labels[order])) + 1)
    enclosed = volumes(vertices, parts)
    solids = [parts[index] for index in np.argsort(enclosed, kind="stable").tolist() if enclosed[index] > 0.0]
    hollows = [part for part, within in zip(parts, enclosed, strict=True) if within <= 0.0]
    found: list[list[np.ndarray]] = [[solid] for solid in solids]
    for hollow in hollows:
        inside = vertices[hollow[0]].mean(axis=0)[None]
        around = (k for k, solid in enumerate(solids) if _winding(vertices[solid], inside) > 0.5)
        # a hollow in no piece belongs to the largest
        found[next(around, len(solids) - 1)].append(hollow)
    return [np.concatenate(group) for group in found]


def _label_pieces(count: int, triangles: np.ndarray) -> np.ndarray:
    """Label the triangles of each piece of a closed mesh alike, shape (t,).

    A piece is connected by edges that two triangles share, as vertices and edges of more triangles may be where bodies
    touch. Pieces that aren't closed by themselves stay together with all that they share vertices with.
    """
    numbers, edges = numbered_edges(triangles)
    sides = np.repeat(np.arange(len(triangles)), 3)
    ends = np.empty((edges, 2), np.int64)  # the first and the last triangle at each edge
    ends[numbers[::-1], 0], ends[numbers, 1] = sides[::-1], sides
    of_two = np.bincount(numbers, minlength=edges) == 2
    labels = find_connected(len(triangles), ends[of_two])
    ways = np.where(triangles < np.roll(triangles, -1, axis=1), 1.0, -1.0).ravel()
    is_open = np.bincount(numbers, ways)[numbers] != 0.0  # where a piece has all triangles of an edge
    several = np.flatnonzero(~of_two[numbers])
    _, edge_of_piece = np.unique(labels[sides[several]] * edges + numbers[several], return_inverse=True)
    is_open[several] = np.bincount(edge_of_piece, ways[several])[edge_of_piece] != 0.0
    if not is_open.any():
        return labels
    together = find_connected(count, triangles)[triangles[:, 0]]
    broken = np.isin(together, together[sides[is_open]])
    joined: np.ndarray = np.where(broken, len(triangles) + together, labels)
    return joined


def _winding(corners: np.ndarray, point: np.ndarray) -> float:
    return float(field_at_points(field_tables(triangles=corners), point).winding[0])
