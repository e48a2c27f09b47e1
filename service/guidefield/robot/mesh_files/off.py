"""OFF files (Geomview): vertices, faces of any number of corners."""

from __future__ import annotations

import re

from guidefield.robot.mesh_files.fault import MeshFault
from guidefield.robot.mesh_files.numbers import Triangles, check_indices, floats, integers
from guidefield.robot.mesh_files.polygons import triangulate

_KEYWORD = re.compile(rb"(ST)?C?N?(4?n?)OFF")


def read_off(content: bytes) -> Triangles:
    """Read an OFF file; normals, colours and texture coordinates are left out.

    Raises:
        MeshFault: if it is binary, of other than three dimensions, cut short or malformed.
    """
    lines = [line for line in (row.partition(b"#")[0].split() for row in content.splitlines()) if line]
    if lines and (keyword := _KEYWORD.fullmatch(lines[0][0])):
        if keyword[2]:
            raise MeshFault(f"is of other than three dimensions ({lines[0][0].decode()}), which is not read")
        if b"BINARY" in lines[0]:
            raise MeshFault("is a binary OFF file, which is not read; export it as text")
        lines = [lines[0][1:], *lines[1:]] if len(lines[0]) > 1 else lines[1:]
    if not lines or len(lines[0]) < 2:
        raise MeshFault("is no OFF file: it has no numbers of vertices and faces")
    count, faces = integers(b" ".join(lines[0][:2]), "numbers of vertices and faces").tolist()
    rows, outlines = lines[1 : 1 + count], lines[1 + count : 1 + count + faces]
    if len(rows) < count or len(outlines) < faces:
        raise MeshFault(f"is cut short: it states {count} vertices and {faces} faces and holds fewer")
    if any(len(row) < 3 for row in rows):
        raise MeshFault("has a vertex of fewer than three numbers")
    vertices = floats(b" ".join([word for row in rows for word in row[:3]]), "vertices").reshape(-1, 3)
    sizes = integers(b" ".join([outline[0] for outline in outlines]), "faces")
    used = [outline[1 : 1 + size] for outline, size in zip(outlines, sizes.tolist(), strict=True)]
    corners = integers(b" ".join([word for outline in used for word in outline]), "faces")
    if len(corners) != sizes.sum():
        raise MeshFault("has a face with fewer corners than it states")
    check_indices(corners, len(vertices))
    return vertices, triangulate(vertices, corners, sizes)
