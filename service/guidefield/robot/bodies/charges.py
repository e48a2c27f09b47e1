"""Surfaces of a robot's links: charged points with capsules, points and bodies that distances are taken of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry import surfaces
from guidefield.geometry.cache import Arrays, find_or_compute
from guidefield.geometry.charges import Capsule, SurfacePoints, fit_capsule, surface_points
from guidefield.geometry.closed import edge_counts
from guidefield.geometry.distance_bodies import DistanceBody, body_rows, body_tables, primitive, triangulated_body
from guidefield.kernels.distance.distance import SHEET, SOLID, DistanceTables
from guidefield.memo import memoized
from guidefield.robot.model.collision_shapes import triangulation
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.pairs import collision_pairs, scratch_space

POINTS = 200  # about how many points a robot gets at most
POINTS_PER_SHAPE = 33  # about how many a robot of few shapes gets for each: the thesis' links need eight rings of four

SPREAD = 0.76
"""Spacing of spread points over the side of the square that is their share, so that their number is the wanted one."""

LEAST_SPACING = 1e-3
"""Points of a link are no denser than this for its thinness [m]: a link can be as thin as a line. At size 1."""

ALWAYS_CLOSE = 2.0  # links whose gap at rest is below this many radii of their capsules don't repel each other
ROUNDING = 1e-9  # by how much balls are taken to be larger than they are, as a share


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
    """Charged points, capsules and repelling pairs of a robot; computed once for each."""
    meshes = [surface(shape.geometry) for shape in robot.geometry.geometryObjects]
    areas = surface_areas(robot)
    spacing = SPREAD * float(np.sqrt(sum(areas) / min(POINTS, POINTS_PER_SHAPE * max(len(areas), 1))))
    least = LEAST_SPACING * robot.size
    shapes = tuple(_charge(vertices, triangles, spacing, least) for vertices, triangles in meshes)
    return RobotCharges(shapes, _repelling(robot, shapes))


@memoized
def surface_areas(robot: RobotModel) -> list[float]:
    """Area of every collision shape, in the geometry's order [m^2]; computed once for each robot."""
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
    """Collision pairs that aren't always close: their gap at rest is at least `ALWAYS_CLOSE` radii."""
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
    """Smallest distance from points to a capsule's surface [m]."""
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


SPACING = 0.036  # largest spacing of the points [m], at size 1

SPACING_OF_RADIUS = 0.3
"""Largest spacing as a share of the radius of the capsule about a shape: what is slim goes where it is narrow."""

SMALLEST_SPACING = 0.008  # no finer than this [m], at size 1
MOST = 1500  # about how many points a robot gets at most; beyond, all spacings grow alike
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
    spacings *= np.sqrt(max(1.0, _POINTS_PER_SQUARE * squares / MOST))
    return tuple(surface_points(*mesh, float(spacing)).points for mesh, spacing in zip(meshes, spacings, strict=True))
