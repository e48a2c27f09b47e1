"""Settle the collision shapes of a URDF: read meshes, find their hulls, and choose a tight hull in place of a mesh.

The form in which a link is tested (`HULL_STAND_OFF`) decides every collision with it, and is reported to users;
docs/robots.md and certificate.md state it. `LEAST_FILLED` and `HARDLY_METRES` (in robots.md, too) decide on warnings
alone; here `WIDEST_GAP`, too, but it also decides what is inside a mesh for the spheres and parts of link_bounds.py.
Triangles and hulls are kept, because Coal hands them out slowly.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.geometry.cache import Arrays, find_or_compute, recall
from guidefield.geometry.closed import volume
from guidefield.geometry.convex import bvh, convex, convex_hull
from guidefield.geometry.mesh_surface import mesh_surface
from guidefield.geometry.solid import Solid, find_nested, near_solid_of_mesh, solid_of_mesh, stand_off
from guidefield.geometry.surfaces import Surface, surface
from guidefield.kernels.jit.decorators import load_imported
from guidefield.memory import TRIANGULATIONS, BoundedMap, content_key
from guidefield.parallel import run_queue, usable_processors
from guidefield.robot.mesh_files.numbers import MeshFault
from guidefield.robot.mesh_files.reading import FileMesh, find_ignored_unit, read_mesh, unit_of
from guidefield.robot.model.model import GeometryChoice, power_of_two, scale
from guidefield.robot.urdf.elements import THICKNESS, UrdfFacts

HULL_STAND_OFF = 0.005
"""A mesh is tested by its convex hull if the hull stands off the mesh by at most this [m], at size 1.

The hull contains the mesh, so it is safe at any distance; where it would stand off further, free space would be lost
(a gripper's hollow, a bent link) and the mesh itself is tested.
"""

ROUGH_TOLERANCE = 5e-4
"""Tolerance of a first, rough stand-off, which is reported if it is small enough, as a share of the mesh's extent or of
1 m: a finer one takes longer by the square where faces of hull and mesh coincide."""

LEAST_FILLED = 0.01  # an open hollow is reported if it is more than this share of the hull's volume

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
    """Keep the triangles (t, 3) that a Coal mesh was made of, and its unit [m], instead of reading them from it."""
    _KNOWN.insert(_identify(shape), (np.array(triangles, np.int64), unit), triangles.nbytes)


def _faces(shape: Any) -> tuple[np.ndarray, Callable[[int], Any], int]:
    """Return the vertices of a Coal mesh or hull, (v, 3) [m], its triangles as a function, and their number."""
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
    """Return the convex hull of a Coal mesh, computed once; None if the mesh is flat, or too fine for Coal."""
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
    return hull_in_metres(find_or_compute(*hull_question(vertices, triangles, unit)), unit)


def hull_question(vertices: np.ndarray, triangles: np.ndarray, unit: float) -> tuple[str, Arrays, Callable[[], Arrays]]:
    """Return name, inputs and computation of the hull of a mesh, (v, 3) and (t, 3), for `find_or_compute`.

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
    """Return the stand-off of a hull from a body, less `Solid.reach` [m]."""
    enough = HULL_STAND_OFF + body.reach
    distance = stand_off(around, body, enough, ROUGH_TOLERANCE)
    return (stand_off(around, body, enough) if distance > enough else distance) - body.reach


def _wall(vertices: np.ndarray, triangles: np.ndarray) -> str:
    """Return the reason why a mesh has no inside; "" of a closed one."""
    surface = mesh_surface(vertices, triangles)
    return "" if surface is None or surface.solid else surface.warnings[-1]


def _fill_volume(around: Surface, distance: float, body: Solid) -> float:
    """Return the volume that a hull fills: sealed hollows, and others beyond its stand-off [m^3]; 0 if open."""
    if not body.closed:
        return 0.0
    vertices, triangles = body.surface.vertices, body.surface.triangles
    more = volume(around.vertices, around.triangles) - volume(vertices, triangles) - distance * around.area
    sealed = find_nested(vertices, triangles).volume
    return max(sealed, more if more > LEAST_FILLED * volume(around.vertices, around.triangles) else 0.0)


HARDLY_METRES = 10.0  # a link's mesh that is longer was probably drawn in millimetres [m]
SLIVER = 1e-12  # twice the area of a triangle over its longest edge's square, up to which it is a line

Meshes = Mapping[str, tuple[Path, np.ndarray, FileMesh]]
"""File, scale (3,) and triangles of each mesh, by the name of its collision shape."""


def read_meshes(facts: UrdfFacts, warnings: list[str]) -> tuple[str, Meshes]:
    """Read the mesh of every `<collision>`, and return the URDF with a sphere in place of each, for Pinocchio to parse.

    The warnings get a sentence for each file whose own unit isn't applied. RobotInvalid, with line, link and mesh, if
    one can't be read.
    """
    root = etree.fromstring(facts.text.encode())
    known: dict[tuple[str, str], FileMesh] = {}
    meshes = {}
    for link in root.findall("link"):
        name = link.get("name")
        for number, collision in enumerate(link.findall("collision")):
            mesh = collision.find("geometry")[0]
            if mesh.tag != "mesh":
                continue
            file, written = mesh.get("filename"), mesh.get("scale", "1 1 1")
            scale = np.array(written.split(), np.float64)
            uri, line = facts.meshes.get(file, file), facts.collisions[name][number].line
            try:
                if (file, written) not in known:
                    known[file, written] = read_mesh(Path(file), scale)
                    if unit := find_ignored_unit(Path(file)):
                        warnings.append(
                            f"link {name!r}: mesh {uri!r} states its unit, {unit}; as other tools do, its numbers times"
                            " the `scale` of its <mesh> are taken for metres"
                        )
            except MeshFault as fault:
                message = f"line {line}: mesh {uri!r} of link {name!r} {fault}"
                raise RobotInvalid(message, link=name, uri=uri, line=line) from None
            if not _has_area(known[file, written]):
                warnings.append(
                    f"line {line}: link {name!r}: mesh {uri!r} has no area: it is judged as a line or point of"
                    f" {1e3 * THICKNESS:g} mm"
                )
            meshes[f"{name}_{number}"] = Path(file), scale, known[file, written]
            collision.find("geometry").replace(mesh, etree.Element("sphere", radius="1"))
    return etree.tostring(root, encoding="unicode"), meshes


def choose_shapes(
    model: Any, geometry: Any, meshes: Meshes, uris: Mapping[str, str], size: float, warnings: list[str]
) -> tuple[GeometryChoice, ...]:
    """Give each shape that represents a mesh its triangles, or its hull where that is as tight; return the choices.

    Args:
        model: Pinocchio model that the geometry belongs to.
        geometry: Pinocchio geometry model of the text that `read_meshes` returned; changed in place.
        meshes: The meshes that it read.
        uris: The URDF's URIs of meshes, by the paths of their files.
        size: The robot's.
        warnings: Gets a sentence for each link whose hull fills more than a tight one does, or whose mesh has no inside
            or is so large that its numbers are hardly metres.
    """
    choices = []
    areas = {id(mesh): mesh for *_, mesh in meshes.values() if _has_area(mesh)}
    settled = _choose_for_meshes(areas, power_of_two(size))
    for shape in geometry.geometryObjects:
        link = model.frames[shape.parentFrame].name
        path, scale, mesh = meshes.get(shape.name) or (Path(), np.ones(3), None)
        one = settled.get(id(mesh))
        if mesh is not None and one is None:
            shape.geometry, placement = _thin_box(mesh.vertices)
            shape.placement = shape.placement * placement
        if mesh is None or one is None:
            choices.append(GeometryChoice(shape.name, link, type(shape.geometry).__name__.lower(), "primitive"))
            continue
        shape.geometry, shape.meshPath, shape.meshScale = one.shape, str(path), scale
        uri = uris.get(str(path), shape.name)
        if (extent := float(np.ptp(mesh.vertices, axis=0).max())) > HARDLY_METRES:
            warnings.append(f"link {link!r}: mesh {uri!r} is {extent:.4g} m large: {_unit_hint(path)}")
        choices.append(GeometryChoice(shape.name, link, "mesh", one.judged_as, one.stand_off))
        if one.wall:
            warnings.append(f"link {link!r}: mesh {uri!r}: {one.wall}")
        if one.filled > 0.0:
            hollows = f"{1e6 * one.filled:.3g} cm^3" if one.filled < 1e-3 else f"{1e3 * one.filled:.3g} l"
            warnings.append(f"link {link!r}: mesh {uri!r} is judged by its hull, which fills {hollows} of hollows")
    return tuple(choices)


class _MeshChoice(NamedTuple):
    """The shape by which a mesh is tested."""

    shape: Any
    judged_as: str  # `GeometryChoice.judged_as`
    stand_off: float  # from the mesh [m]
    filled: float  # volume of hollows that it fills [m^3]
    wall: str  # why the mesh has no inside, or ""


def _choose_for_meshes(meshes: Mapping[int, FileMesh], unit: float) -> dict[int, _MeshChoice]:
    """Settle each mesh, by lengths in a unit [m]; hulls of new ones are found on all processors.

    Known results are read by this thread alone: threads must not load kernels at the same time.
    """
    settled: dict[int, _MeshChoice] = {}

    def choose_one(key: int, mesh: FileMesh) -> None:
        settled[key] = _choose_shape(mesh, find_or_compute(*hull_question(*mesh, unit)), unit)

    works = []
    for key, mesh in meshes.items():
        known = recall(*hull_question(*mesh, unit))
        if known is None:
            works.append(functools.partial(choose_one, key, mesh))
        else:
            settled[key] = _choose_shape(mesh, known, unit)
    if works:
        load_imported("cover.", "distance.", "linalg.")
        run_queue(iter(works), min(usable_processors(), len(works)))
    return settled


def _choose_shape(mesh: FileMesh, found: Arrays, unit: float) -> _MeshChoice:
    found = hull_in_metres(found, unit)
    (distance,), (filled,) = found["stand_off"].tolist(), found["filled"].tolist()
    if distance <= HULL_STAND_OFF * unit:
        return _MeshChoice(convex(found["vertices"], found["triangles"]), "convex hull", distance, filled, "")
    tree = bvh(*mesh)
    know_triangulation(tree, mesh.triangles, unit)
    return _MeshChoice(tree, "triangle mesh", 0.0, 0.0, found["wall"].tobytes().decode())


def _unit_hint(path: Path) -> str:
    if path.suffix.lower() == ".dae":
        return f"its file states a unit of {unit_of(path):g} m; is that right?"
    return 'are its numbers millimetres? Then its <mesh> needs scale="0.001 0.001 0.001"'


def _has_area(mesh: FileMesh) -> bool:
    """Check that some triangle has an area, but for rounding; most meshes show it by their first triangles."""
    for first in range(0, len(mesh.triangles), 1024):
        a, b, c = np.moveaxis(mesh.vertices[mesh.triangles[first : first + 1024]], 1, 0)
        edges = np.maximum(((b - a) ** 2).sum(axis=1), ((c - a) ** 2).sum(axis=1))
        if (np.linalg.norm(np.cross(b - a, c - a), axis=1) > SLIVER * edges).any():
            return True
    return False


def _thin_box(points: np.ndarray) -> tuple[Any, Any]:
    """Return a box that contains points (n, 3) on a line, or at one place, and its placement, pinocchio.SE3."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    axes = np.linalg.svd(points - middle)[2]
    axes[2] *= np.sign(np.linalg.det(axes))
    extents = 2.0 * np.abs((points - middle) @ axes.T).max(axis=0)
    return coal.Box(*(extents + THICKNESS).tolist()), pin.SE3(axes.T, middle)
