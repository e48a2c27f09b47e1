"""As what each collision shape is judged: primitives as they are, meshes by their hull where it is as tight."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from guidefield.robot.model import GeometryChoice

HULL_STAND_OFF = 0.005
"""A mesh is judged by its convex hull if the hull stands off the mesh by at most this [m].

The hull contains the mesh, so it is safe at any distance; where it would stand off further, free space would be lost
(a gripper's hollow, a bent link) and the mesh itself is judged.
"""

HULL_PROBES = 400
"""Points of the hull's surface whose distance to the mesh is measured."""


def settle(model: Any, geometry: Any) -> tuple[GeometryChoice, ...]:
    """Replace each mesh of a geometry model by its hull where that is as tight; say what was chosen.

    Args:
        model: Pinocchio model that the geometry belongs to.
        geometry: Pinocchio geometry model; its meshes are replaced in place.
    """
    choices = []
    settled: dict[tuple[str, bytes], tuple[Any, str, float]] = {}
    for shape in geometry.geometryObjects:
        link = model.frames[shape.parentFrame].name
        if not isinstance(shape.geometry, coal.BVHModelBase):
            choices.append(GeometryChoice(shape.name, link, type(shape.geometry).__name__.lower(), "primitive"))
            continue
        key = (shape.meshPath, np.asarray(shape.meshScale).tobytes())
        if key not in settled:
            settled[key] = _settled(shape.geometry)
        shape.geometry, judged_as, stand_off = settled[key]
        choices.append(GeometryChoice(shape.name, link, "mesh", judged_as, stand_off))
    return tuple(choices)


def triangulation(shape: Any) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) [m, the shape's frame] and triangles (t, 3) of a Coal mesh or hull."""
    if isinstance(shape, coal.BVHModelBase):
        vertices, faces = np.array(shape.vertices()), [shape.tri_indices(i) for i in range(shape.num_tris)]
    else:
        vertices, faces = np.array(shape.points()), [shape.polygons(i) for i in range(shape.num_polygons)]
    return vertices, np.array([(face[0], face[1], face[2]) for face in faces])


def _settled(mesh: Any) -> tuple[Any, str, float]:
    """The shape that a mesh is judged as, what that is, and how far it stands off."""
    try:
        mesh.buildConvexHull(True, "Qt")
    except RuntimeError:  # a flat mesh has no hull with a volume
        return mesh, "triangle mesh", 0.0
    hull = mesh.convex
    stand_off = _stand_off(hull, mesh)
    if stand_off <= HULL_STAND_OFF:
        return hull, "convex hull", stand_off
    return mesh, "triangle mesh", 0.0


def _stand_off(hull: Any, mesh: Any) -> float:
    """Largest distance from points on the hull's facets to the mesh [m]."""
    vertices, triangles = triangulation(hull)
    corners = vertices[triangles]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    widest = np.argsort(areas)[::-1]  # a far stand-off needs a wide facet: probe the widest ones best
    share = np.maximum(1, np.round(HULL_PROBES * areas[widest] / areas.sum()).astype(int))
    rng = np.random.default_rng(0)
    probe, here, nowhere = coal.Sphere(1e-9), coal.Transform3s.Identity(), coal.Transform3s.Identity()
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    largest = 0.0
    for triangle, count in zip(corners[widest][:HULL_PROBES], share[:HULL_PROBES], strict=True):
        for weights in [np.full(3, 1 / 3), *rng.dirichlet(np.ones(3), int(count) - 1)]:
            here.setTranslation(weights @ triangle)
            result.clear()
            largest = max(largest, coal.distance(probe, here, mesh, nowhere, request, result))
    return float(largest)
