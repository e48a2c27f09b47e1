"""Coal's shapes of obstacles as messages describe them, each in its own frame, made by the referee's builders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import coal
import msgspec
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from doubting.meshes import is_closed, outward
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.referee.shapes import placement_of, shape_of, surface

Surface = tuple[np.ndarray, np.ndarray]
"""Vertices (v, 3) and triangles (t, 3) of a mesh."""
MESH_SLACK = 5e-3
"""By how much a hull may stand off that is judged for a mesh [m]."""


@dataclass(frozen=True, eq=False)
class Body:
    """A shape in the frame of an obstacle.

    Attributes:
        shape: Coal's.
        placement: Of the shape in that frame, a pinocchio.SE3.
        slack: How far what is judged for it may stand off [m].
        hull: Of a mesh; None of others.
        solid: Vertices and triangles of a closed mesh; None of others.
    """

    shape: Any
    placement: Any
    slack: float = 0.0
    hull: Any | None = None
    solid: Surface | None = None


def bodies(message: messages.Obstacle) -> list[Body]:
    """The shapes of an obstacle; a cloud has one for each point."""
    if type(message) in MAKERS:
        return MAKERS[type(message)](message)
    return [Body(shape_of(msgspec.to_builtins(message, enc_hook=float)).exact, pin.SE3.Identity())]


def frame(message: messages.Obstacle) -> Any:
    """Return where an obstacle at rest has its frame."""
    if isinstance(message, messages.HalfSpace | messages.Polygon | messages.PointCloud):
        return pin.SE3.Identity()
    return se3(Placement(message.position, getattr(message, "quaternion_xyzw", (0.0, 0.0, 0.0, 1.0))))


def se3(placement: Placement) -> Any:
    return placement_of(msgspec.to_builtins(placement, enc_hook=float))


def frames_at(message: messages.Obstacle, times: np.ndarray) -> list[Any]:
    """Return where an obstacle that moves has its frame at times (n,): on a screw from each placement to the next."""
    flight = message.trajectory
    knots, placements, found = np.array(flight.times), [se3(one) for one in flight.placements], []
    for t in times:
        k = int(np.searchsorted(knots, t, side="right")) - 1
        if k < 0 or k >= len(knots) - 1:
            found.append(placements[max(k, 0)])
        else:
            share = (t - knots[k]) / (knots[k + 1] - knots[k])
            step = pin.log6(placements[k].inverse() * placements[k + 1]).vector
            found.append(placements[k] * pin.exp6(share * step))
    return found


def ball(radius: float) -> Any:
    """A ball, as a capsule without length: Coal finds its own in contact with triangles without area, anywhere."""
    return coal.Capsule(radius, 0.0)


def solid_of(shape: Any) -> Surface | None:
    """Vertices and triangles of one of Coal's meshes if it is closed; None else."""
    faces = [shape.tri_indices(k) for k in range(shape.num_tris)]
    vertices, triangles = np.array(shape.vertices()), np.array([[one[0], one[1], one[2]] for one in faces])
    return (vertices, triangles) if is_closed(vertices, triangles) else None


def hull_of(mesh: Any) -> Any | None:
    """Qhull's hull of one of Coal's meshes as Coal's shape; None of one that is flat.

    None as well where a vertex has more neighbours than Coal can count.
    """
    vertices = np.unique(np.array(mesh.vertices()), axis=0)
    try:
        vertices, triangles = outward(vertices, ConvexHull(vertices).simplices)
    except (QhullError, ValueError):
        return None
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for point in vertices:
        points.append(point)
    for a, b, c in triangles.tolist():
        faces.append(coal.Triangle(a, b, c))
    try:
        return coal.Convex(points, faces)
    except RuntimeError:
        return None


def _mesh(message: messages.Mesh) -> list[Body]:
    key = id(message.vertices), id(message.triangles)  # a mesh that is only moved has the same lists
    if key not in _MESHES:
        if len(_MESHES) >= MOST_KEPT:
            _MESHES.clear()
        vertices, triangles = np.array(message.vertices), np.array(message.triangles)
        mesh = surface(vertices, triangles)
        hull, solid = hull_of(mesh), (vertices, triangles) if is_closed(vertices, triangles) else None
        body = Body(mesh, pin.SE3.Identity(), MESH_SLACK, hull, solid)
        exactly = hull is not None and is_closed(vertices, triangles, 0.0)
        if exactly and _fills(vertices, triangles, hull):
            body = Body(hull, pin.SE3.Identity())
        _MESHES[key] = message, body
    return [_MESHES[key][1]]


def _fills(vertices: np.ndarray, triangles: np.ndarray, hull: Any) -> bool:
    """Return whether a closed mesh is convex: it has its hull's volume, but for rounding."""
    a, b, c = (vertices[triangles[:, k]] - vertices.mean(axis=0) for k in range(3))
    volume = float((a * np.cross(b, c)).sum()) / 6.0
    return bool(abs(volume - hull.computeVolume()) <= 1e-9 * hull.computeVolume())


MOST_KEPT = 200

_MESHES: dict[tuple[int, int], tuple[messages.Mesh, Body]] = {}
"""Meshes that were made, with the messages, whose lists stay what they are as long as they are kept."""


def _polygon(message: messages.Polygon) -> list[Body]:
    corners = np.array(message.vertices, float)
    fan = np.array([[0, k, k + 1] for k in range(1, len(corners) - 1)])
    return [Body(surface(corners, fan), pin.SE3.Identity())]


def _cloud(message: messages.PointCloud) -> list[Body]:
    return [Body(ball(message.radius), pin.SE3(np.eye(3), point)) for point in np.array(message.points)]


MAKERS: dict[type, Callable[[Any], list[Body]]] = {
    messages.Mesh: _mesh,
    messages.Polygon: _polygon,
    messages.PointCloud: _cloud,
}
