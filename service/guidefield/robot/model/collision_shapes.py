"""Collision shapes of a URDF: Pinocchio places them, our reader reads meshes, and tight hulls stand for these."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.geometry.cache import Arrays, recall, remembered
from guidefield.geometry.convex import bvh, convex
from guidefield.kernels.jit.compilers import load_imported
from guidefield.parallel import run_queue, usable_processors
from guidefield.robot.mesh_files.numbers import MeshFault
from guidefield.robot.mesh_files.reading import FileMesh, find_ignored_unit, read_mesh, unit_of
from guidefield.robot.model.model import GeometryChoice
from guidefield.robot.model.shapes import HULL_STAND_OFF, hull_in_metres, hull_question, know_triangulation
from guidefield.robot.model.size import power_of_two
from guidefield.robot.urdf.facts import UrdfFacts
from guidefield.robot.urdf.links import THICKNESS

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


def settle(
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
    settled = _settle_meshes(areas, power_of_two(size))
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


class _SettledMesh(NamedTuple):
    """As what a mesh is judged, how far that stands off [m], what it fills beyond that [m^3], why it has no inside."""

    shape: Any
    judged_as: str
    stand_off: float
    filled: float
    wall: str


def _settle_meshes(meshes: Mapping[int, FileMesh], unit: float) -> dict[int, _SettledMesh]:
    """As what each mesh is judged, by lengths in a unit [m]; new ones are found on all processors.

    What is known is read by this thread alone: threads must not load kernels at the same time.
    """
    settled: dict[int, _SettledMesh] = {}

    def settle_one(key: int, mesh: FileMesh) -> None:
        settled[key] = _settle_mesh(mesh, remembered(*hull_question(*mesh, unit)), unit)

    works = []
    for key, mesh in meshes.items():
        known = recall(*hull_question(*mesh, unit))
        if known is None:
            works.append(functools.partial(settle_one, key, mesh))
        else:
            settled[key] = _settle_mesh(mesh, known, unit)
    if works:
        load_imported("cover.", "distance.", "linalg.")
        run_queue(iter(works), min(usable_processors(), len(works)))
    return settled


def _settle_mesh(mesh: FileMesh, found: Arrays, unit: float) -> _SettledMesh:
    found = hull_in_metres(found, unit)
    (distance,), (filled,) = found["stand_off"].tolist(), found["filled"].tolist()
    if distance <= HULL_STAND_OFF * unit:
        return _SettledMesh(convex(found["vertices"], found["triangles"]), "convex hull", distance, filled, "")
    tree = bvh(*mesh)
    know_triangulation(tree, mesh.triangles, unit)
    return _SettledMesh(tree, "triangle mesh", 0.0, 0.0, found["wall"].tobytes().decode())


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
    """A box that contains points (n, 3) on a line, or at one place, and its placement, pinocchio.SE3."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    axes = np.linalg.svd(points - middle)[2]
    axes[2] *= np.sign(np.linalg.det(axes))
    extents = 2.0 * np.abs((points - middle) @ axes.T).max(axis=0)
    return coal.Box(*(extents + THICKNESS).tolist()), pin.SE3(axes.T, middle)
