"""As what each collision shape is judged: primitives as they are, meshes by their hull where it is as tight."""

from __future__ import annotations

import hashlib
from typing import Any

import coal
import numpy as np

from guidefield.geometry.cache import Arrays, remembered
from guidefield.geometry.convex import convex, convex_hull
from guidefield.geometry.solid import solid
from guidefield.geometry.stand_off import stand_off
from guidefield.geometry.surfaces import surface
from guidefield.robot.model import GeometryChoice

HULL_STAND_OFF = 0.005
"""A mesh is judged by its convex hull if the hull stands off the mesh by at most this [m].

The hull contains the mesh, so it is safe at any distance; where it would stand off further, free space would be lost
(a gripper's hollow, a bent link) and the mesh itself is judged.
"""

WIDEST_GAP = 0.02
"""Gaps of a mesh's surface up to this extent are cracks, and closed; a mesh with wider ones has no inside [m]."""


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
    """Vertices (v, 3) [m, the shape's frame] and triangles (t, 3) of a Coal mesh or hull, read-only.

    Coal hands out one triangle at a time, a microsecond each; the last `MOST_KNOWN` meshes with the same vertices, as
    many triangles, and the same first, middle and last one are not read again.
    """
    if isinstance(shape, coal.BVHModelBase):
        vertices, face, count = np.array(shape.vertices()), shape.tri_indices, shape.num_tris
    else:
        vertices, face, count = np.array(shape.points()), shape.polygons, shape.num_polygons
    some = tuple(face(i)[k] for i in (0, count // 2, count - 1) if count for k in range(3))
    key = (type(shape), hashlib.sha256(vertices.tobytes()).digest(), count, some)
    triangles = _KNOWN.pop(key, None)
    if triangles is None:
        triangles = np.array([(one[0], one[1], one[2]) for one in map(face, range(count))])
    _KNOWN[key] = triangles
    while len(_KNOWN) > MOST_KNOWN:
        del _KNOWN[next(iter(_KNOWN))]
    for array in (vertices, triangles):
        array.setflags(write=False)
    return vertices, triangles


MOST_KNOWN = 256

_KNOWN: dict[tuple[Any, ...], np.ndarray] = {}


def hull(mesh: Any) -> Any | None:
    """The convex hull of a Coal mesh, computed once; None if the mesh is flat, or too fine for Coal."""
    found = _remembered_hull(mesh)
    return convex(found["vertices"], found["triangles"]) if len(found["triangles"]) else None


def _settled(mesh: Any) -> tuple[Any, str, float]:
    """The shape that a mesh is judged as, what that is, and how far it stands off."""
    found = _remembered_hull(mesh)
    (distance,) = found["stand_off"].tolist()
    if distance > HULL_STAND_OFF:
        return mesh, "triangle mesh", 0.0
    return convex(found["vertices"], found["triangles"]), "convex hull", distance


def _remembered_hull(mesh: Any) -> Arrays:
    vertices, triangles = triangulation(mesh)
    return remembered("hull", {"vertices": vertices, "triangles": triangles}, lambda: _hull(vertices, triangles))


def _hull(vertices: np.ndarray, triangles: np.ndarray) -> Arrays:
    """Hull of a mesh, and how far it stands off: infinitely far where there is none."""
    try:
        around = convex_hull(vertices)
        distance = stand_off(around, solid(vertices, triangles))
    except ValueError:  # the mesh is flat, or too fine for Coal
        around, distance = surface(np.empty((0, 3)), np.empty((0, 3), np.int64)), np.inf
    return {"vertices": around.vertices, "triangles": around.triangles, "stand_off": np.array([distance])}
