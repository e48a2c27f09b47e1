"""Signed distances of convex shapes in contact, where Coal's expanding polytope (EPA) stops at a wrong face.

Along a unit direction n two convex bodies overlap by h(n) = max n.a - min n.b over their points a and b: moved so far
along n, the second one just touches the first. The penetration depth is the least h (Cameron and Culley 1986), so that
the reported depth has to be the least one known. EPA's polytope is flat where two bodies barely touch: for a
thin blade that touches a wall it tells metres; of a point inside a cylinder it tells up to a hundredth too little. Then
h is descended from the best directions that are known. With the second body moved by h(n) and a margin along n, GJK's
closest points give the next direction n': its h is no larger, because h(n') = (h(n) + margin) n.n' - gap, and the gap
is the margin at least.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import coal
import numpy as np

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
from guidefield.read_only import read_only

ACCURACY = 2e-6  # what Coal's depth may be off, and a share of it [m]
MARGIN = 1e-3  # by how much the second body is moved beyond the first, so that GJK tells a direction [m]

SLANTED = 1e-3  # what Coal's deepest points may be off the line along which shapes part, as a share of the depth
STARTS, STEPS = 4, 40  # from how many directions h is descended, and in how many steps

SAME = 1e-9  # points of two axes nearer to each other, as a share of their size, tell no direction; nor do such angles

FACES = 64  # the normals of a hull's faces are tried where there are no more than this
MOST_OTHERS = 17  # directions that are tried beside them: axes, their cross products, and two lines


class ClosestPoints(NamedTuple):
    """How far two shapes are apart [m], negative where they overlap, and their closest or deepest points [m, world]."""

    distance: float
    first: np.ndarray
    second: np.ndarray


class Outline:
    """A Coal shape, with what its overlaps with others are measured by."""

    def __init__(self, shape: Any) -> None:
        self.shape = shape
        self.is_convex = isinstance(shape, (coal.Box, coal.Sphere, coal.Capsule, coal.Cylinder, coal.ConvexBase))

    @cached_property
    def convex(self) -> ConvexShape:
        """The shape as kernels take it, if it is convex."""
        shape, kind, sizes = self.shape, HULL, np.zeros(3)
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
    """Return what Coal measured of two placed shapes, a coal.DistanceResult, its depth replaced where that can't be."""
    told = ClosestPoints(measured.min_distance, measured.getNearestPoint1(), measured.getNearestPoint2())
    if told.distance > 0.0 or not first.is_convex or not second.is_convex:
        return told
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
    count = try_directions(placed, told.first - told.second, directions, overlaps)
    least = float(overlaps[:count].min())
    accuracy = ACCURACY * (1.0 + max(least, 0.0))
    if abs(least + told.distance) <= accuracy and _part(placed, told, least, accuracy):
        return told._replace(distance=max(told.distance, -least))
    found = [
        _descend(placed, first.shape, here, second.shape, there, directions[k])
        for k in np.argsort(overlaps[:count])[:STARTS]
    ]
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
    if apart > SAME * (p + q + first.radius + second.radius):
        normal = (other - one) / apart
    else:  # axes that meet part across both
        normal = np.cross(a, b)
        length = float(np.linalg.norm(normal))
        normal = normal / length if length > SAME else here.getRotation()[:, 0]
    return ClosestPoints(
        apart - first.radius - second.radius, one + first.radius * normal, other - second.radius * normal
    )


def _part(placed: Placed, told: ClosestPoints, depth: float, accuracy: float) -> bool:
    """Return whether two shapes part once one is moved from one deepest point to the other.

    Coal's (3.0.3) of a sphere and a cylinder about one middle are one point.
    """
    between = told.first - told.second
    length = float(np.linalg.norm(between))
    if depth <= accuracy:
        return True
    far = accuracy + SLANTED * depth
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
