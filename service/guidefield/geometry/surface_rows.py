"""The triangles of a body as the distance kernels read them, in the order of their tree.

Columns and the tree's form are those of kernels/distance/triangle_distance.py. The order (Morton's curve) is time
alone; the sign of a distance rests on the pseudonormals, which need a face's neighbours in the whole surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from guidefield.geometry.cache import Allocate, Arrays, allocate_in_memory
from guidefield.geometry.closed import numbered_edges
from guidefield.geometry.curve_order import along_curve
from guidefield.geometry.surfaces import box_about
from guidefield.kernels.cover.small_surfaces import flat_frames, small_surfaces
from guidefield.kernels.distance.bvh import boxes_of_pairs
from guidefield.kernels.distance.triangle_distance import LEAF, SurfaceTables
from guidefield.kernels.distance.triangle_rows import corners_and_edges, summed_normals, triangle_boxes, wide_triangles

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
"""A triangle with less area than this share of its longest edge squared is a line: its neighbours' edges cover it."""


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
