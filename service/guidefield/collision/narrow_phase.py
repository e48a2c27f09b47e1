"""The narrow phase: Coal's distance of two bodies where they stand, with its known faults mended, and their depth.

Nothing is made of a pair before its first query. Results don't depend on earlier queries. A surface of very many
triangles is measured patch by patch, by those whose boxes are near enough. The faults, found in Coal 3.0.3, stand where
they are worked around; with another version each has to be looked for again.

Depths don't decide on contact. Users read them in replies; by them `planner/leaving.py` decides if a motion may begin
in contact, and `planner/ends.py` if a tip is blocked. With fewer `STARTS` (at least 1), `STEPS` or `FACES` they may be
reported too large, with more of `ACCURACY` or `OFF_LINE` more faults of Coal's pass.

Along a unit direction n two convex bodies overlap by h(n) = max n.a - min n.b over their points a and b: moved so far
along n, the second one just touches the first. The penetration depth is the least h (Cameron and Culley 1986), so that
the reported depth has to be the least one known. EPA's polytope is flat where two bodies barely touch: for a
thin blade that touches a wall it tells metres; of a point inside a cylinder it tells up to a hundredth too little. Then
h is descended from the best directions that are known. With the second body moved by h(n) and a margin along n, GJK's
closest points give the next direction n': its h is no larger, because h(n') = (h(n) + margin) n.n' - gap, and the gap
is the margin at least.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import coal
import numpy as np

from guidefield.geometry.convex import balls_as_capsules
from guidefield.kernels.collide.overlap import (
    BOX,
    CAPSULE,
    CYLINDER,
    HULL,
    ConvexShape,
    Placed,
    overlap_along,
    try_directions,
)
from guidefield.memo import memoized
from guidefield.read_only import read_only
from guidefield.scene.obstacle_parts import Patches

ACCURACY = 2e-6  # what Coal's depth may be off [m], and as a share of it
MARGIN = 1e-3  # by how much the second body is moved beyond the first, so that GJK tells a direction [m]
OFF_LINE = 1e-3  # what Coal's deepest points may be off the line along which shapes part, as a share of the depth
STARTS, STEPS = 4, 40  # from how many directions h is descended, and in how many steps

PARALLEL = 1e-9  # axes with nearest points this close (as a share of their size), or at this angle, tell no direction

FACES = 64  # the normals of a hull's faces are tried where there are no more than this
MOST_OTHERS = 17  # most that `try_directions` writes beside them (axes, cross products, two lines): nothing checks it


class ClosestPoints(NamedTuple):
    """The distance of two shapes [m], negative where they overlap, and their closest or deepest points [m, world]."""

    distance: float
    first: np.ndarray
    second: np.ndarray


class Outline:
    """A Coal shape, with what its overlaps with others are measured by."""

    def __init__(self, shape: Any) -> None:
        self.shape = shape
        self.is_convex = isinstance(shape, (coal.Box, coal.Sphere, coal.Capsule, coal.Cylinder, coal.ConvexBase))

    @property
    def convex(self) -> ConvexShape:
        """The shape as kernels take it, if it is convex."""
        return _describe_convex(self.shape)


@memoized
def _describe_convex(shape: Any) -> ConvexShape:
    kind, sizes = HULL, np.zeros(3)
    points, normals = np.empty((0, 3)), np.empty((0, 3))
    if isinstance(shape, coal.Box):
        kind, sizes = BOX, np.array(shape.halfSide, float)
    elif isinstance(shape, coal.ConvexBase):
        points = np.ascontiguousarray(shape.points(), float)
        normals = np.ascontiguousarray(_normals(shape, points))
    else:
        kind = CYLINDER if isinstance(shape, coal.Cylinder) else CAPSULE
        sizes[:2] = shape.radius, 0.0 if isinstance(shape, coal.Sphere) else shape.halfLength
    read_only(sizes, points, normals)
    return ConvexShape(kind, sizes, float(shape.getSweptSphereRadius()), points, normals)


def closest_points(first: Outline, here: Any, second: Outline, there: Any, measured: Any) -> ClosestPoints:
    """Return what Coal measured of two placed shapes, a coal.DistanceResult; a wrong depth is replaced."""
    points = ClosestPoints(measured.min_distance, measured.getNearestPoint1(), measured.getNearestPoint2())
    if points.distance > 0.0 or not first.is_convex or not second.is_convex:
        return points
    placed = Placed(
        first.convex,
        second.convex,
        np.ascontiguousarray(here.getRotation()),
        np.ascontiguousarray(there.getRotation()),
        there.getTranslation() - here.getTranslation(),
    )
    read_only(*placed)
    most = 2 * (MOST_OTHERS + len(placed.first.normals) + len(placed.second.normals))
    directions, overlaps = np.empty((most, 3)), np.empty(most)
    count = try_directions(placed, points.first - points.second, directions, overlaps)
    least = float(overlaps[:count].min())
    accuracy = ACCURACY * (1.0 + max(least, 0.0))
    if abs(least + points.distance) <= accuracy and _part(placed, points, least, accuracy):
        return points._replace(distance=max(points.distance, -least))
    found = [
        _descend(placed, first.shape, here, second.shape, there, directions[k])
        for k in np.argsort(overlaps[:count])[:STARTS]
    ]
    return max(found, key=lambda one: one.distance)


def measure_capsules(first: Any, here: Any, second: Any, there: Any) -> ClosestPoints:
    """Measure how far two capsules are apart, by the least distance of their axes (Ericson 2004).

    Coal (3.0.3) takes short ones for parallel that aren't: of 1 cm they may overlap by 7 um where it has them apart.
    """
    a, b = here.getRotation()[:, 2], there.getRotation()[:, 2]
    middles = here.getTranslation(), there.getTranslation()
    p, q = first.halfLength, second.halfLength
    ab, aw, bw = (float(one) for one in (a @ b, a @ (middles[0] - middles[1]), b @ (middles[0] - middles[1])))
    starts = [-p, p, -q * ab - aw, q * ab - aw, (ab * bw - aw) / max(1.0 - ab * ab, 1e-300)]
    nearest = (np.inf, middles[0], middles[1])
    for start in starts:
        t = min(max(bw + min(max(start, -p), p) * ab, -q), q)
        one, other = middles[0] + min(max(t * ab - aw, -p), p) * a, middles[1] + t * b
        nearest = min(nearest, (float(np.linalg.norm(other - one)), one, other), key=lambda found: found[0])
    apart, one, other = nearest
    if apart > PARALLEL * (p + q + first.radius + second.radius):
        normal = (other - one) / apart
    else:  # axes that meet part across both
        normal = np.cross(a, b)
        length = float(np.linalg.norm(normal))
        normal = normal / length if length > PARALLEL else here.getRotation()[:, 0]
    return ClosestPoints(
        apart - first.radius - second.radius, one + first.radius * normal, other - second.radius * normal
    )


def _part(placed: Placed, points: ClosestPoints, depth: float, accuracy: float) -> bool:
    """Return whether two shapes part once one is moved from one deepest point to the other.

    Coal's (3.0.3) of a sphere and a cylinder about one middle are one point.
    """
    between = points.first - points.second
    length = float(np.linalg.norm(between))
    if depth <= accuracy:
        return True
    far = accuracy + OFF_LINE * depth
    return abs(length - depth) <= far and overlap_along(placed, between / length) <= depth + far


def _descend(placed: Placed, first: Any, here: Any, second: Any, there: Any, direction: np.ndarray) -> ClosestPoints:
    """Descend the overlap of placed Coal shapes from a direction."""
    best = overlap_along(placed, direction)
    result, request = coal.DistanceResult(), coal.DistanceRequest()
    for _ in range(STEPS):
        shift = (best + MARGIN) * direction
        moved = coal.Transform3s(there.getRotation(), there.getTranslation() + shift)
        result.clear()
        coal.distance(first, here, second, moved, request, result)
        on_first, on_second = result.getNearestPoint1(), result.getNearestPoint2()
        between = on_second - on_first
        length = float(np.linalg.norm(between))
        if not length > 0.5 * MARGIN:
            break
        overlap = overlap_along(placed, between / length)
        if overlap >= best - 1e-9:
            break
        best, direction = overlap, between / length
    return ClosestPoints(-best, on_first, on_second - shift)


def _normals(shape: Any, points: np.ndarray) -> np.ndarray:
    """Normals of a hull's faces, or its principal axes if these are many, shape (n, 3)."""
    if not isinstance(shape, coal.Convex):
        return np.empty((0, 3))
    if shape.num_polygons > FACES:
        axes: np.ndarray = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
        return axes
    faces = [shape.polygons(k) for k in range(shape.num_polygons)]
    a, b, c = points[np.array([[face[0], face[1], face[2]] for face in faces])].swapaxes(0, 1)
    normals: np.ndarray = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1).max()
    return normals


class CoalTransforms:
    """Transforms of a world's bodies; those of the robot's follow an array (r, 3, 4) [m] in which others write.

    `still` tells where one of the other bodies stands, by its index, a pinocchio.SE3.
    """

    def __init__(self, robot: np.ndarray, still: Callable[[int], Any]) -> None:
        self._rotations, self._translations, self._still = robot[:, :, :3], robot[:, :, 3], still
        self._made = [coal.Transform3s() for _ in robot]
        self._written, self._now = [-1] * len(robot), 0
        self._known: dict[int, Any] = {}
        self._moved: dict[int, Any] = {}

    def forget(self) -> None:
        """The robot's bodies stand elsewhere; those that were moved stand where they did."""
        self._now += 1
        if self._moved:
            self._moved.clear()

    def move(self, body: int, placement: Any) -> None:
        """Put one of the other bodies elsewhere, at a pinocchio.SE3, until `forget`."""
        self._moved[body] = transform(placement)

    def of(self, body: int) -> Any:
        """Return where a body stands, a coal.Transform3s; of the robot's bodies it is valid until `forget`."""
        if body < len(self._made):
            made = self._made[body]
            if self._written[body] != self._now:
                made.setTransform(self._rotations[body], self._translations[body])
                self._written[body] = self._now
            return made
        if body in self._moved:
            return self._moved[body]
        if body not in self._known:
            self._known[body] = transform(self._still(body))
        return self._known[body]


def transform(placement: Any) -> Any:
    """Convert a placement (pinocchio.SE3) to a coal.Transform3s."""
    return coal.Transform3s(np.array(placement.rotation), np.array(placement.translation))


_ShapePair = tuple[int, int, int]  # indices of two bodies, and the patch of the second

_ROUNDING = 1e-9  # by how much boxes about bodies are wider, for rounding [m]


class NarrowPhase:
    """Coal's distances of pairs of bodies; like the world that it belongs to it answers one question at a time.

    It has Coal (3.0.3, without a margin) return points of contact, because Coal otherwise overlooks boxes that overlap
    by centimetres where an axis of one lies along an axis of the other. `shape` and `there` return a body's Coal shape
    (of an obstacle maybe `Patches`) and its coal.Transform3s now, by its index.
    """

    def __init__(self, shape: Callable[[int], Any], there: Callable[[int], Any]) -> None:
        self._shape, self._there = shape, there
        self._shapes: dict[int, Any] = {}
        self._boxes: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._pair_outlines: dict[_ShapePair, tuple[Outline, Outline]] = {}
        self._outlines: dict[int, Outline] = {}  # by the identity of their shapes, which they keep alive
        self._collide: dict[_ShapePair, Any] = {}
        self._measure: dict[_ShapePair, Any] = {}
        self._request, self._result = coal.CollisionRequest(), coal.CollisionResult()
        self._distance_request = coal.DistanceRequest()

    def shape(self, body: int) -> Any:
        """A body's Coal shape."""
        if body not in self._shapes:
            self._shapes[body] = self._shape(body)
        return self._shapes[body]

    def penetration(self, first: int, second: int, margin: float = 0.0) -> float | None:
        """Return how far two bodies are apart [m] if they lack a margin [m], negative in contact; None if they keep it.

        For a margin below 0 the answer is None where a body is a mesh.
        """
        if isinstance(patches := self.shape(second), Patches):
            for apart, patch in patches.nearest_first(*self._box_in_frame(first, second)):
                if apart > margin:
                    break
                found = self._penetration((first, second, patch), margin)
                if found is not None:
                    return found
            return None
        return self._penetration((first, second, 0), margin)

    def _penetration(self, pair: _ShapePair, margin: float) -> float | None:
        first, second, _ = pair
        if self._are_capsules(first, second):
            apart = self._distance(pair).distance
            return apart if apart <= margin else None
        if pair not in self._collide:
            self._collide[pair] = coal.ComputeCollision(*(one.shape for one in self._outlines_of(pair)))
        self._request.security_margin = self._request.distance_upper_bound = margin
        self._result.clear()
        self._collide[pair](self._there(first), self._there(second), self._request, self._result)
        return float(self._result.getContact(0).penetration_depth) if self._result.isCollision() else None

    def distance(self, first: int, second: int, at_most: float = math.inf) -> ClosestPoints:
        """Measure the distance of two bodies, negative where convex ones overlap, with their closest points.

        Of bodies that are farther apart than `at_most` [m] at least that is returned, and no points.
        """
        if not isinstance(patches := self.shape(second), Patches):
            return self._distance((first, second, 0), at_most)
        nearest: ClosestPoints | None = None
        for apart, patch in patches.nearest_first(*self._box_in_frame(first, second)):
            if nearest is not None and apart > nearest.distance:
                break
            found = self._distance((first, second, patch), at_most)
            if nearest is None or found.distance < nearest.distance:
                nearest = found
        assert nearest is not None, "there is a patch"
        return nearest

    def _distance(self, pair: _ShapePair, at_most: float = math.inf) -> ClosestPoints:
        first, second, _ = pair
        if self._are_capsules(first, second):
            return measure_capsules(self.shape(first), self._there(first), self.shape(second), self._there(second))
        if pair not in self._measure:
            self._measure[pair] = coal.ComputeDistance(*(one.shape for one in self._outlines_of(pair)))
        result = coal.DistanceResult()
        if at_most < math.inf:
            result.min_distance = at_most  # Coal looks at no parts of meshes that are farther apart
        here, there = self._there(first), self._there(second)
        self._measure[pair](here, there, self._distance_request, result)
        one, other = self._outlines_of(pair)
        return closest_points(one, here, other, there, result)

    def _are_capsules(self, first: int, second: int) -> bool:
        return isinstance(self.shape(first), coal.Capsule) and isinstance(self.shape(second), coal.Capsule)

    def _outlines_of(self, pair: _ShapePair) -> tuple[Outline, Outline]:
        """Return the outlines of a pair's shapes, kept because Coal's functors don't keep shapes alive."""
        if pair not in self._pair_outlines:
            first, second, patch = pair
            other = self.shape(second)
            shapes = balls_as_capsules(self.shape(first), other.shape(patch) if isinstance(other, Patches) else other)
            one, another = (self._outlines.setdefault(id(shape), Outline(shape)) for shape in shapes)
            self._pair_outlines[pair] = one, another
        return self._pair_outlines[pair]

    def _box_in_frame(self, first: int, second: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the corners of a box about a body's shape in the frame of another body, shapes (3,) [m]."""
        if first not in self._boxes:
            shape = self.shape(first)
            shape.computeLocalAABB()
            self._boxes[first] = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
        low, high = self._boxes[first]
        here, there = self._there(first), self._there(second)
        rotation = there.getRotation().T @ here.getRotation()
        middle = here.getRotation() @ (0.5 * (low + high)) + here.getTranslation() - there.getTranslation()
        centre, reach = there.getRotation().T @ middle, np.abs(rotation) @ (0.5 * (high - low)) + _ROUNDING
        return centre - reach, centre + reach
