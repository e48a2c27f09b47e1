"""Collision shapes from the mesh files of a URDF: Pinocchio places them, our reader reads them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.geometry.bvh import bvh
from guidefield.robot.mesh_files.fault import MeshFault
from guidefield.robot.mesh_files.reading import FileMesh, ignored_unit, read_mesh
from guidefield.robot.urdf.facts import UrdfFacts

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
        if shape.name in meshes:
            path, scale, mesh = meshes[shape.name]
            shape.geometry = trees.setdefault(id(mesh), None) or bvh(mesh.vertices, mesh.triangles)
            trees[id(mesh)] = shape.geometry
            shape.meshPath, shape.meshScale = str(path), scale
