"""Shapes as the bodies that the distance kernels read, and triangles in the order of their tree.

Kinds, sizes and the order of the tables (half-spaces first) are those of kernels/distance/distance.py; boxes may be
larger than their bodies, never smaller. Scenes (`scene/distance_tables.py`) and links' charges build on these rows.

Columns and the tree's form are those of kernels/distance/triangle_distance.py. The order (Morton's curve) is time, and
chooses among faces that are equally near; the sign of a distance rests on the pseudonormals, which need a face's
neighbours in the whole surface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import coal
import numpy as np
from numpy.typing import NDArray

from guidefield.geometry.cache import Allocate, Arrays, allocate_in_memory
from guidefield.geometry.closed import numbered_edges
from guidefield.geometry.curve_order import along_curve
from guidefield.geometry.mesh_surface import SolidBox
from guidefield.geometry.surfaces import box_about, perpendicular_axes
from guidefield.kernels.distance.bvh import boxes_of_pairs
from guidefield.kernels.distance.distance import BOX, CAPSULE, CLOUD, CYLINDER, HALF_SPACE, SHEET, DistanceTables
from guidefield.kernels.distance.triangle_distance import LEAF, SurfaceTables
from guidefield.kernels.distance.triangle_rows import (
    corners_and_edges,
    flat_frames,
    small_surfaces,
    summed_normals,
    triangle_boxes,
    wide_triangles,
)
from guidefield.kernels.distance.winding import ANCHOR

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def write_pseudonormals(vertices: Floats, triangles: Integers, order: Integers, normals_out: Floats) -> None:
    """Write unit pseudonormals of face, edges ab, bc, ca, and corners a, b, c of some triangles (n,), shape (n, 21).

    That of an edge is the sum of the normals of its faces; that of a corner the sum of those of its faces, each
    weighted by its angle there. Where they cancel it is zero. Triangles (t, 3) run counter-clockwise from outside.
    """
    edges, count = numbered_edges(triangles)
    vertices, triangles = np.ascontiguousarray(vertices, float), np.ascontiguousarray(triangles, np.int64)
    summed_normals(vertices, triangles, edges, count, order, normals_out)


def node_count(boxes: int) -> int:
    """Count the nodes of a complete binary tree: node i has children 2 i + 1 and 2 i + 2, a leaf `LEAF` boxes."""
    leaves = 1
    while leaves * LEAF < boxes:
        leaves *= 2
    return 2 * leaves - 1


def box_nodes(boxes: Floats) -> Floats:
    """Build the nodes of a tree over ordered boxes (n, 6), n >= 1; empty ones are from plus to minus infinity."""
    nodes = np.empty((node_count(len(boxes)), 6))
    boxes_of_pairs(np.ascontiguousarray(boxes), LEAF, nodes)
    return nodes


Triangulated = tuple[Floats, Integers, Integers]
"""Vertices (v, 3) [m]; triangles (t, 3) that count; others (n, 3) around them, for pseudonormals alone."""

NO_TRIANGLES = np.empty((0, 3), np.int64)
_THIN = 1e-12
"""A triangle with less area than this share of its longest edge squared is left out, as its neighbours' edges cover it:
distances may be off by its height."""


class SurfaceRows(NamedTuple):
    """A surface's box, lower then upper corner, shape (6,) [m], and its tree and triangles."""

    bounds: Floats
    tables: SurfaceTables


class FewTriangles(NamedTuple):
    """Surfaces of few triangles, one behind the other."""

    vertices: Floats  # shape (v, 3) [m]
    triangles: Integers  # indices among the vertices of their own surface, shape (t, 3); each has an area
    starts: Integers  # the first vertex, triangle and node of each surface, then the numbers of all, shape (n + 1, 3)

    def axes(self) -> Floats:
        """Return axes in which the box about each is as thin as it is, if it is flat; columns, shape (n, 3, 3)."""
        found = np.empty((len(self.starts) - 1, 3, 3))
        flat_frames(*self, found)
        return found

    def along(self, axes: Floats) -> FewTriangles:
        """Return the surfaces in other axes, columns of shape (n, 3, 3)."""
        owners = np.repeat(np.arange(len(axes)), np.diff(self.starts[:, 0]))
        return self._replace(vertices=np.einsum("vi,vij->vj", self.vertices, axes[owners]))

    def rows(self) -> list[SurfaceRows]:
        """Return the rows of each, read-only."""
        count, (_, triangles, nodes) = len(self.starts) - 1, self.starts[-1]
        shapes = (count, 6), (nodes, 6), (triangles, 9), (triangles, 21)
        bounds, boxes, corners, normals = made = tuple(np.empty(shape) for shape in shapes)
        small_surfaces(*self, *made)
        for array in made:
            array.setflags(write=False)
        found = []
        for bound, (_, first, node), (_, end, last) in zip(
            bounds, self.starts[:-1].tolist(), self.starts[1:].tolist(), strict=True
        ):
            found.append(SurfaceRows(bound, SurfaceTables(boxes[node:last], corners[first:end], normals[first:end])))
        return found


def few_surfaces(surfaces: Sequence[tuple[Floats, Integers]]) -> FewTriangles:
    """Put surfaces, (v, 3) [m] and (t, 3), one behind the other, without triangles that have no area."""
    vertices = np.concatenate([np.empty((0, 3)), *(vertices for vertices, _ in surfaces)])
    triangles = np.concatenate([np.empty((0, 3), np.int64), *(triangles for _, triangles in surfaces)])
    sizes = np.array([(len(vertices), len(triangles)) for vertices, triangles in surfaces]).reshape(-1, 2)
    first, owners = np.cumsum(sizes[:, 0]) - sizes[:, 0], np.repeat(np.arange(len(sizes)), sizes[:, 1])
    wide = are_wide(vertices, triangles + first[owners, None])
    counts = np.bincount(owners[wide], minlength=len(sizes))
    each = np.column_stack([sizes[:, 0], counts, [node_count(count) for count in counts.tolist()]])
    starts = np.concatenate([np.zeros((1, 3), np.int64), np.cumsum(each, axis=0)])
    return FewTriangles(vertices, np.ascontiguousarray(triangles[wide]), starts)


def surface_rows(part: Triangulated) -> SurfaceRows:
    """Return the rows of a surface, read-only; at least one of its triangles has an area."""
    made = write_surfaces([part], allocate_in_memory)
    for array in made.values():
        array.setflags(write=False)
    return surfaces_in(made)[0]


def write_surfaces(parts: Sequence[Triangulated], allocate: Allocate) -> dict[str, np.ndarray]:
    """Write the rows of surfaces, each of some area, in arrays that are allocated, where `surfaces_in` finds them."""
    wide = [_wide(part) for part in parts]
    counts = np.array([len(triangles) for _, triangles, _ in wide])
    nodes, triangles = sum(map(node_count, counts.tolist())), int(counts.sum())
    shapes = {"nodes": (nodes, 6), "corners": (triangles, 9), "normals": (triangles, 21), "bounds": (len(parts), 6)}
    made = allocate({"counts": ("<i8", counts.shape), **{name: ("<f8", shape) for name, shape in shapes.items()}})
    made["counts"][:] = counts
    for part, rows in zip(wide, surfaces_in(made), strict=True):
        _write(part, rows)
    return made


def surfaces_in(arrays: Arrays) -> list[SurfaceRows]:
    """Return the surfaces whose rows `write_surfaces` wrote in arrays, in the same memory."""
    found, node, triangle = list[SurfaceRows](), 0, 0
    for bounds, count in zip(arrays["bounds"], arrays["counts"].tolist(), strict=True):
        nodes = arrays["nodes"][node : node + node_count(count)]
        corners, normals = (arrays[name][triangle : triangle + count] for name in ("corners", "normals"))
        found.append(SurfaceRows(bounds, SurfaceTables(nodes, corners, normals)))
        node, triangle = node + len(nodes), triangle + count
    return found


def are_wide(vertices: Floats, triangles: Integers) -> np.ndarray:
    """Return which triangles have an area, shape (t,)."""
    wide = np.empty(len(triangles), bool)
    vertices, triangles = np.ascontiguousarray(vertices, float), np.ascontiguousarray(triangles, np.int64)
    wide_triangles(vertices, triangles, _THIN, wide)
    return wide


def _wide(part: Triangulated) -> Triangulated:
    vertices, triangles, neighbours = part
    vertices, triangles = np.ascontiguousarray(vertices, float), np.ascontiguousarray(triangles, np.int64)
    wide = are_wide(vertices, triangles)
    others = neighbours[are_wide(vertices, neighbours)] if len(neighbours) else neighbours
    return vertices, triangles if wide.all() else triangles[wide], others


def _write(part: Triangulated, rows: SurfaceRows) -> None:
    vertices, triangles, neighbours = part
    boxes = np.empty((len(triangles), 6))
    triangle_boxes(vertices, triangles, boxes)
    order = along_curve(0.5 * (boxes[:, :3] + boxes[:, 3:])).order
    rows.bounds[:3], rows.bounds[3:] = box_about(boxes[:, :3])[0], box_about(boxes[:, 3:])[1]
    rows.tables.nodes[:] = box_nodes(np.take(boxes, order, axis=0))
    corners_and_edges(vertices, triangles, order, rows.tables.corners)
    all_of_it = np.concatenate([triangles, neighbours]) if len(neighbours) else triangles
    write_pseudonormals(vertices, all_of_it, order, rows.tables.normals)


_IDENTITY = np.eye(3, 4)
_IDENTITY.setflags(write=False)

NO_SURFACE = SurfaceTables(np.empty((0, 6)), np.empty((0, 9)), np.empty((0, 21)))

SMALL_SHEET = 32  # an open surface of at most this many triangles gets axes in which its box is thin (`sheets`)
ROUNDING = 1e-9  # by how much boxes in the world are made larger, so that rounding can't hide a body [m, and a share]


@dataclass(frozen=True, eq=False)
class DistanceBody:
    """One body: a shape in a frame of its own, and where that is."""

    kind: int  # as in kernels/distance/distance.py
    size: tuple[float, float, float]  # of a box its half extents; of a capsule or cylinder radius, half length, 0 [m]
    bounds: Floats  # lower and upper corner of a box about it in its own frame, shape (6,) [m]
    placement: Floats  # rotation and translation of that frame, shape (3, 4) [m]
    surface: SurfaceTables | None = None  # the triangles of a solid or sheet, in its own frame
    cloud: int = 0  # address of the words of its `BatchCloud` (kernels/distance/point_tree.py), if it is a cloud
    # of a cropped solid how its sides are found, in its own frame, see `winding.ANCHOR`; shape (9,)
    anchor: Floats | None = None

    def place(self, rotation: Floats, translation: Floats) -> DistanceBody:
        """Return the body in a frame in which its own is placed by a rotation (3, 3) and a translation (3,) [m]."""
        turned = rotation @ self.placement
        turned[:, 3] += translation
        return replace(self, placement=turned)


def primitive(shape: Any) -> DistanceBody | None:
    """The body of a Coal box, sphere, cylinder, capsule or half-space in its own frame; None for other shapes."""
    build = _PRIMITIVES.get(type(shape))
    return None if build is None else build(shape)


def box_body(box: SolidBox) -> DistanceBody:
    """The body of a solid that is a box."""
    x, y, z = box.halves.tolist()
    return _about_origin(BOX, (x, y, z), (x, y, z)).place(box.rotation, box.centre)


def triangulated_body(
    vertices: Floats, triangles: Integers, kind: int, neighbours: Integers = NO_TRIANGLES
) -> DistanceBody:
    """Make the body of vertices (v, 3) and triangles (t, 3), some with an area; of a cropped solid without an anchor.

    Its kind is SOLID, CROPPED_SOLID or SHEET. Neighbours are further triangles (n, 3) of the whole surface that share a
    vertex with these: they say which side is which at its edges and corners, and nothing else.
    """
    return of_surface(surface_rows((vertices, triangles, neighbours)), kind)


def of_surface(rows: SurfaceRows, kind: int) -> DistanceBody:
    """The body of a surface whose rows are made, SOLID, CROPPED_SOLID or SHEET; without an anchor."""
    return DistanceBody(kind, (0.0, 0.0, 0.0), rows.bounds, _IDENTITY, rows.tables)


def sheets(surfaces: Sequence[tuple[Floats, Integers]], rotations: Floats, translations: Floats) -> BodyRows:
    """Make the bodies of surfaces that are no solids, of at most `SMALL_SHEET` triangles each, all of them together.

    Each has axes in which the box about it is as thin as the surface, if that is flat: the box about a slanted polygon
    along other axes is mostly empty, and would be examined from far away.

    Args:
        surfaces: Vertices (v, 3) [m] and triangles (t, 3) of each, some of them with an area.
        rotations: Of its frame, shape (n, 3, 3).
        translations: Of its frame's origin, shape (n, 3) [m].
    """
    many = few_surfaces(surfaces)
    axes = many.axes()
    rows = many.along(axes).rows()
    count = len(surfaces)
    bounds = np.array([row.bounds for row in rows]).reshape(-1, 6)
    placements = np.concatenate([rotations @ axes, translations[:, :, None]], axis=2)
    return BodyRows(
        kinds=np.full(count, SHEET),
        sizes=np.zeros((count, 3)),
        bounds=bounds,
        placements=placements,
        surfaces={row: surface.tables for row, surface in enumerate(rows)},
        anchors={},
        clouds=np.zeros(count, np.int64),
        boxes=boxes_in_world(placements, bounds),
    )


def balls_about(points: Floats, radius: float, cloud: int) -> DistanceBody:
    """Make the body of balls of a radius [m] about points (n, 3); `cloud` is the lasting address of its tables."""
    low, high = box_about(points)
    bounds = np.r_[low - radius, high + radius]
    return DistanceBody(CLOUD, (0.0, 0.0, 0.0), bounds, _IDENTITY, cloud=cloud)


class BodyRows(NamedTuple):
    """Columns of `DistanceBody` for n bodies; surfaces and anchors by row; boxes as of `boxes_in_world`, (n, 6) [m]."""

    kinds: Integers
    sizes: Floats
    bounds: Floats
    placements: Floats
    surfaces: dict[int, SurfaceTables]
    anchors: dict[int, Floats]
    clouds: Integers
    boxes: Floats

    def reorder(self, order: Integers) -> BodyRows:
        """The rows in another order, indices of shape (n,)."""
        places = {row: place for place, row in enumerate(order.tolist())} if self.surfaces else {}
        return BodyRows(
            surfaces={places[row]: surface for row, surface in self.surfaces.items() if row in places},
            anchors={places[row]: anchor for row, anchor in self.anchors.items() if row in places},
            **{name: np.take(getattr(self, name), order, axis=0) for name in _COLUMNS},
        )


_COLUMNS = ("kinds", "sizes", "bounds", "placements", "clouds", "boxes")
"""Fields of `BodyRows` that are arrays, row by row."""


def body_rows(bodies: Sequence[DistanceBody]) -> BodyRows:
    """Bodies as rows, in their order."""
    bounds = np.array([body.bounds for body in bodies], float).reshape(-1, 6)
    placements = np.array([body.placement for body in bodies], float).reshape(-1, 3, 4)
    return BodyRows(
        np.array([body.kind for body in bodies], np.int64),
        np.array([body.size for body in bodies], float).reshape(-1, 3),
        bounds,
        placements,
        {row: body.surface for row, body in enumerate(bodies) if body.surface is not None},
        {row: body.anchor for row, body in enumerate(bodies) if body.anchor is not None},
        np.array([body.cloud for body in bodies], np.int64),
        boxes_in_world(placements, bounds),
    )


def bodies_in(rows: BodyRows) -> list[DistanceBody]:
    """Return the bodies of rows, as `body_rows` takes them."""
    columns = zip(rows.kinds, rows.sizes, rows.bounds, rows.placements, rows.clouds, strict=True)
    return [
        DistanceBody(int(kind), (x, y, z), bounds, placement, rows.surfaces.get(row), int(cloud), rows.anchors.get(row))
        for row, (kind, (x, y, z), bounds, placement, cloud) in enumerate(columns)
    ]


def join_rows(first: BodyRows, second: BodyRows) -> BodyRows:
    """Rows of bodies, and others behind them."""
    count = len(first.kinds)
    return BodyRows(
        surfaces=first.surfaces | {count + row: surface for row, surface in second.surfaces.items()},
        anchors=first.anchors | {count + row: anchor for row, anchor in second.anchors.items()},
        **{name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in _COLUMNS},
    )


def boxes_in_world(placements: Floats, bounds: Floats) -> Floats:
    """Return boxes (n, 6) [m] along the world's axes about bodies with boxes (n, 6) in frames placed by (n, 3, 4).

    That of a half-space is everything.
    """
    bounds = bounds.copy()
    endless = ~np.isfinite(bounds).all(axis=1)
    bounds[endless] = 0.0
    centres, halves = 0.5 * (bounds[:, :3] + bounds[:, 3:]), 0.5 * (bounds[:, 3:] - bounds[:, :3])
    middles = np.einsum("bij,bj->bi", placements[:, :, :3], centres) + placements[:, :, 3]
    reach = np.einsum("bij,bj->bi", np.abs(placements[:, :, :3]), halves) + ROUNDING * (1.0 + np.abs(middles))
    reach[endless] = np.inf
    return np.hstack([middles - reach, middles + reach])


def body_tables(bodies: BodyRows, owners: Sequence[int] | Integers, nodes: Floats) -> DistanceTables:
    """Make read-only tables of bodies, half-spaces first, and of the tree (m, 6) [m] over the others, or none."""
    surfaces, spans = _surface_tables(bodies.surfaces, len(bodies.kinds))
    anchored = sorted(bodies.anchors)
    spans[anchored, 4] = np.arange(1, len(anchored) + 1)
    tables = DistanceTables(
        kinds=bodies.kinds,
        obstacles=np.array(owners, np.int64),
        placements=bodies.placements,
        sizes=bodies.sizes,
        bounds=bodies.bounds,
        boxes=bodies.boxes,
        spans=spans,
        anchors=np.array([bodies.anchors[row] for row in anchored]).reshape(-1, ANCHOR),
        nodes=nodes,
        surfaces=surfaces,
        clouds=bodies.clouds,
    )
    for array in (*tables[:-2], *surfaces, tables.clouds):
        array.setflags(write=False)
    return tables


def _half_space(shape: Any) -> DistanceBody:
    normal = np.array(shape.n, float)
    bounds = np.array([-np.inf, -np.inf, -np.inf, np.inf, np.inf, 0.0])
    placement = np.column_stack([*perpendicular_axes(normal), normal, float(shape.d) * normal])
    return DistanceBody(HALF_SPACE, (0.0, 0.0, 0.0), bounds, placement)


_PRIMITIVES: dict[type, Callable[[Any], DistanceBody]] = {
    coal.Box: lambda s: _about_origin(BOX, s.halfSide, s.halfSide),
    coal.Sphere: lambda s: _about_origin(CAPSULE, (s.radius, 0.0, 0.0), [s.radius] * 3),
    coal.Cylinder: lambda s: _about_origin(CYLINDER, (s.radius, s.halfLength, 0.0), (s.radius, s.radius, s.halfLength)),
    coal.Capsule: lambda s: _about_origin(
        CAPSULE, (s.radius, s.halfLength, 0.0), (s.radius, s.radius, s.halfLength + s.radius)
    ),
    coal.Halfspace: _half_space,
}


def _about_origin(kind: int, size: Sequence[float], half: Sequence[float]) -> DistanceBody:
    x, y, z = map(float, size)
    return DistanceBody(kind, (x, y, z), np.array([*(-float(one) for one in half), *map(float, half)]), _IDENTITY)


def _surface_tables(surfaces: dict[int, SurfaceTables], count: int) -> tuple[SurfaceTables, Integers]:
    """Join the surfaces of some of n bodies, and say where the tree of each stands, (n, 5); without anchors."""
    spans = np.zeros((count, 5), np.int64)
    node = triangle = 0
    for index, (nodes, corners, _) in sorted(surfaces.items()):
        spans[index, :4] = node, (len(nodes) + 1) // 2, triangle, len(corners)
        node, triangle = node + len(nodes), triangle + len(corners)
    if len(surfaces) == 1:
        return next(iter(surfaces.values())), spans  # of a large one no copy is made
    rows = (NO_SURFACE, *(surface for _, surface in sorted(surfaces.items())))
    return SurfaceTables(*map(np.concatenate, zip(*rows, strict=True))), spans
