"""Triangles and hulls of collision meshes, each found once, and how far a hull stands off its mesh."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import coal
import numpy as np

from guidefield.bounded_map import TRIANGULATIONS, BoundedMap, content_key
from guidefield.geometry.cache import Arrays, remembered
from guidefield.geometry.closed import volume
from guidefield.geometry.convex import convex, convex_hull
from guidefield.geometry.mesh_surface import mesh_surface
from guidefield.geometry.solid import Solid, stand_off
from guidefield.geometry.solid_cache import find_nested, near_solid_of_mesh, solid_of_mesh
from guidefield.geometry.surfaces import Surface, surface
from guidefield.robot.model.size import scale

HULL_STAND_OFF = 0.005
"""A mesh is judged by its convex hull if the hull stands off the mesh by at most this [m], at size 1.

The hull contains the mesh, so it is safe at any distance; where it would stand off further, free space would be lost
(a gripper's hollow, a bent link) and the mesh itself is judged.
"""

ROUGHLY = 5e-4
"""How much too large a stand-off may be given at first [m], for each metre of a mesh and for one at least: where faces
of hull and mesh coincide it takes the square of what is saved."""

LEAST_FILLED = 0.01  # an opening's hollow is worth telling if the hull gains more than this share of its volume by it

WIDEST_GAP = 0.02
"""Gaps of a mesh's surface up to this extent are cracks, and closed; a mesh with wider ones has no inside [m]."""


def triangulation(shape: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return read-only vertices (v, 3) [m, the shape's frame] and triangles (t, 3) of a Coal mesh or hull.

    Coal hands out one triangle at a time, a microsecond each; the last meshes with the same vertices, as
    many triangles, and the same first, middle and last one are not read again.
    """
    vertices, face, count = _faces(shape)
    key = _identify(shape)
    known = _KNOWN.get(key)
    if known is None:
        triangles = np.array([(one[0], one[1], one[2]) for one in map(face, range(count))])
        known = _KNOWN.insert(key, (triangles, 1.0), triangles.nbytes)
    for array in (vertices, known[0]):
        array.setflags(write=False)
    return vertices, known[0]


def know_triangulation(shape: Any, triangles: np.ndarray, unit: float) -> None:
    """Keep the triangles (t, 3) that a Coal mesh was made of, which needn't be read from it then, and its unit [m]."""
    _KNOWN.insert(_identify(shape), (np.array(triangles, np.int64), unit), triangles.nbytes)


def _faces(shape: Any) -> tuple[np.ndarray, Callable[[int], Any], int]:
    """Vertices of a Coal mesh or hull, shape (v, 3) [m], what returns a triangle, and how many there are."""
    if isinstance(shape, coal.BVHModelBase):
        return np.array(shape.vertices()), shape.tri_indices, shape.num_tris
    return np.array(shape.points()), shape.polygons, shape.num_polygons


def _identify(shape: Any) -> tuple[Any, ...]:
    vertices, face, count = _faces(shape)
    some = tuple(face(i)[k] for i in (0, count // 2, count - 1) if count for k in range(3))
    return type(shape), content_key(vertices), count, some


_KNOWN: BoundedMap[tuple[Any, ...], tuple[np.ndarray, float]] = BoundedMap(TRIANGULATIONS)

_HULLS: BoundedMap[tuple[Any, ...], tuple[Any | None]] = BoundedMap(TRIANGULATIONS)


def hull(mesh: Any) -> Any | None:
    """The convex hull of a Coal mesh, computed once; None if the mesh is flat, or too fine for Coal."""
    key = _identify(mesh)
    known = _HULLS.get(key)
    if known is None:
        found = _recall_hull(mesh)
        known = (convex(found["vertices"], found["triangles"]) if len(found["triangles"]) else None,)
        known = _HULLS.insert(key, known, sum(found[name].nbytes for name in ("vertices", "triangles")))
    return known[0]


def hull_vertices(mesh: Any) -> np.ndarray | None:
    """Return the vertices (k, 3) [m] of the convex hull of a Coal mesh, computed once; None as for `hull`."""
    found = _recall_hull(mesh)
    return found["vertices"] if len(found["triangles"]) else None


def _recall_hull(mesh: Any) -> Arrays:
    vertices, triangles = triangulation(mesh)
    known = _KNOWN.get(_identify(mesh))
    unit = 1.0 if known is None else known[1]
    return hull_in_metres(remembered(*hull_question(vertices, triangles, unit)), unit)


def hull_question(vertices: np.ndarray, triangles: np.ndarray, unit: float) -> tuple[str, Arrays, Callable[[], Arrays]]:
    """Return name, inputs and computation of the hull of a mesh, (v, 3) and (t, 3), for `remembered`.

    Its lengths are in units then: the robot's size as a power of two [m].
    """
    vertices = vertices if unit == 1.0 else vertices / unit
    return "hull and wall", {"vertices": vertices, "triangles": triangles}, lambda: _hull(vertices, triangles)


def hull_in_metres(found: Arrays, unit: float) -> Arrays:
    """Return a hull that was found in units."""
    return scale(scale(found, unit, "vertices", "stand_off"), unit**3, "filled")


def _hull(vertices: np.ndarray, triangles: np.ndarray) -> Arrays:
    """Find the hull of a mesh, how far it stands off, the volume of hollows it fills, and why the mesh is a thin wall.

    Beyond `HULL_STAND_OFF` it is only said that it stands off further; where there is no hull, infinitely far.
    """
    try:
        around, filled = convex_hull(vertices), 0.0
        near = near_solid_of_mesh(vertices, triangles, 0.0)
        distance = _hull_stand_off(around, near)
        if near.reach > 0.0 and distance <= HULL_STAND_OFF:
            distance = _hull_stand_off(around, solid_of_mesh(vertices, triangles, 0.0))
        if distance <= HULL_STAND_OFF:
            filled = _fill_volume(around, distance, solid_of_mesh(vertices, triangles, WIDEST_GAP))
    except ValueError:  # the mesh is flat, or too fine for Coal
        around, distance, filled = surface(np.empty((0, 3)), np.empty((0, 3), np.int64)), np.inf, 0.0
    return {
        "vertices": around.vertices,
        "triangles": around.triangles,
        "stand_off": np.array([distance]),
        "filled": np.array([filled]),
        "wall": np.frombuffer(_wall(vertices, triangles).encode() if distance > HULL_STAND_OFF else b"", np.uint8),
    }


def _hull_stand_off(around: Surface, body: Solid) -> float:
    """How far a hull stands off a body, at most [m]; off a mesh that the body represents, at least."""
    enough = HULL_STAND_OFF + body.reach
    distance = stand_off(around, body, enough, ROUGHLY)
    return (stand_off(around, body, enough) if distance > enough else distance) - body.reach


def _wall(vertices: np.ndarray, triangles: np.ndarray) -> str:
    """Why a mesh has no inside, in words; "" of a closed one."""
    judged = mesh_surface(vertices, triangles)
    return "" if judged is None or judged.solid else judged.warnings[-1]


def _fill_volume(around: Surface, distance: float, body: Solid) -> float:
    """Return the volume that a hull fills: sealed hollows, and others beyond its stand-off [m^3]; 0 if open."""
    if not body.closed:
        return 0.0
    vertices, triangles = body.surface.vertices, body.surface.triangles
    more = volume(around.vertices, around.triangles) - volume(vertices, triangles) - distance * around.area
    sealed = find_nested(vertices, triangles).volume
    return max(sealed, more if more > LEAST_FILLED * volume(around.vertices, around.triangles) else 0.0)
