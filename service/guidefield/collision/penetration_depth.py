"""Signed distances of convex shapes in contact, where Coal's expanding polytope (EPA) stops at a wrong face.

Along a unit direction n two convex bodies overlap by h(n) = max n.a - min n.b over their points a and b: moved so far
along n, the second one just touches the first. The penetration depth is the least h (Cameron and Culley 1986), so that
the depth that is told has to be the least one known. EPA's polytope is flat where two bodies barely touch: for a thin
blade that touches a wall it tells metres; of a point inside a cylinder it tells up to a hundredth too little. Then h is
descended from the best directions that are known. With the second body moved by h(n) and a margin along n, GJK's
closest points give the next direction n': its h is no larger, because h(n') = (h(n) + margin) n.n' - gap, and the gap
is the margin at least.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import coal
import numpy as np

ACCURACY = 2e-6  # what Coal's depth may be off, and a share of it [m]
MARGIN = 1e-3  # by how much the second body is moved beyond the first, so that GJK tells a direction [m]

STARTS, STEPS = 4, 40  # from how many directions h is descended, and in how many steps

FACES = 64  # the normals of a hull's faces are tried where there are no more than this


class ClosestPoints(NamedTuple):
    """How far two shapes are apart [m], negative where they overlap, and their closest or deepest points [m, world]."""

    distance: float
    first: np.ndarray
    second: np.ndarray


class Outline:
    """A Coal shape, with what its overlap with others is measured by."""

    def __init__(self, shape: Any) -> None:
        self.shape = shape
        self.is_convex = isinstance(shape, (coal.Box, coal.Sphere, coal.Capsule, coal.Cylinder, coal.ConvexBase))

    def reach(self, directions: np.ndarray) -> np.ndarray:
        """Return how far the shape reaches along directions (n, 3) of its frame, shape (n,) [m]."""
        shape = self.shape
        rounded = shape.getSweptSphereRadius()
        if isinstance(shape, coal.Box):
            reach = np.abs(directions) @ np.array(shape.halfSide)
        elif isinstance(shape, coal.Cylinder):
            reach = np.abs(directions[:, 2]) * shape.halfLength + shape.radius * np.hypot(*directions[:, :2].T)
        elif isinstance(shape, coal.ConvexBase):
            reach = (directions @ self._points.T).max(axis=1)
        else:
            rounded += shape.radius
            reach = np.abs(directions[:, 2]) * (shape.halfLength if isinstance(shape, coal.Capsule) else 0.0)
        found: np.ndarray = reach + rounded
        return found

    @cached_property
    def normals(self) -> np.ndarray:
        """Normals of a hull's faces, or its principal axes if these are many, shape (n, 3); none of another shape."""
        shape = self.shape
        if not isinstance(shape, coal.Convex):
            return np.empty((0, 3))
        points = self._points
        if shape.num_polygons > FACES:
            axes: np.ndarray = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
            return axes
        faces = [shape.polygons(k) for k in range(shape.num_polygons)]
        a, b, c = points[np.array([[face[0], face[1], face[2]] for face in faces])].swapaxes(0, 1)
        normals: np.ndarray = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1).max()
        return normals

    @cached_property
    def _points(self) -> np.ndarray:
        return np.array(self.shape.points())


def closest_points(first: Outline, here: Any, second: Outline, there: Any, measured: Any) -> ClosestPoints:
    """Return what Coal measured of two placed shapes, a coal.DistanceResult, its depth replaced where that can't be."""
    told = ClosestPoints(measured.min_distance, measured.getNearestPoint1(), measured.getNearestPoint2())
    if told.distance > 0.0 or not first.is_convex or not second.is_convex:
        return told
    bodies = _Bodies(first, here, second, there)
    directions = bodies.directions(told)
    overlaps = bodies.overlaps(directions)
    least = float(overlaps.min())
    if abs(least + told.distance) <= ACCURACY * (1.0 + max(least, 0.0)):
        return told._replace(distance=max(told.distance, -least))
    found = [bodies.descend(directions[k]) for k in np.argsort(overlaps)[:STARTS]]
    return max(found, key=lambda one: one.distance)


def measure_capsules(first: Any, here: Any, second: Any, there: Any) -> ClosestPoints:
    """Return how far two capsules are apart, by the least distance of their axes (Ericson 2004).

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
    normal = (other - one) / apart if apart > 0.0 else here.getRotation()[:, 0]
    return ClosestPoints(
        apart - first.radius - second.radius, one + first.radius * normal, other - second.radius * normal
    )


class _Bodies:
    def __init__(self, first: Outline, here: Any, second: Outline, there: Any) -> None:
        self._shapes, self._places = (first, second), (here, there)
        self._rotations = [np.array(place.getRotation()) for place in self._places]
        self._apart = np.array(there.getTranslation()) - np.array(here.getTranslation())

    def directions(self, told: ClosestPoints) -> np.ndarray:
        """Unit directions among which the least overlap mostly is, of both signs, shape (n, 3).

        They are the shapes' axes and faces, cross products of axes, and the lines between centres and closest points.
        """
        axes = [rotation.T for rotation in self._rotations]
        (ax, ay, az), (bx, by, bz) = (self._rotations[0][:, :, None], self._rotations[1][:, None, :])
        crossed = np.empty((3, 3, 3))
        crossed[:, :, 0], crossed[:, :, 1], crossed[:, :, 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        faces = [one.normals @ rotation.T for one, rotation in zip(self._shapes, self._rotations, strict=True)]
        found = np.concatenate([*axes, crossed.reshape(-1, 3), *faces, [self._apart, told.first - told.second]])
        found /= np.maximum(np.abs(found).max(axis=1, keepdims=True), 1e-9)  # EPA's points may be anywhere
        lengths = np.sqrt((found * found).sum(axis=1))
        is_direction = lengths > 1e-9
        units = found[is_direction] / lengths[is_direction, None]
        both: np.ndarray = np.concatenate([units, -units])
        return both

    def overlaps(self, directions: np.ndarray) -> np.ndarray:
        """By how much the shapes overlap along unit directions (n, 3), shape (n,) [m]."""
        (first, second), (here, there) = self._shapes, self._rotations
        overlap: np.ndarray = first.reach(directions @ here) + second.reach(-directions @ there)
        overlap -= directions @ self._apart
        return overlap

    def descend(self, direction: np.ndarray) -> ClosestPoints:
        (first, second), (here, there) = self._shapes, self._places
        best = float(self.overlaps(direction[None])[0])
        result, request = coal.DistanceResult(), coal.DistanceRequest()
        for _ in range(STEPS):
            shift = (best + MARGIN) * direction
            moved = coal.Transform3s(there.getRotation(), there.getTranslation() + shift)
            result.clear()
            coal.distance(first.shape, here, second.shape, moved, request, result)
            on_first, on_second = result.getNearestPoint1(), result.getNearestPoint2()
            between = on_second - on_first
            length = float(np.linalg.norm(between))
            if not length > 0.5 * MARGIN:
                break
            overlap = float(self.overlaps(between[None] / length)[0])
            if overlap >= best - 1e-9:
                break
            best, direction = overlap, between / length
        return ClosestPoints(-best, on_first, on_second - shift)
