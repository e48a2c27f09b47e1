"""Collision shapes from the mesh files of a URDF: Pinocchio places them, our reader reads them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.geometry.bvh import bvh
from guidefield.robot.mesh_files.fault import MeshFault
from guidefield.robot.mesh_files.reading import FileMesh, ignored_unit, read_mesh
from guidefield.robot.model.shapes import know_triangulation
from guidefield.robot.urdf.facts import UrdfFacts
from guidefield.robot.urdf.links import THICKNESS

SLIVER = 1e-12
"""Twice the area of a triangle over its longest edge's square, up to which it is a line."""

Meshes = Mapping[str, tuple[Path, np.ndarray, FileMesh]]
"""File, scale (3,) and triangles of each mesh, by the name of its collision shape."""


def read_meshes(facts: UrdfFacts, warnings: list[str]) -> tuple[str, Meshes]:
    """Read the mesh of every `<collision>`, and put a primitive in its place.

    Args:
        facts: The URDF as checked; its meshes are absolute paths.
        warnings: Gets a sentence for each file whose own unit isn't applied.

    Returns:
        The URDF with a sphere for each mesh, for Pinocchio to parse; and the meshes.

    Raises:
        RobotInvalid: if a mesh can't be read; names line, link and mesh.
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
                    if unit := ignored_unit(Path(file)):
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


def put_meshes(geometry: Any, meshes: Meshes) -> None:
    """Give each shape that stands for a mesh its triangles.

    Args:
        geometry: Pinocchio geometry model of the text that `read_meshes` returned; changed in place.
        meshes: What it read.
    """
    trees: dict[int, Any] = {}
    for shape in geometry.geometryObjects:
        if shape.name not in meshes:
            continue
        path, scale, mesh = meshes[shape.name]
        if _has_area(mesh):
            if id(mesh) not in trees:
                trees[id(mesh)] = bvh(mesh.vertices, mesh.triangles)
                know_triangulation(trees[id(mesh)], mesh.triangles)
            shape.geometry, shape.meshPath, shape.meshScale = trees[id(mesh)], str(path), scale
        else:
            shape.geometry, placement = _thin_box(mesh.vertices)
            shape.placement = shape.placement * placement


def _has_area(mesh: FileMesh) -> bool:
    """Check that some triangle has an area, but for rounding; most meshes show it by their first triangles."""
    return any(_is_area(mesh.vertices[mesh.triangles[k : k + 1024]]) for k in range(0, len(mesh.triangles), 1024))


def _is_area(corners: np.ndarray) -> bool:
    a, b, c = np.moveaxis(corners, 1, 0)
    edges = np.maximum(((b - a) ** 2).sum(axis=1), ((c - a) ** 2).sum(axis=1))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return bool((areas > SLIVER * edges).any())


def _thin_box(points: np.ndarray) -> tuple[Any, Any]:
    """A box that contains points (n, 3) on a line, or at one place, and its placement, pinocchio.SE3."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    axes = np.linalg.svd(points - middle)[2]
    axes[2] *= np.sign(np.linalg.det(axes))
    extents = 2.0 * np.abs((points - middle) @ axes.T).max(axis=0)
    return coal.Box(*(extents + THICKNESS).tolist()), pin.SE3(axes.T, middle)
