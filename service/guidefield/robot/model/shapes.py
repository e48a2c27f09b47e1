"""As what each collision shape is judged: primitives as they are, meshes by their hull where it is as tight."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np

from guidefield.bounded_map import TRIANGULATIONS, BoundedMap, content_key
from guidefield.geometry.cache import recalled, remembered
from guidefield.geometry.closed import volume
from guidefield.geometry.convex import convex, convex_hull
from guidefield.geometry.entries import Arrays
from guidefield.geometry.mesh_surface import mesh_surface
from guidefield.geometry.nested import nested
from guidefield.geometry.solid import Solid
from guidefield.geometry.solid_cache import near_solid_of_mesh, solid_of_mesh
from guidefield.geometry.stand_off import stand_off
from guidefield.geometry.surfaces import Surface, surface
from guidefield.kernels.jit.compilers import load_imported
from guidefield.parallel import run_queue
from guidefield.robot.mesh_files.reading import unit_of
from guidefield.robot.model.model import GeometryChoice
from guidefield.system import usable_processors

HULL_STAND_OFF = 0.005
"""A mesh is judged by its convex hull if the hull stands off the mesh by at most this [m].

The hull contains the mesh, so it is safe at any distance; where it would stand off further, free space would be lost
(a gripper's hollow, a bent link) and the mesh itself is judged.
"""

ROUGHLY = 5e-4
"""How much too large a stand-off may be given at first [m], for each metre of a mesh and for one at least: where faces
of hull and mesh coincide it takes the square of what is saved."""

LEAST_FILLED = 0.01
"""An opening's hollow is worth telling if the hull gains more than this share of its volume by it."""

HARDLY_METRES = 10.0
"""A link's mesh that is longer was probably drawn in millimetres [m]."""

WIDEST_GAP = 0.02
"""Gaps of a mesh's surface up to this extent are cracks, and closed; a mesh with wider ones has no inside [m]."""


def settle(model: Any, geometry: Any, uris: Mapping[str, str], warnings: list[str]) -> tuple[GeometryChoice, ...]:
    """Replace each mesh of a geometry model by its hull where that is as tight; say what was chosen.

    Args:
        model: Pinocchio model that the geometry belongs to.
        geometry: Pinocchio geometry model; its meshes are replaced in place.
        uris: What the URDF calls a mesh, by the path of its file.
        warnings: Gets a sentence for each link whose hull fills more than a tight one does, or whose mesh has no inside
            or is so large that its numbers are hardly metres.
    """
    choices = []
    settled = _all_settled(geometry)
    for shape in geometry.geometryObjects:
        link = model.frames[shape.parentFrame].name
        if not _is_mesh(shape.geometry):
            choices.append(GeometryChoice(shape.name, link, type(shape.geometry).__name__.lower(), "primitive"))
            continue
        one = settled[_file_of(shape)]
        mesh = uris.get(shape.meshPath, shape.name)
        if (extent := _extent(shape.geometry)) > HARDLY_METRES:
            warnings.append(f"link {link!r}: mesh {mesh!r} is {extent:.4g} m large: {_unit_hint(Path(shape.meshPath))}")
        shape.geometry = one.shape
        choices.append(GeometryChoice(shape.name, link, "mesh", one.judged_as, one.stand_off))
        if one.wall:
            warnings.append(f"link {link!r}: mesh {mesh!r}: {one.wall}")
        if one.filled > 0.0:
            warnings.append(
                f"link {link!r}: mesh {mesh!r} is judged by its hull, which fills {_told_volume(one.filled)} of hollows"
            )
    return tuple(choices)


def _unit_hint(path: Path) -> str:
    """A question about the unit of a large mesh."""
    if path.suffix.lower() == ".dae":
        return f"its file states a unit of {unit_of(path):g} m; is that right?"
    return 'are its numbers millimetres? Then its <mesh> needs scale="0.001 0.001 0.001"'


def _file_of(shape: Any) -> tuple[str, bytes]:
    """What the meshes of two of Pinocchio's geometry objects are the same with: file and scale."""
    return shape.meshPath, np.asarray(shape.meshScale).tobytes()


def _all_settled(geometry: Any) -> dict[tuple[str, bytes], _Settled]:
    """As what each mesh of a geometry model is judged, by file and scale; new ones are found on all processors.

    What is known is read by this thread alone: threads must not load kernels at the same time.
    """
    meshes = {_file_of(one): one.geometry for one in geometry.geometryObjects if _is_mesh(one.geometry)}
    settled: dict[tuple[str, bytes], _Settled] = {}

    def settle_one(name: tuple[str, bytes], mesh: Any) -> None:
        settled[name] = _settled(mesh, _remembered_hull(mesh))

    works = []
    for name, mesh in meshes.items():
        known = recalled(*_hull_question(mesh))
        if known is None:
            works.append(functools.partial(settle_one, name, mesh))
        else:
            settled[name] = _settled(mesh, known)
    if works:
        load_imported("cover.", "distance.", "linalg.")
        run_queue(iter(works), min(usable_processors(), len(works)))
    return settled


def _is_mesh(shape: Any) -> bool:
    return isinstance(shape, coal.BVHModelBase)


def _extent(mesh: Any) -> float:
    """How long a Coal mesh is along the longest of its frame's axes [m]."""
    return float(np.ptp(np.array(mesh.vertices()), axis=0).max())


class _Settled(NamedTuple):
    """As what a mesh is judged, how far that stands off [m], what it fills beyond that [m^3], why it has no inside."""

    shape: Any
    judged_as: str
    stand_off: float
    filled: float
    wall: str


def _told_volume(volume: float) -> str:
    return f"{1e6 * volume:.3g} cm^3" if volume < 1e-3 else f"{1e3 * volume:.3g} l"


def triangulation(shape: Any) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) [m, the shape's frame] and triangles (t, 3) of a Coal mesh or hull, read-only.

    Coal hands out one triangle at a time, a microsecond each; the last meshes with the same vertices, as
    many triangles, and the same first, middle and last one are not read again.
    """
    vertices, face, count = _faces(shape)
    key = _identify(shape)
    triangles = _KNOWN.get(key)
    if triangles is None:
        triangles = np.array([(one[0], one[1], one[2]) for one in map(face, range(count))])
        triangles = _KNOWN.put(key, triangles, triangles.nbytes)
    for array in (vertices, triangles):
        array.setflags(write=False)
    return vertices, triangles


def know_triangulation(shape: Any, triangles: np.ndarray) -> None:
    """Keep the triangles (t, 3) that a Coal mesh was made of, which needn't be read from it then."""
    _KNOWN.put(_identify(shape), np.array(triangles, np.int64), triangles.nbytes)


def _faces(shape: Any) -> tuple[np.ndarray, Callable[[int], Any], int]:
    """Vertices of a Coal mesh or hull, shape (v, 3) [m], what returns a triangle, and how many there are."""
    if isinstance(shape, coal.BVHModelBase):
        return np.array(shape.vertices()), shape.tri_indices, shape.num_tris
    return np.array(shape.points()), shape.polygons, shape.num_polygons


def _identify(shape: Any) -> tuple[Any, ...]:
    """What a Coal mesh or hull is told from others by."""
    vertices, face, count = _faces(shape)
    some = tuple(face(i)[k] for i in (0, count // 2, count - 1) if count for k in range(3))
    return type(shape), content_key(vertices), count, some


_KNOWN: BoundedMap[tuple[Any, ...], np.ndarray] = BoundedMap(TRIANGULATIONS)

_HULLS: BoundedMap[tuple[Any, ...], tuple[Any | None]] = BoundedMap(TRIANGULATIONS)


def hull(mesh: Any) -> Any | None:
    """The convex hull of a Coal mesh, computed once; None if the mesh is flat, or too fine for Coal."""
    key = _identify(mesh)
    known = _HULLS.get(key)
    if known is None:
        found = _remembered_hull(mesh)
        known = (convex(found["vertices"], found["triangles"]) if len(found["triangles"]) else None,)
        known = _HULLS.put(key, known, sum(found[name].nbytes for name in ("vertices", "triangles")))
    return known[0]


def hull_vertices(mesh: Any) -> np.ndarray | None:
    """Return the vertices (k, 3) [m] of the convex hull of a Coal mesh, computed once; None as for `hull`."""
    found = _remembered_hull(mesh)
    return found["vertices"] if len(found["triangles"]) else None


def _settled(mesh: Any, found: Arrays) -> _Settled:
    (distance,), (filled,) = found["stand_off"].tolist(), found["filled"].tolist()
    if distance > HULL_STAND_OFF:
        return _Settled(mesh, "triangle mesh", 0.0, 0.0, found["wall"].tobytes().decode())
    return _Settled(convex(found["vertices"], found["triangles"]), "convex hull", distance, filled, "")


def _remembered_hull(mesh: Any) -> Arrays:
    return remembered(*_hull_question(mesh))


def _hull_question(mesh: Any) -> tuple[str, Arrays, Callable[[], Arrays]]:
    """The name that a mesh's hull is kept under, what it depends on, and how it is found."""
    vertices, triangles = triangulation(mesh)
    return "hull and wall", {"vertices": vertices, "triangles": triangles}, lambda: _hull(vertices, triangles)


def _hull(vertices: np.ndarray, triangles: np.ndarray) -> Arrays:
    """Hull of a mesh, how far it stands off, how much of hollows it fills, and why the mesh is a thin wall.

    Beyond `HULL_STAND_OFF` it is only said that it stands off further; where there is no hull, infinitely far.
    """
    try:
        around, filled = convex_hull(vertices), 0.0
        near = near_solid_of_mesh(vertices, triangles, 0.0)
        distance = _hull_stand_off(around, near)
        if near.reach > 0.0 and distance <= HULL_STAND_OFF:
            distance = _hull_stand_off(around, solid_of_mesh(vertices, triangles, 0.0))
        if distance <= HULL_STAND_OFF:
            filled = _filled(around, distance, solid_of_mesh(vertices, triangles, WIDEST_GAP))
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
    """How far a hull stands off a body, at most [m]; off a mesh that the body stands for, at least."""
    enough = HULL_STAND_OFF + body.reach
    distance = stand_off(around, body, enough, ROUGHLY)
    return (stand_off(around, body, enough) if distance > enough else distance) - body.reach


def _wall(vertices: np.ndarray, triangles: np.ndarray) -> str:
    """Why a mesh has no inside, in words; "" of a closed one."""
    judged = mesh_surface(vertices, triangles)
    return "" if judged is None or judged.solid else judged.warnings[-1]


def _filled(around: Surface, distance: float, body: Solid) -> float:
    """What a hull about a mesh fills [m^3]: sealed hollows, and more of others than its stand-off all over explains.

    An open mesh has no inside that could be filled.
    """
    if not body.closed:
        return 0.0
    vertices, triangles = body.surface.vertices, body.surface.triangles
    more = volume(around.vertices, around.triangles) - volume(vertices, triangles) - distance * around.area
    sealed = nested(vertices, triangles).volume
    return max(sealed, more if more > LEAST_FILLED * volume(around.vertices, around.triangles) else 0.0)
