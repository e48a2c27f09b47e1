"""A robot whose meshes are denser: each triangle of its collision meshes is split into four, again and again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from lxml import etree

from guidefield.messages.requests import UrdfFile
from guidefield.robot.catalog import Catalog


def write_dense_copy(robot: str | dict[str, Any], times: int, folder: Path) -> dict[str, Any]:
    """Write a copy of a robot's URDF and collision meshes with more triangles; return it as a request names it.

    Args:
        robot: The robot as a request names it.
        times: How many times as many triangles: a power of four.
        folder: Where the copy goes.
    """
    named = robot if isinstance(robot, str) else UrdfFile(robot["path"], package_dirs=robot["package_dirs"])
    root = etree.fromstring(Catalog().load(named).source.urdf_text.encode())
    folder.mkdir(parents=True)
    for index, mesh in enumerate(root.iterfind(".//collision/geometry/mesh")):
        read: Any = trimesh.load(str(mesh.get("filename")).removeprefix("file://"), force="mesh", process=False)
        vertices, faces = np.asarray(read.vertices), np.asarray(read.faces)
        while len(faces) < times * len(read.faces):
            vertices, faces = trimesh.remesh.subdivide(vertices, faces)
        file = folder / f"mesh{index}.stl"
        trimesh.Trimesh(vertices, faces, process=False).export(file)
        mesh.set("filename", file.name)
    for visual in root.findall(".//visual"):
        visual.getparent().remove(visual)
    urdf = folder / "dense.urdf"
    urdf.write_bytes(etree.tostring(root))
    return {"type": "urdf_file", "path": str(urdf), "package_dirs": []}
