"""Surfaces of links: charged points and capsules for the field, points and bodies for optimization.

A shape's capsule contains the vertices of its surface by a margin for rounding, whatever the search finds, and so the
shape, of round ones with no fewer `_DIRECTIONS` and no `_RADII` below 1: swept capsules prove motions by it.
`ALWAYS_CLOSE` chooses which links repel each other. The other constants are numbers and spacings of points: more follow
the shape closer, and all are evaluated. They change motions and potentials, not what is free.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry import surfaces
from guidefield.geometry.cache import Arrays, find_or_compute
from guidefield.geometry.closed import edge_counts
from guidefield.geometry.distance_bodies import DistanceBody, body_rows, body_tables, primitive, triangulated_body
from guidefield.geometry.surfaces import Floats, Integers, furthest, perpendicular_axes, spread_directions
from guidefield.kernels.cover.enclosing_ball import SLACK, enclosing_circle
from guidefield.kernels.cover.pieces import farthest_first
from guidefield.kernels.distance.distance import SHEET, SOLID, DistanceTables
from guidefield.memo import memoized
from guidefield.robot.model.collision_shapes import triangulation
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.pairs import collision_pairs, scratch_space

_ROUNDING = 16.0 * float(np.finfo(np.float64).eps)
"""Margin of a capsule about points close together far from the origin, over their coordinates: it may grow alone."""

_RADII = 1.0 + 0.25 * np.linspace(0.0, 1.0, 11) ** 2
"""Radii to try, as multiples of the least: a wider capsule may be shorter; 1.225 makes a cube's a ball."""

_DIRECTIONS = spread_directions(512)
"""Of many points those furthest in these directions choose the direction of the axis."""

_FIRST_TILT, _LAST_TILT = 0.2, 0.01  # the largest and smallest step of the search for the best direction [rad]


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within `radius` [m] of the segment from `p0` to `p1`, shape (3,) each [m], which may be one point."""

    p0: Floats
    p1: Floats
    radius: float

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        length = float(np.linalg.norm(self.p1 - self.p0))
        return np.pi * self.radius**2 * (length + 4.0 / 3.0 * self.radius)

    def distance(self, points: Floats) -> Floats:
        """Return signed distances of points (n, 3) from the surface, shape (n,) [m]; negative inside."""
        axis = self.p1 - self.p0
        square = float(axis @ axis)
        offsets = points - self.p0
        along = np.clip(offsets @ axis / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(points))
        distances: Floats = np.linalg.norm(offsets - along[:, None] * axis, axis=1) - self.radius
        return distances


def fit_capsule(points: Floats) -> Capsule:
    """Find a capsule about points (n, 3), n >= 1, of locally least volume over the directions of its axis.

    The search starts from the best principal axis. ValueError if there is no point, or one is not finite.
    """
    cloud = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if len(cloud) == 0 or not np.isfinite(cloud).all():
        raise ValueError("a capsule needs at least one point, and all finite")
    few = cloud
    if len(cloud) > len(_DIRECTIONS):
        few = cloud[furthest(cloud, _DIRECTIONS / np.maximum(np.ptp(cloud, axis=0), 1e-9))]
    few = np.unique(few, axis=0)
    centred = few - few.mean(axis=0)
    principal = np.linalg.svd(centred.T @ centred)[2]
    best, direction = _tilt(few, min(principal, key=lambda axis: _along(few, axis).volume))
    return best if len(cloud) <= len(_DIRECTIONS) else _along(cloud, direction)


def _tilt(cloud: Floats, direction: Floats) -> tuple[Capsule, Floats]:
    """The best capsule that tilting the direction, less and less, leads to, and its direction."""
    best = _along(cloud, direction)
    tilt = _FIRST_TILT
    while tilt > _LAST_TILT:
        first, second = perpendicular_axes(direction)
        tilts = [direction + tilt * side for side in (first, -first, second, -second)]
        trials = [(_along(cloud, tilted), tilted) for tilted in (t / np.linalg.norm(t) for t in tilts)]
        trial, tilted = min(trials, key=lambda pair: pair[0].volume)
        if trial.volume < best.volume:
            best, direction = trial, tilted
        else:
            tilt *= 0.5
    return best, direction


def _along(cloud: Floats, direction: Floats) -> Capsule:
    """The capsule of least volume with its axis along a unit direction, through the middle of the enclosing circle."""
    frame = np.vstack([perpendicular_axes(direction), direction])
    local = cloud @ frame.T
    circle = np.empty(3)
    enclosing_circle(np.ascontiguousarray(local[:, :2]), circle)
    centre, radius = circle[:2], float(circle[2])
    radii = radius * _RADII
    # A point is inside if the axis comes to within `reach` of its height.
    squares = ((local[:, :2] - centre) ** 2).sum(axis=1)
    reach = np.sqrt(np.maximum((radii * radii)[:, None] - squares, 0.0))
    low, high = (local[:, 2] + reach).min(axis=1), (local[:, 2] - reach).max(axis=1)
    best = int(np.argmin(radii**2 * (np.maximum(high - low, 0.0) + 4.0 / 3.0 * radii)))
    heights = (low[best], high[best]) if low[best] < high[best] else [0.5 * (low[best] + high[best])] * 2
    ends = np.array([[*centre, height] for height in heights]) @ frame
    ends.setflags(write=False)
    farthest = float(Capsule(ends[0], ends[1], 0.0).distance(cloud).max())
    return Capsule(ends[0], ends[1], farthest * SLACK + _ROUNDING * float(np.abs(cloud).max()))


_CANDIDATES_PER_POINT = 64  # candidates per chosen point: shares of the area come in steps of about its inverse

_LEAST_CANDIDATES = 512

_PLASTIC = 1.324717957244746
"""Root of x^3 = x + 1; its powers spread points in the plane as the golden ratio does on a line."""


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points (n, 3) on a surface with its outward unit normals (n, 3) and their shares of the area (n,) [m^2]."""

    points: Floats
    normals: Floats
    weights: Floats


def surface_points(vertices: Floats, triangles: Integers, spacing: float) -> SurfacePoints:
    """Choose points of a surface, (v, 3) and (t, 3), that keep a spacing [m] and come within it of all of it.

    Farthest point sampling of many candidates that are uniform in area, from the far end of the surface on; each point
    represents the part of the surface nearest to it. ValueError if the area is 0 or the spacing not positive.
    """
    corners = np.asarray(vertices, dtype=np.float64)[np.asarray(triangles)]
    normals = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    area = float(areas.sum())
    if not (area > 0.0 and np.isfinite(area)):
        raise ValueError(f"a surface to put points on needs a finite area, got {area} m^2")
    if not (spacing > 0.0 and np.isfinite(spacing)):
        raise ValueError(f"`spacing` must be positive, got {spacing} m")
    count = max(_LEAST_CANDIDATES, int(np.ceil(_CANDIDATES_PER_POINT * area / spacing**2)))
    candidates, owners = _uniform(corners, areas, count)
    chosen, shares = _farthest_first(candidates, spacing)
    of = owners[chosen]
    weights = shares.astype(np.float64) * (area / count)
    result = SurfacePoints(candidates[chosen], normals[of] / areas[of, None], weights)
    for array in (result.points, result.normals, result.weights):
        array.setflags(write=False)
    return result


def _uniform(corners: Floats, areas: Floats, count: int) -> tuple[Floats, Integers]:
    """Return points uniform in area, shape (count, 3), and the triangle of each: equal steps along the summed areas."""
    steps = (np.arange(count) + 0.5) * (areas.sum() / count)
    owners = np.minimum(np.searchsorted(np.cumsum(areas), steps), np.flatnonzero(areas)[-1])
    order = np.arange(1, count + 1)
    s, t = (order / _PLASTIC) % 1.0, (order / _PLASTIC**2) % 1.0
    beyond = s + t > 1.0
    s, t = np.where(beyond, 1.0 - s, s), np.where(beyond, 1.0 - t, t)
    a, b, c = corners[owners].transpose(1, 0, 2)
    return a + s[:, None] * (b - a) + t[:, None] * (c - a), owners


def _farthest_first(candidates: Floats, spacing: float) -> tuple[Integers, Integers]:
    # neighbours stand together along Morton's curve, through a grid of 1024 cells a side
    extent = max(float(np.ptp(candidates, axis=0).max()), 1e-300)
    cells = np.minimum((candidates - candidates.min(axis=0)) * (1024.0 / extent), 1023.0).astype(np.int64)
    bits = range(10)
    code = sum(((cells[:, axis] >> bit) & 1) << (3 * bit + axis) for bit in bits for axis in range(3))
    order = np.argsort(code, kind="stable")
    sorted_candidates = np.ascontiguousarray(candidates[order])
    offsets = sorted_candidates - candidates.mean(axis=0)
    start = int((offsets * offsets).sum(axis=1).argmax())
    chosen, owner = np.empty(len(order), np.int64), np.empty(len(order), np.int64)
    count = farthest_first(sorted_candidates, start, spacing, chosen, owner)
    return order[chosen[:count]], np.bincount(owner, minlength=count)


POINTS = 200  # about how many charged points a robot gets at most: each is evaluated in the field
POINTS_PER_SHAPE = 33  # about how many a robot of few shapes gets for each: the thesis' links need eight rings of four

SPREAD = 0.76
"""Spacing of spread points over the square root of each one's area; measured, so that as many come out as wanted."""

LEAST_SPACING = 1e-3
"""Points of a thin link are no closer to each other than this [m], at size 1: a link can be as thin as a line."""

ALWAYS_CLOSE = 2.0  # links whose gap at rest is below this many radii of their capsules don't repel each other
ROUNDING = 1e-9  # share by which balls are taken to be larger, for rounding


@dataclass(frozen=True, eq=False)
class ChargedShape:
    """Points (n, 3) of a shape [m], the areas they stand for (n,) [m^2], and a capsule about it, in its frame."""

    points: np.ndarray
    weights: np.ndarray
    capsule: Capsule


@dataclass(frozen=True, eq=False)
class RobotCharges:
    """Charges of every collision shape, in the geometry's order, and the shapes that repel each other.

    Of a pair (i, j) points of i are in the field of j's capsule, and the other way round.
    """

    shapes: tuple[ChargedShape, ...]
    repelling: tuple[tuple[int, int], ...]


@memoized
def robot_charges(robot: RobotModel) -> RobotCharges:
    """Build charged points, capsules and repelling pairs of a robot; once for each."""
    meshes = [surface(shape.geometry) for shape in robot.geometry.geometryObjects]
    areas = surface_areas(robot)
    spacing = SPREAD * float(np.sqrt(sum(areas) / min(POINTS, POINTS_PER_SHAPE * max(len(areas), 1))))
    least = LEAST_SPACING * robot.size
    shapes = tuple(_charge(vertices, triangles, spacing, least) for vertices, triangles in meshes)
    return RobotCharges(shapes, _repelling(robot, shapes))


@memoized
def surface_areas(robot: RobotModel) -> list[float]:
    """Return the area of every collision shape, in the geometry's order [m^2]; computed once for each robot."""
    meshes = (surface(shape.geometry) for shape in robot.geometry.geometryObjects)
    return [surfaces.area_of(vertices[triangles]) for vertices, triangles in meshes]


def surface(shape: Any) -> tuple[np.ndarray, np.ndarray]:
    """Triangulate a Coal shape: vertices in its own frame, shape (v, 3) [m], and triangles, shape (t, 3).

    Raises:
        TypeError: if it is of a kind that no robot's shape has.
    """
    for kind, triangulate in _SURFACES.items():
        if isinstance(shape, kind):
            return triangulate(shape)
    raise TypeError(f"a robot's collision shape can't be a {type(shape).__name__}")


_SURFACES: dict[type, Callable[[Any], tuple[np.ndarray, np.ndarray]]] = {
    coal.Box: lambda s: surfaces.box(2.0 * np.asarray(s.halfSide)),
    coal.Sphere: lambda s: surfaces.sphere(s.radius),
    coal.Cylinder: lambda s: surfaces.cylinder(s.radius, 2.0 * s.halfLength),
    coal.Capsule: lambda s: surfaces.capsule(s.radius, 2.0 * s.halfLength),
    coal.BVHModelBase: triangulation,
    coal.Convex: triangulation,
}


def _charge(vertices: np.ndarray, triangles: np.ndarray, spacing: float, least: float) -> ChargedShape:
    inputs = {"vertices": vertices, "triangles": triangles, "spacing": np.array([spacing, least])}
    found = find_or_compute("charges", inputs, lambda: _find_charges(vertices, triangles, spacing, least))
    (radius,) = found["radius"].tolist()
    p0, p1 = found["axis"]
    return ChargedShape(found["points"], found["weights"], Capsule(p0, p1, radius))


def _find_charges(vertices: np.ndarray, triangles: np.ndarray, spacing: float, least: float) -> Arrays:
    capsule = fit_capsule(vertices)
    # a thin edge must not slip between the points of a thin link
    across = max(2.0 * capsule.radius, least)
    points: SurfacePoints = surface_points(vertices, triangles, min(spacing, across))
    return {
        "points": points.points,
        "weights": points.weights,
        "axis": np.array([capsule.p0, capsule.p1]),
        "radius": np.array([capsule.radius]),
    }


def _repelling(robot: RobotModel, shapes: tuple[ChargedShape, ...]) -> tuple[tuple[int, int], ...]:
    """Choose the collision pairs that aren't always close: their gap at rest is at least `ALWAYS_CLOSE` radii."""
    data, geometry_data = robot.model.createData(), scratch_space(robot.geometry)
    pin.updateGeometryPlacements(robot.model, data, robot.geometry, geometry_data, robot.rest)
    pairs = collision_pairs(robot.geometry)
    radii = np.array([shape.capsule.radius for shape in shapes])
    least = ALWAYS_CLOSE * radii[pairs].max(axis=1)
    kept = _apart(geometry_data.oMg, shapes, pairs) >= least
    for k in np.flatnonzero(~kept).tolist():  # of the others the bound tells too little
        i, j = pairs[k].tolist()
        gaps = [
            _gap(geometry_data.oMg[a], shapes[a].points, geometry_data.oMg[b], shapes[b].capsule)
            for a, b in ((i, j), (j, i))
        ]
        kept[k] = min(gaps) >= least[k]
    return tuple((i, j) for i, j in pairs[kept].tolist())


def _apart(placements: Any, shapes: tuple[ChargedShape, ...], pairs: np.ndarray) -> np.ndarray:
    """Bound the distance (n,) of one shape's points of each pair (n, 2) from the other's capsule, by balls [m]."""
    ends = np.array([(shape.capsule.p0, shape.capsule.p1) for shape in shapes]).reshape(-1, 2, 3)
    middles, halves = ends.mean(axis=1), 0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    balls = halves + [shape.capsule.radius for shape in shapes]
    for k, (shape, middle) in enumerate(zip(shapes, middles, strict=True)):  # which has points a hair outside
        balls[k] = max(balls[k], np.linalg.norm(shape.points - middle, axis=1).max(initial=0.0))
    centres = np.array([place.act(middle) for place, middle in zip(placements, middles, strict=True)]).reshape(-1, 3)
    between = np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1)
    found: np.ndarray = between - balls[pairs].sum(axis=1) * (1.0 + ROUNDING)
    return found


def _gap(T_points: Any, points: np.ndarray, T_capsule: Any, capsule: Capsule) -> float:
    """Return the smallest distance from points to a capsule's surface [m]."""
    local = (T_capsule.actInv(T_points).homogeneous @ np.c_[points, np.ones(len(points))].T).T[:, :3]
    axis = capsule.p1 - capsule.p0
    along = np.clip((local - capsule.p0) @ axis / max(float(axis @ axis), 1e-30), 0.0, 1.0)
    nearest = capsule.p0 + along[:, None] * axis
    return float(np.linalg.norm(local - nearest, axis=1).min() - capsule.radius)


@memoized
def link_bodies(robot: RobotModel) -> DistanceTables:
    """Return a body for every collision shape, in the geometry's order and the shape's own frame; without a tree.

    A mesh is solid if its triangles close around a volume, else a sheet.
    """
    bodies = [_body(shape.geometry) for shape in robot.geometry.geometryObjects]
    return body_tables(body_rows(bodies), range(len(bodies)), np.empty((0, 6)))


def _body(shape: object) -> DistanceBody:
    body = primitive(shape)
    if body is not None:
        return body
    vertices, triangles = surface(shape)
    return triangulated_body(vertices, triangles, SOLID if _closes(vertices, triangles) else SHEET)


def _closes(vertices: np.ndarray, triangles: np.ndarray) -> bool:
    up, down = edge_counts(triangles)
    if not ((up == 1) & (down == 1)).all():
        return False
    a, b, c = np.moveaxis(vertices[triangles] - vertices.mean(axis=0), 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) > 0.0


SPACING = 0.036  # largest spacing of points by which optimization keeps a robot from obstacles [m], at size 1

SPACING_OF_RADIUS = 0.3
"""Largest spacing as a share of the radius of the capsule about a shape: what is slim goes where it is narrow."""

SMALLEST_SPACING = 0.008  # no finer than this [m], at size 1
MOST_SAMPLES = 1500  # about how many points a robot gets at most; beyond, all spacings grow alike
_POINTS_PER_SQUARE = 0.6  # about how many points of a spacing there are on an area of its square


@memoized
def surface_samples(robot: RobotModel) -> tuple[np.ndarray, ...]:
    """Return read-only points (n, 3) of every collision shape, in its own frame [m], in the geometry's order."""
    meshes = [surface(shape.geometry) for shape in robot.geometry.geometryObjects]
    spacings = np.array(
        [
            np.clip(SPACING_OF_RADIUS * charged.capsule.radius, SMALLEST_SPACING * robot.size, SPACING * robot.size)
            for charged in robot_charges(robot).shapes
        ]
    )
    squares = sum(area / spacing**2 for area, spacing in zip(surface_areas(robot), spacings, strict=True))
    spacings *= np.sqrt(max(1.0, _POINTS_PER_SQUARE * squares / MOST_SAMPLES))
    return tuple(surface_points(*mesh, float(spacing)).points for mesh, spacing in zip(meshes, spacings, strict=True))
