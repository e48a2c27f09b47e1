"""A mesh file as it is judged, held against Assimp's reading of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from guidefield.geometry.surfaces import area_of
from guidefield.referee.shapes import UnreadableMesh, read_mesh_file
from guidefield.robot.mesh_files.numbers import MeshFault
from guidefield.robot.mesh_files.reading import read_mesh

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
