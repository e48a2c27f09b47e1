"""The parts of an obstacle, made on demand by its recipe: charges, and triangles judged, in solids, as Coal trees.

Large surfaces are trees of patches, which the narrow phase asks one by one (`collision/narrow_phase.py`). Facts of a
large mesh (closed, convex, crossing itself), its cleaned surface and the order of its patches are cached on disk by the
hash of what was declared, and of this code: no old ones are read. Names and types of these arrays are read again in
`_restore` and `_LargeMesh.surface`. `crop.py` makes cropped surfaces. `PATCH` is time, and the points told in contact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from guidefield.geometry.cache import Allocate, Arrays, allocate_in_memory, find_or_compute, is_large, make_in_place
from guidefield.geometry.charged import field_tables
from guidefield.geometry.closed import drop_unused, find_connected, numbered_edges, volumes
from guidefield.geometry.convex import bvh, convex_hull
from guidefield.geometry.curve_order import curve_order
from guidefield.geometry.distance_bodies import Triangulated
from guidefield.geometry.mesh_surface import (
    MeshSurface,
    crossing_warnings,
    has_area,
    hull_shape,
    join_mesh,
    surface_of,
)
from guidefield.geometry.surfaces import box_about, extents
from guidefield.kernels.distance.triangle_rows import corner_sums, runs_of_triangles
from guidefield.kernels.field.field import field_at_points
from guidefield.memo import memoized
from guidefield.messages.scene import Points, Triangles
from guidefield.parallel import run_parallel
from guidefield.scene.obstacle_message import corners_in, count_of, points_in

PATCH = 8192  # most triangles in one tree, which Coal builds in some hundredths of a second

Whole = Callable[[], tuple[np.ndarray, np.ndarray]]
"""Makes the vertices (v, 3) [m] and triangles (t, 3) of a surface; not before they are needed."""


@dataclass(frozen=True, eq=False)
class Charges:
    """The charges of an obstacle, in rows, in the world [m].

    Triangles (n, 3, 3) and flat convex quads (n, 4, 3); spheres: centre, radius; capsules: both ends of the axis,
    radius; planes: unit normal, offset; boxes: centre, unit axes, full sizes; cloud: points, the area that each stands
    for [m^2], its softening length.
    """

    triangles: np.ndarray = field(default_factory=lambda: np.empty((0, 3, 3)))
    spheres: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))
    capsules: np.ndarray = field(default_factory=lambda: np.empty((0, 7)))
    planes: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))
    quads: np.ndarray = field(default_factory=lambda: np.empty((0, 4, 3)))
    boxes: np.ndarray = field(default_factory=lambda: np.empty((0, 15)))
    cloud: np.ndarray = field(default_factory=lambda: np.empty((0, 5)))


class Recipe(NamedTuple):
    """The makers of an obstacle's parts."""

    # makes, of its message, Coal geometry in its own frame, and ``T_world_shape``, a pinocchio.SE3
    body: Callable[[Any], tuple[Any, Any]]
    # makes, of its message, a triangulation in its own frame, vertices (v, 3) [m] and triangles (t, 3)
    surface: Callable[[Any], tuple[np.ndarray, np.ndarray]]
    charged: Callable[[Any, Any], Charges]  # makes, of its message and ``T_world_shape``, its share of the field
    solid: bool = True
    convex: bool = True  # true if Coal judges it as one convex body: distances are signed then
    facets: Facets | None = None  # the triangles that Coal judges; None for a convex body
    placement: Any | None = None  # ``T_world_shape``, if it is known before the body is made
    extent: float | None = None  # largest extent along an axis of its own frame [m], if it is declared by points
    content: bytes = b""  # hash of the geometry of a large mesh or cloud, whose results are kept on disk; else empty


class Facets:
    """Triangles that Coal judges as a surface, in the obstacle's own frame, of which at first only the number is known.

    `made` makes vertices (v, 3) [m], each used, and triangles (t, 3) on demand. By the hash `content` patches are kept.
    """

    def __init__(self, count: int, made: Whole, content: bytes = b"", box: np.ndarray | None = None) -> None:
        self.count, self._made, self._content = count, made, content
        if box is not None:
            vars(self)["box"] = box

    @cached_property
    def box(self) -> np.ndarray:
        """Lower and upper corner of the box about them, shape (2, 3) [m, own frame]."""
        return box_about(self._made()[0])

    @property
    def whole(self) -> Any:
        """All of them as one Coal tree."""
        return _tree(self)

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Return their vertices (v, 3) [m] and the triangles (t, 3)."""
        return self._made()

    @cached_property
    def patches(self) -> Patches | None:
        """Trees of neighbours; None where one tree is no more than `PATCH`."""
        return Patches(self._made, self._content) if self.count > PATCH else None


@memoized
def _tree(facets: Facets) -> Any:
    return bvh(*facets.surface())


class Patches:
    """Triangles as trees of at most `PATCH` neighbours, made on first use; with a hash their order is on disk."""

    def __init__(self, surface: Whole, content: bytes = b"") -> None:
        self._make = surface

        def write(allocate: Allocate) -> Arrays:
            return _write_patches(*self._surface, allocate)

        known = {"content": np.frombuffer(content, np.uint8), "patch": np.array(PATCH)}
        made = make_in_place("patches", known, write) if content else write(allocate_in_memory)
        self._triangles, (self._low, self._high) = made["triangles"], np.split(made["boxes"], 2, axis=1)
        self._shapes: dict[int, Any] = {}

    @cached_property
    def _surface(self) -> tuple[np.ndarray, np.ndarray]:
        return self._make()

    def __len__(self) -> int:
        return len(self._low)

    def apart(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return distances (k,) of the patches' boxes from one with these corners [m]: lower bounds."""
        gaps = np.maximum(0.0, np.maximum(self._low - high, low - self._high))
        found: np.ndarray = np.sqrt((gaps * gaps).sum(axis=1))
        return found

    def shape(self, index: int) -> Any:
        """Return a patch as a Coal tree, in the obstacle's own frame."""
        if index not in self._shapes:
            corners = self._triangles[index * PATCH : (index + 1) * PATCH]
            used, local = np.unique(corners, return_inverse=True)
            self._shapes[index] = bvh(self._surface[0][used], local.reshape(-1, 3))
        return self._shapes[index]

    def nearest_first(self, low: np.ndarray, high: np.ndarray) -> Iterator[tuple[float, int]]:
        """Yield distance [m] and index of each patch, by its box's distance from a box with these corners, (3,)."""
        apart = self.apart(low, high)
        for index in np.argsort(apart, kind="stable").tolist():
            yield float(apart[index]), index


def _write_patches(vertices: np.ndarray, triangles: np.ndarray, allocate: Allocate) -> Arrays:
    vertices, triangles = np.ascontiguousarray(vertices, float), np.ascontiguousarray(triangles, np.int64)
    made = allocate({"triangles": ("<i4", triangles.shape), "boxes": ("<f8", (-(-len(triangles) // PATCH), 6))})
    sums = np.empty((len(triangles), 3))
    corner_sums(vertices, triangles, sums)
    runs_of_triangles(vertices, triangles, curve_order(sums), PATCH, made["triangles"], made["boxes"])
    return made


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
        surface = _judge_surface(points_in(points), corners_in(corners))
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
        return _judge_surface(points_in(self._points), corners_in(self._corners))

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


def _judge_surface(vertices: np.ndarray, triangles: np.ndarray) -> MeshSurface | None:
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
        around = (k for k, solid in enumerate(solids) if _winding_about(vertices[solid], inside) > 0.5)
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


def _winding_about(corners: np.ndarray, point: np.ndarray) -> float:
    return float(field_at_points(field_tables(triangles=corners), point).winding[0])
