"""The bodies of a case are within the shapes of a proof: by how much they stand out of these at most.

Every triangle of a mesh, every point of a cloud, and a primitive as a whole, has to be in one of the nodes that aren't
divided, and in everything that holds this one. Then what keeps away from the nodes that a slab is between keeps away
from all of the body that is below them.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import coal
import numpy as np

from guidefield.referee.case import Body
from guidefield.referee.shapes import distinct, hull

NEAR = 1e-5  # beyond this a point isn't looked for among the corners of a shape [m]
CLOSE = 1e-7  # a point that is as near to a corner isn't looked for between planes [m]: that is single precision
ONTO_PLANES = 8  # number of times that a point goes onto the plane that it is farthest beyond
MANY = 200_000  # above this many distances from points to corners the planes about the corners are asked first


class Declared(NamedTuple):
    """A body as it is declared, in the frame of its shape: hulls of points, to which a disc and a ball are added."""

    points: np.ndarray  # shape (p, 3) [m]
    items: np.ndarray  # points of each hull, shape (t, k)
    ball: float  # radius of the ball [m]
    disc: float  # radius of the disc [m]
    axis: np.ndarray  # the disc's, shape (3,)
    plane: np.ndarray  # outward normal and offset of a half-space, shape (4,); of what has an end 0


class Shapes(NamedTuple):
    """Convex shapes in the frame of a body: hulls of corners, to which a disc and a ball are added."""

    begins: np.ndarray  # begin of each shape's corners, and the number of all, shape (h + 1,)
    balls: np.ndarray  # radius of the ball, shape (h,) [m]; infinite of a half-space
    discs: np.ndarray  # radius of the disc, shape (h,) [m]; of a half-space its offset
    axes: np.ndarray  # the disc's axis, shape (h, 3); of a half-space its outward normal
    corners: np.ndarray  # shape (c, 3) [m]


def declared(body: Body) -> Declared:
    """A body as its case declares it."""
    exact, none, z = body.exact, np.zeros(4), np.array([0.0, 0.0, 1.0])
    if isinstance(exact, coal.Halfspace):
        plane = np.array([*exact.n, exact.d])
        return Declared(np.empty((0, 3)), np.empty((0, 1), int), 0.0, 0.0, z, plane)
    if len(body.triangles):
        corners = body.triangles.reshape(-1, 3)
        first, index = distinct(corners)
        return Declared(corners[first], index.reshape(-1, 3), body.rounding, 0.0, z, none)
    if isinstance(exact, coal.BVHModelBase):
        return Declared(body.points, np.arange(len(body.points))[:, None], body.rounding, 0.0, z, none)
    if isinstance(exact, coal.Capsule | coal.Cylinder):
        ends = np.array([[0.0, 0.0, -exact.halfLength], [0.0, 0.0, exact.halfLength]])
        ball, disc = (exact.radius, 0.0) if isinstance(exact, coal.Capsule) else (0.0, exact.radius)
        return Declared(ends, np.arange(2)[None], ball, disc, z, none)
    if isinstance(exact, coal.Box):
        corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * np.array(exact.halfSide)
    else:
        corners = np.array(exact.points())
    return Declared(corners, np.arange(len(corners))[None], 0.0, 0.0, z, none)


def radius_about(body: Declared, centre: np.ndarray) -> float:
    """Radius of the sphere about a point (3,) that holds a body [m]."""
    return float(_farthest(body, centre, body.points).max(initial=0.0))


def box_about(body: Declared, rotation: np.ndarray, translation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner, (3,) each, of the box about a body that is turned (3, 3) and put elsewhere (3,) [m]."""
    points, across = body.points @ rotation.T + translation, np.sqrt(np.maximum(0.0, 1.0 - (rotation @ body.axis) ** 2))
    more = body.disc * across + body.ball
    return points.min(axis=0) - more, points.max(axis=0) + more


def standing_out(body: Declared, shapes: Shapes, children: np.ndarray, of_node: np.ndarray) -> float:
    """Return how far a body stands out of the shapes of its nodes at most [m]; infinite if it isn't in them at all.

    Args:
        shapes: The shapes, in its frame.
        children: The two nodes below each node, behind it; -1 where there are none, shape (n, 2).
        of_node: Shapes that are said to hold all of a node; -1 where none is, shape (n, 2).
    """
    if body.plane.any():  # its own plane is what counts
        return 0.0 if len(of_node) == 1 else np.inf
    count = len(body.items)
    best, waiting = np.full(count, np.inf), [(0, np.arange(count), np.zeros(count))]
    while waiting:
        node, mine, outside = waiting.pop()
        for shape in of_node[node][of_node[node] >= 0].tolist():
            items, found = body.items[mine], np.full(len(body.points), -np.inf)
            found[items] = np.inf
            asked = found == np.inf
            found[asked] = _outside(body, body.points[asked], shapes, shape)
            outside = np.maximum(outside, found[items].max(axis=1))
            mine, outside = mine[np.isfinite(outside)], outside[np.isfinite(outside)]
        if children[node, 0] < 0:
            best[mine] = np.minimum(best[mine], outside)
        elif len(mine):
            waiting += [(int(child), mine, outside) for child in children[node]]
    return float(best.max(initial=0.0))


def _farthest(body: Declared, centre: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Largest distance of a point (3,) from what stands about each of a body's points, shape (p,) [m]."""
    arms = points - centre
    along = arms @ body.axis
    across = np.linalg.norm(arms - along[:, None] * body.axis, axis=1) + body.disc
    found: np.ndarray = np.hypot(along, across) + body.ball
    return found


def _outside(body: Declared, points: np.ndarray, shapes: Shapes, shape: int) -> np.ndarray:
    """How far what stands about points (p, 3) is out of a shape at most, shape (p,) [m]; infinite if not known."""
    corners, ball = shapes.corners[shapes.begins[shape] : shapes.begins[shape + 1]], float(shapes.balls[shape])
    if not np.isfinite(ball):
        return np.full(len(points), np.inf)
    if len(corners) == 1:
        return np.maximum(0.0, _farthest(body, corners[0], points) - ball)
    low, high = corners.min(axis=0) - NEAR, corners.max(axis=0) + NEAR
    within = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    found, disc, axis = np.full(len(points), np.inf), float(shapes.discs[shape]), shapes.axes[shape]
    found[within] = _from_hull(points[within], corners)
    turned = float(np.linalg.norm(np.cross(axis, body.axis))) if body.disc else 0.0
    return found + max(0.0, body.disc - disc) + body.disc * turned + max(0.0, body.ball - ball)


def _from_hull(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Upper bounds of the distances of points (p, 3) from the hull of corners (c, 3), shape (p,) [m]."""
    if len(points) * len(corners) > MANY:
        found = _by_planes(points, corners)
        left = np.flatnonzero(found > 0.0)
        found[left] = np.minimum(found[left], _from_corners(points[left], corners))
        return found
    found = _from_corners(points, corners)
    left = np.flatnonzero(found > CLOSE)
    if len(left):
        found[left] = np.minimum(found[left], _by_planes(points[left], corners))
    return found


def _from_corners(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    squares = ((points[:, None] - corners) ** 2).sum(axis=2)
    found: np.ndarray = np.sqrt(squares.min(axis=1, initial=np.inf))
    return np.where(found <= NEAR, found, np.inf)


def _by_planes(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """The same by the planes of the hull's faces.

    With a point inside that is r from all of them, one that is v beyond them comes into the hull where it goes towards
    that point by v / (r + v) of the way. In a flat hull r is small: points go to the planes first, one by one.
    """
    spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False) if len(corners) > 3 else np.zeros(3)
    if spread[-1] <= 1e-9:
        return np.full(len(points), np.inf)
    convex = hull(corners)
    vertices, inside = np.array(convex.points()), corners.mean(axis=0)
    faces = np.array([[face[0], face[1], face[2]] for face in map(convex.polygons, range(convex.num_polygons))])
    a, b, c = vertices[faces].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals, a = normals[lengths > 0.0] / lengths[lengths > 0.0, None], a[lengths > 0.0]
    normals *= np.where(((a - inside) * normals).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    offsets = (a * normals).sum(axis=1)
    depth, found = float((offsets - normals @ inside).min()), np.full(len(points), np.inf)
    left, there = np.arange(len(points)), points
    for _ in range(1 + ONTO_PLANES):
        out = there @ normals.T - offsets
        worst, beyond = out.argmax(axis=1), np.maximum(out.max(axis=1), 0.0)
        to_hull = beyond / (depth + beyond) * np.linalg.norm(there - inside, axis=1)
        near, known = beyond <= NEAR, np.linalg.norm(there - points[left], axis=1) + to_hull
        found[left[near]] = np.minimum(found[left[near]], known[near])
        again = near & (beyond > 0.0)
        if not again.any():
            break
        left, there = left[again], there[again] - beyond[again, None] * normals[worst[again]]
    return found
