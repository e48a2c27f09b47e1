"""Meshes of a scene graph collected as one: each instance where its placement has it."""

from __future__ import annotations

import numpy as np

from guidefield.robot.mesh_files.fault import MeshFault
from guidefield.robot.mesh_files.numbers import Objects, Triangles

MAX_TRIANGLES = 20_000_000
"""A file of more triangles, instances counted, is refused: nested instances can double with each level."""
MAX_DEPTH = 1_000
"""A deeper nesting of nodes is refused."""
MAX_NODES = 100_000
"""A file of more nodes, instances counted, is refused."""


class Collected:
    """Triangles of instances, one after the other."""

    def __init__(self) -> None:
        self._vertices: list[np.ndarray] = []
        self._triangles: list[np.ndarray] = []
        self._firsts: list[tuple[str, int]] = []
        self._count = self._total = self._nodes = 0

    def visit(self, depth: int, name: str = "") -> None:
        """Count a node at a depth; what is added until the next one is an object of its name.

        Raises:
            MeshFault: if there are more than `MAX_NODES`, or it is deeper than `MAX_DEPTH`.
        """
        self._nodes += 1
        if depth > MAX_DEPTH:
            raise MeshFault(f"has nodes that are nested more than {MAX_DEPTH} deep, or contain themselves")
        if self._nodes > MAX_NODES:
            raise MeshFault(f"has more than {MAX_NODES} nodes, instances counted")
        self._firsts.append((name, self._total))

    def add(self, mesh: Triangles, placement: np.ndarray) -> None:
        """Add an instance of a mesh; a placement that mirrors it turns its triangles, so that they face outwards.

        Args:
            mesh: Its vertices and triangles.
            placement: Affine map from the mesh's frame to the file's, shape (4, 4).

        Raises:
            MeshFault: if there are more than `MAX_TRIANGLES`.
        """
        vertices, triangles = mesh
        self._total += len(triangles)
        if self._total > MAX_TRIANGLES:
            raise MeshFault(f"has more than {MAX_TRIANGLES} triangles, instances counted")
        if (placement != np.eye(4)).any():
            vertices = vertices @ placement[:3, :3].T + placement[:3, 3]
        if np.linalg.det(placement[:3, :3]) < 0.0:
            triangles = triangles[:, ::-1]
        self._vertices.append(vertices)
        self._triangles.append(triangles + self._count)
        self._count += len(vertices)

    def triangles(self) -> Triangles:
        """Return all instances as one mesh."""
        if not self._vertices:
            return np.empty((0, 3)), np.empty((0, 3), np.int64)
        return np.concatenate(self._vertices), np.concatenate(self._triangles)

    def objects(self) -> Objects:
        """Return all instances, those of each node as an object."""
        return Objects(*self.triangles(), tuple(self._firsts))
