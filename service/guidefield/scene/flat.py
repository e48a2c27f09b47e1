"""Flat polygons in space: their plane, coordinates in it, and what may be wrong with them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from guidefield.geometry.charged import convex_quads
from guidefield.geometry.surfaces import ears
from guidefield.kernels.distance.triangle_rows import touching_edges_of_each
from guidefield.scene.recipe import Charges

PLANARITY = 1e-6  # how far from their plane the corners of a flat polygon may lie, as a fraction of its size
SMALLEST_AREA = 1e-9  # smallest area of a polygon, as a fraction of its size squared


@dataclass(frozen=True, eq=False)
class FlatPolygon:
    """Corners in the plane that fits them best.

    The plane of corners (k, 3) [m, world] goes through their mean, the origin, with a unit normal about which they turn
    counter-clockwise (as a whole) and two unit axes (2, 3), ``axes[0] x axes[1] = normal``.
    """

    vertices: np.ndarray
    normal: np.ndarray
    origin: np.ndarray
    axes: np.ndarray
    corners: np.ndarray  # the vertices in those axes about the origin, shape (k, 2) [m]
    size: float  # diagonal of the box about the corners [m]
    deviation: float  # largest distance of a corner from the plane [m]
    area: float  # signed sum of the enclosed area [m^2]; positive for a simple polygon

    def from_plane(self, corners: np.ndarray) -> np.ndarray:
        """Points in the world (n, 3) of points (n, 2) in the plane's axes about its origin [m]."""
        points: np.ndarray = self.origin + corners @ self.axes
        return points


class FlatPolygons(NamedTuple):
    """Polygons of the same number of corners, row by row as `FlatPolygon` has them."""

    vertices: np.ndarray
    normals: np.ndarray
    origins: np.ndarray
    axes: np.ndarray
    corners: np.ndarray
    sizes: np.ndarray
    deviations: np.ndarray
    areas: np.ndarray

    def one(self, index: int) -> FlatPolygon:
        """Return one of them."""
        arrays, numbers = self[:5], self[5:]
        return FlatPolygon(*(array[index] for array in arrays), *(float(values[index]) for values in numbers))


def centroid(polygon: np.ndarray) -> np.ndarray:
    """Centroid (2,) of a polygon (k, 2) with an area."""
    after = np.roll(polygon, -1, axis=0)
    cross = polygon[:, 0] * after[:, 1] - polygon[:, 1] * after[:, 0]
    middle: np.ndarray = ((polygon + after) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum())
    return middle


def flat_polygons(vertices: np.ndarray) -> FlatPolygons:
    """Fit planes to polygons, corners in order (n, k, 3) [m, world].

    The normal is Newell's, half the sum of the cross products of successive corners: exact for a flat polygon, convex
    or not, however many corners lie on one line.
    """
    vertices = np.array(vertices, float)
    origins = vertices.mean(axis=1)
    arms = vertices - origins[:, None]
    area_vectors = 0.5 * np.cross(arms, np.roll(arms, -1, axis=1)).sum(axis=1)
    areas = np.linalg.norm(area_vectors, axis=1)
    normals = np.where(areas[:, None] > 0.0, area_vectors, [0.0, 0.0, 1.0])
    normals /= np.where(areas > 0.0, areas, 1.0)[:, None]
    axes = axes_across(normals)
    polygons = FlatPolygons(
        vertices=vertices,
        normals=normals,
        origins=origins,
        axes=axes,
        corners=np.einsum("nki,nji->nkj", arms, axes),
        sizes=np.linalg.norm(np.ptp(vertices, axis=1), axis=1),
        deviations=np.abs(np.einsum("nki,ni->nk", arms, normals)).max(axis=1),
        areas=areas,
    )
    for array in polygons:
        array.setflags(write=False)
    return polygons


def flatness_faults(polygons: FlatPolygons) -> dict[int, str]:
    """Find the reasons why corners aren't those of a flat polygon with an area, by the polygon's index."""
    edges = np.linalg.norm(np.roll(polygons.vertices, -1, axis=1) - polygons.vertices, axis=2)
    sizes, areas, deviations = polygons.sizes, polygons.areas, polygons.deviations
    coinciding = (sizes == 0.0) | (edges.min(axis=1) <= PLANARITY * sizes)
    faulty = coinciding | (areas <= SMALLEST_AREA * sizes**2) | (deviations > PLANARITY * sizes)
    faults = {}
    for index in np.flatnonzero(faulty).tolist():
        size, area, lengths = sizes[index], areas[index], edges[index]
        if coinciding[index]:
            first = int(np.argmin(lengths))
            faults[index] = f"vertices {first} and {(first + 1) % len(lengths)} coincide ({lengths[first]:.3g} m apart)"
        elif area <= SMALLEST_AREA * size**2:
            faults[index] = f"its area is {area:.3g} m^2 at a size of {size:.3g} m: it is a line"
        else:
            faults[index] = (
                f"its vertices lie up to {deviations[index]:.3g} m off a plane,"
                f" at most {PLANARITY * size:.3g} m ({PLANARITY:g} of its size) are allowed"
            )
    return faults


def axes_across(normal: np.ndarray) -> np.ndarray:
    """Return two unit vectors (..., 2, 3) that complete a unit normal (..., 3) to a right-handed frame."""
    seed = (np.abs(normal).argmin(axis=-1)[..., None] == np.arange(3)).astype(float)
    first = np.cross(seed, normal)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(normal, first)], axis=-2)


def crossing_edges(polygons: FlatPolygons) -> dict[int, tuple[int, int]]:
    """Find two edges that touch but aren't neighbours, or fold back on each other, by index of a flat polygon.

    Edge i runs from corner i to corner i + 1. Lengths below `PLANARITY` of the size count as touching. Those that are
    missing are simple.
    """
    start = polygons.corners
    end = np.roll(start, -1, axis=1)
    count = start.shape[1]
    along = (end - start) / np.linalg.norm(end - start, axis=2, keepdims=True)
    cosine = np.einsum("nij,nij->ni", along, np.roll(along, -1, axis=1))
    found = {}
    for index, edge in np.argwhere(cosine < -1.0 + 0.5 * PLANARITY**2)[::-1].tolist():
        found[index] = edge, (edge + 1) % count
    if count > 3:
        boxes = np.concatenate([np.minimum(start, end), np.maximum(start, end)], axis=2)
        touching = np.empty((len(start), 2), np.int64)
        order = np.argsort(boxes[:, :, 0], axis=1)
        touching_edges_of_each(start, boxes, order, PLANARITY * polygons.sizes, touching)
        for index in np.flatnonzero(touching[:, 0] < count).tolist():
            found.setdefault(index, (int(touching[index, 0]), int(touching[index, 1])))
    return found


def are_bulging(corners: np.ndarray) -> np.ndarray:
    """Tell which counter-clockwise outlines (n, k, 2) turn left at every corner, shape (n,)."""
    leaving = np.roll(corners, -1, axis=1) - corners
    arriving = np.roll(leaving, 1, axis=1)
    turns: np.ndarray = (arriving[..., 0] * leaving[..., 1] > arriving[..., 1] * leaving[..., 0]).all(axis=1)
    return turns


@dataclass(frozen=True, eq=False)
class Sheet:
    """A flat, simple polygon.

    Corners (k, 3) [m, world], triangles (t, 3) that turn as these do, the box about it (2, 3), and its share of the
    field for a charge of 1 per area.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    box: np.ndarray
    charges: Charges


def build_sheets(outlines: Sequence[Sequence[Sequence[float]]]) -> list[Sheet | str]:
    """Build sheets from the corners of polygons, or tell the fault of what is none."""
    by_count: dict[int, list[int]] = defaultdict(list)
    for index, outline in enumerate(outlines):
        by_count[len(outline)].append(index)
    built: list[Sheet | str] = [""] * len(outlines)
    for indices in by_count.values():
        polygons = flat_polygons(np.array([outlines[index] for index in indices], float))
        for index, sheet in zip(indices, _build(polygons), strict=True):
            built[index] = sheet
    return built


def _build(polygons: FlatPolygons) -> list[Sheet | str]:
    faults = flatness_faults(polygons)
    flat = np.delete(np.arange(len(polygons.areas)), list(faults))
    for row, (one, other) in crossing_edges(FlatPolygons(*(array[flat] for array in polygons))).items():
        faults[int(flat[row])] = f"its edges {one} and {other} meet: it isn't simple"
    bulging, (quads, rests) = are_bulging(polygons.corners), convex_quads(polygons.vertices)
    boxes = np.stack([polygons.vertices.min(axis=1), polygons.vertices.max(axis=1)], axis=1)
    for array in (quads, rests, boxes):
        array.setflags(write=False)
    of_convex = None  # ears are clipped in the same order from all convex polygons
    built: list[Sheet | str] = []
    for index, vertices in enumerate(polygons.vertices):
        if index in faults:
            built.append(faults[index])
            continue
        triangles = of_convex if bulging[index] else None
        if triangles is None:
            try:
                triangles = ears(polygons.corners[index], float(polygons.areas[index]))
            except ValueError as error:
                built.append(str(error))
                continue
            triangles.setflags(write=False)
        if bulging[index]:
            of_convex = triangles if len(triangles) == len(vertices) - 2 else None  # else a corner was left out
            charges = Charges(triangles=rests[index], quads=quads[index])
        else:
            charges = Charges(triangles=vertices[triangles])
        built.append(Sheet(vertices, triangles, boxes[index], charges))
    return built
