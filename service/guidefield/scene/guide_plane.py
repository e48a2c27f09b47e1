"""Fit, check and triangulate flat polygons in space; the guide plane, a convex one that the tip has to reach.

Polygon obstacles are built of the first part, planner/guide asks the second for distances and insets. Tolerances are
shares of a polygon's size: `PLANARITY` and `SMALLEST_AREA` decide which polygons users get refused, `SLACK` what still
counts as within a plane, for planner/guide, too.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.errors import SceneInvalid
from guidefield.geometry.charged import convex_quads
from guidefield.geometry.surfaces import triangulate_polygon
from guidefield.kernels.distance.polygons import inradius, touching_edges_of_each
from guidefield.messages import scene as messages
from guidefield.scene.obstacle_parts import Charges

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
        """Return points in the world (n, 3) of points (n, 2) in the plane's axes about its origin [m]."""
        points: np.ndarray = self.origin + corners @ self.axes
        return points


class FlatPolygons(NamedTuple):
    """Polygons with the same number of corners, columns of the fields of `FlatPolygon`."""

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
    """Return the centroid (2,) of a polygon (k, 2) with an area."""
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

    Edge i runs from corner i to corner i + 1. Edges closer than `PLANARITY` of the size touch. Missing ones are simple.
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
    """Build sheets from the corners of polygons; return the fault instead of a sheet for a faulty polygon."""
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
                triangles = triangulate_polygon(polygons.corners[index], float(polygons.areas[index]))
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


SLACK = 1e-8  # rounding that `contains` allows, as a fraction of the size, so that a closest point is contained


@dataclass(frozen=True, eq=False)
class GuidePlane:
    """A convex, flat polygon.

    The *inset* polygon holds the points of the polygon that are at least a given distance from its edges [m]. An inset
    beyond the inradius represents the inradius: the rest then is the deepest point, or the deepest line segment.
    """

    name: str
    vertices: np.ndarray  # corners, shape (k, 3) [m, world], counter-clockwise about the unit normal (3,)
    normal: np.ndarray
    centroid: np.ndarray  # of the area, shape (3,) [m, world]
    inradius: float  # radius of the largest circle inside [m]
    flat: FlatPolygon  # the polygon in its plane
    # ``inward[i] . x - offsets[i]`` is the height of x in the plane over edge i, from corner i to i + 1 [m]; shapes (k,
    # 2) and (k,)
    inward: np.ndarray
    offsets: np.ndarray

    def signed_height(self, point: np.ndarray) -> float:
        """Return the distance of a point (3,) in the world from the plane [m], positive on the side of the normal."""
        return float(self.normal @ (point - self.flat.origin))

    def contains(self, point: np.ndarray, inset: float = 0.0) -> bool:
        """Return whether the foot of a point (3,) [m, world] lies in the inset polygon, whatever its height."""
        return self.depth(point) >= min(inset, self.inradius) - SLACK * self.flat.size

    def depth(self, point: np.ndarray) -> float:
        """Return the depth of a point's foot (3,) inside the nearest edge [m], negative outside."""
        return self._depth(self.flat.axes @ (point - self.flat.origin))

    def closest_point(self, point: np.ndarray, inset: float = 0.0) -> np.ndarray:
        """Return the point (3,) of the inset polygon that is closest to a point (3,) [m, world]."""
        inset = min(inset, self.inradius)
        foot = self.flat.axes @ (point - self.flat.origin)
        if self._depth(foot) < inset:
            foot = _closest_on_outline(foot, self._inset_corners(inset))
        closest: np.ndarray = self.flat.origin + foot @ self.flat.axes
        return closest

    def distance(self, point: np.ndarray, inset: float = 0.0) -> float:
        """Return the distance of a point (3,) from the inset polygon [m, world]."""
        return float(np.linalg.norm(point - self.closest_point(point, inset)))

    def inset_vertices(self, inset: float) -> np.ndarray:
        """Return the corners of the inset polygon, shape (m, 3) [m, world]; fewer where an edge has vanished."""
        return self.flat.from_plane(self._inset_corners(min(inset, self.inradius)))

    def _depth(self, foot: np.ndarray) -> float:
        return float((self.inward @ foot - self.offsets).min())

    def _inset_corners(self, inset: float) -> np.ndarray:
        if inset <= 0.0:
            return self.flat.corners
        moved = _inset(self.flat.corners, self.inward, inset)
        if moved is not None:
            return moved
        # At the inradius itself rounding decides whether anything is left.
        return _clip(self.flat.corners, self.inward, self.offsets + inset * (1.0 - 1e-9))


def build_all(declared: Sequence[messages.GuidePlane], deadline: Deadline = UNLIMITED) -> tuple[GuidePlane, ...]:
    """Build guide planes; raises SceneInvalid as `build`, DeadlineExpired if the deadline passed before."""
    built = []
    for index, message in enumerate(declared):
        if index:
            deadline.check("the guide planes were built")
        built.append(build(message, index))
    return tuple(built)


def build(message: messages.GuidePlane, index: int) -> GuidePlane:
    """Check a guide plane, given with its index in the scene, and build it.

    Raises SceneInvalid if it isn't flat, isn't convex or has no area; `details` name the plane and the path.
    """
    flats = flat_polygons(np.array(message.vertices, float)[None])
    flat = flats.one(0)
    fault = flatness_faults(flats).get(0) or _convexity_fault(flat)
    if fault is not None:
        raise SceneInvalid(
            f"guide plane {message.name!r}: {fault}", guide_plane=message.name, path=f"$.guide_planes[{index}].vertices"
        )
    edges = np.roll(flat.corners, -1, axis=0) - flat.corners
    inward = np.column_stack([-edges[:, 1], edges[:, 0]]) / np.linalg.norm(edges, axis=1, keepdims=True)
    offsets = np.einsum("ij,ij->i", inward, flat.corners)
    middle = flat.from_plane(centroid(flat.corners)[None])[0]
    for array in (inward, offsets, middle):
        array.setflags(write=False)
    return GuidePlane(
        name=message.name,
        vertices=flat.vertices,
        normal=flat.normal,
        centroid=middle,
        inradius=inradius(inward, offsets, PLANARITY),
        flat=flat,
        inward=inward,
        offsets=offsets,
    )


def _convexity_fault(flat: FlatPolygon) -> str | None:
    before, after = np.roll(flat.corners, 1, axis=0), np.roll(flat.corners, -1, axis=0)
    arriving, leaving = flat.corners - before, after - flat.corners
    cross = arriving[:, 0] * leaving[:, 1] - arriving[:, 1] * leaving[:, 0]
    # How deep the corner dents the polygon: its distance from the chord of its neighbours.
    chords = np.linalg.norm(after - before, axis=1)
    dents = -cross / np.maximum(chords, PLANARITY * flat.size)
    worst = int(np.argmax(dents))
    if dents[worst] > PLANARITY * flat.size:
        return f"it is not convex: vertex {worst} dents it by {dents[worst]:.3g} m"
    turns = np.arctan2(cross, np.einsum("ij,ij->i", arriving, leaving))
    if abs(turns.sum() - 2.0 * np.pi) > 1e-3:
        return f"it is not convex: its edges turn {turns.sum() / (2.0 * np.pi):.2f} times around instead of once"
    return None


def _inset(corners: np.ndarray, inward: np.ndarray, inset: float) -> np.ndarray | None:
    """Move all edges inwards and return the corners; None once an edge has vanished (lengths fall linearly)."""
    arriving = np.roll(inward, 1, axis=0)
    mitre = (arriving + inward) / (1.0 + np.einsum("ij,ij->i", arriving, inward))[:, None]
    moved: np.ndarray = corners + inset * mitre
    edges = np.roll(moved, -1, axis=0) - moved
    if (inward[:, 1] * edges[:, 0] - inward[:, 0] * edges[:, 1]).min() > 0.0:
        return moved
    return None


def _clip(corners: np.ndarray, inward: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Clip a convex polygon by half-planes ``inward . x >= offset``; shape (m, 2), m may be 0."""
    for normal, offset in zip(inward, offsets, strict=True):
        heights = corners @ normal - offset
        if heights.min() >= 0.0:
            continue
        if heights.max() < 0.0:
            return np.empty((0, 2))
        after, heights_after = np.roll(corners, -1, axis=0), np.roll(heights, -1)
        cut = heights * heights_after < 0.0
        share = np.where(cut, heights / np.where(cut, heights - heights_after, 1.0), 0.0)
        crossings = corners + share[:, None] * (after - corners)
        both = np.stack([corners, crossings], axis=1).reshape(-1, 2)
        corners = both[np.stack([heights >= 0.0, cut], axis=1).ravel()]
    return corners


def _closest_on_outline(foot: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the point (2,) of a closed outline (m, 2), m >= 1, that is closest to another."""
    along = np.roll(corners, -1, axis=0) - corners
    lengths = np.einsum("ij,ij->i", along, along)
    share = np.einsum("ij,ij->i", foot - corners, along) / np.where(lengths > 0.0, lengths, 1.0)
    points = corners + np.clip(share, 0.0, 1.0)[:, None] * along
    closest: np.ndarray = points[np.argmin(np.einsum("ij,ij->i", points - foot, points - foot))]
    return closest
