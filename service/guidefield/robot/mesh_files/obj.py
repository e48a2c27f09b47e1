"""Wavefront OBJ files: vertices and faces of all groups and materials."""

from __future__ import annotations

import numpy as np

from guidefield.robot.mesh_files.fault import MeshFault
from guidefield.robot.mesh_files.numbers import Triangles, check_indices, floats, integers
from guidefield.robot.mesh_files.polygons import triangulate

UNREAD = (b"curv", b"curv2", b"surf")
"""Free forms, which are no faces."""


def read_obj(content: bytes) -> Triangles:
    """Read an OBJ file. Groups, objects and materials divide no vertices; lines and points are left out.

    Raises:
        MeshFault: if it is malformed, or has free forms.
    """
    text = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\\\n", b" ")
    rows: list[list[bytes]] = []
    faces: list[list[bytes]] = []
    relative: list[tuple[int, int]] = []  # of a face with negative indices: its number, vertices so far
    for line in text.split(b"\n"):
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        if words[0] == b"v":
            rows.append(words[1:4])
        elif words[0] in (b"f", b"fo"):
            if b"-" in line:
                relative.append((len(faces), len(rows)))
            faces.append(words[1:])
        elif words[0] in UNREAD:
            raise MeshFault(f"has a free form ({words[0].decode()}), which is not read; export it as triangles")
    if any(len(row) < 3 for row in rows):
        raise MeshFault("has a vertex of fewer than three numbers")
    vertices = floats(b" ".join([word for row in rows for word in row]), "vertices").reshape(-1, 3)
    sizes = np.array([len(face) for face in faces], np.int64)
    named = [word for face in faces for word in face]
    if any(b"/" in word for word in named):
        named = [word.partition(b"/")[0] for word in named]
    corners = integers(b" ".join(named), "faces")
    if len(corners) != sizes.sum():
        raise MeshFault("has a face whose corner names no vertex")
    if (corners == 0).any():
        raise MeshFault("has a face with the vertex 0; an OBJ file counts from 1")
    corners = np.where(corners > 0, corners - 1, corners)
    ends = np.cumsum(sizes)
    for face, count in relative:
        of_face = corners[ends[face] - sizes[face] : ends[face]]
        of_face[of_face < 0] += count
    check_indices(corners, len(vertices))
    return vertices, triangulate(vertices, corners, sizes)
