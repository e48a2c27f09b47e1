"""Links of mesh files: all kinds, several parts, units, nested nodes, scales; and how Assimp reads a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from tests.robot.mesh_files import written
from tests.robot.mesh_files.written import WRITERS, Part

from guidefield.geometry.surfaces import area_of
from guidefield.referee import shapes
from guidefield.referee.shapes import UnreadableMesh, read_mesh_file
from guidefield.robot.mesh_files.numbers import MeshFault
from guidefield.robot.mesh_files.reading import read_mesh

UNITS = ("1", "0.01", "0.0254", "0.001")
LONGEST = 0.12
"""Parts of a link are within this of its frame [m]."""
MIRRORED = 0.2
"""This share of parts and of scales are mirrored."""


def draw_mesh_file(rng: np.random.Generator) -> tuple[str, bytes, str]:
    """A mesh file of several boxes.

    Returns:
        Its suffix, its content, and the `scale` of its `<mesh>`.
    """
    kind = str(rng.choice(list(WRITERS)))
    suffix, writer = WRITERS[kind]
    scale = np.where(rng.random(3) < MIRRORED, -1.0, 1.0) * (1.0 if rng.random() < 0.5 else rng.uniform(0.5, 2.0, 3))
    unit = str(rng.choice(UNITS)) if kind == "dae nodes" else "1"
    parts = [_part(rng, float(unit)) for _ in range(int(rng.integers(2, 5)))]
    content = written.dae(parts, unit=unit) if kind == "dae nodes" else writer(parts)
    return suffix.lower(), content, " ".join(repr(factor) for factor in scale.tolist())


def _part(rng: np.random.Generator, unit: float) -> Part:
    """A box somewhere, in numbers of a unit."""
    placement, turn = np.eye(4), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn)) * (-1.0 if rng.random() < MIRRORED else 1.0)
    placement[:3, :3] = turn * rng.uniform(0.7, 1.4, 3)
    placement[:3, 3] = rng.uniform(-0.5, 0.5, 3) * LONGEST / unit
    size = rng.uniform(0.05, 0.4, 3) * LONGEST / unit
    return written.part((-0.5 * size).tolist(), size.tolist(), placement)


def put_in(text: str) -> tuple[str, dict[str, Any]]:
    """Take the meshes out of a URDF whose mesh files are absolute paths.

    Returns:
        The URDF with a ball for each, and Coal's tree of what Assimp reads, by the name of the collision shape.
    """
    root = ElementTree.fromstring(text)  # noqa: S314 - drawn here, or of the catalog
    found = {}
    for link in root.iter("link"):
        for number, collision in enumerate(link.findall("collision")):
            geometry = collision.find("geometry")
            mesh = None if geometry is None else geometry.find("mesh")
            if geometry is None or mesh is None:
                continue
            corners = shapes.read_mesh_file(Path(mesh.get("filename", "")))
            corners = (corners * np.array(mesh.get("scale", "1 1 1").split(), float)).reshape(-1, 3)
            found[f"{link.get('name')}_{number}"] = shapes.surface(corners, np.arange(len(corners)).reshape(-1, 3))
            geometry.remove(mesh)
            ElementTree.SubElement(geometry, "sphere", radius="1")
    return ElementTree.tostring(root, encoding="unicode"), found


SAME = 1e-5
"""Boxes, areas and volumes may differ by this share: Assimp holds numbers in single precision."""


def compare(path: Path) -> str | None:
    """Return how the two readings of a file differ, in words; None if they don't."""
    try:
        mesh = read_mesh(path)
    except MeshFault as fault:
        return str(fault)
    try:
        other = read_mesh_file(path)
    except UnreadableMesh as error:
        return f"Assimp: {error}"
    ours = mesh.vertices[mesh.triangles]
    if len(ours) != len(other):
        return f"{len(ours)} triangles are judged, Assimp reads {len(other)}"
    size = float(np.ptp(mesh.vertices, axis=0).max())
    figures = {
        "box": (np.abs(_box(ours) - _box(other)).max(), size),
        "area": (abs(area_of(ours) - area_of(other)), area_of(ours)),
        "volume": (abs(_volume(ours) - _volume(other)), size**3),
    }
    wrong = [f"{name} by {off:.3g}" for name, (off, whole) in figures.items() if off > SAME * whole]
    return f"differs: {', '.join(wrong)}" if wrong else None


def _box(corners: np.ndarray) -> np.ndarray:
    return np.array([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])


def _volume(corners: np.ndarray) -> float:
    """The volume that triangles (t, 3, 3) enclose, as signed tetrahedra from their mean."""
    return float(np.linalg.det(corners - corners.mean(axis=(0, 1))).sum() / 6.0)
