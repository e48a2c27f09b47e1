"""Wavefront OBJ files: vertices and faces of all groups and materials."""

from __future__ import annotations

import re

import numpy as np

from guidefield.robot.mesh_files.fault import MeshFault
from guidefield.robot.mesh_files.numbers import Triangles, check_indices, floats, integers
from guidefield.robot.mesh_files.polygons import triangulate

_COMMENT = re.compile(rb"#[^\n]*")
_FREE = re.compile(rb"^[ \t]*(curv2?|surf)[ \t]", re.MULTILINE)
_VERTEX = re.compile(rb"^[ \t]*v[ \t]+([^\n]*)", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*fo?[ \t]+([^\n]*)", re.MULTILINE)
_OTHERS = re.compile(rb"/[^\s]*")
"""Texture coordinates and normals of a corner."""


def read_obj(content: bytes) -> Triangles:
    """Read an OBJ file. Groups, objects and materials divide no vertices; lines and points are left out.

    Raises:
        MeshFault: if it is malformed, or has free forms.
    """
    text = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\\\n", b" ")
    if b"#" in text:
        text = _COMMENT.sub(b"", text)
    if free := _FREE.search(text):
        raise MeshFault(f"has a free form ({free[1].decode()}), which is not read; export it as triangles")
    vertices = _vertices(_VERTEX.findall(text))
    faces = _FACE.findall(text)
    sizes = np.array([len(face.split()) for face in faces], np.int64)
    named = b"\n".join(faces)
    if b"/" in named:
        named = _OTHERS.sub(b"", named)
    corners = integers(named, "faces")
    if len(corners) != sizes.sum():
        raise MeshFault("has a face whose corner names no vertex")
    if (corners == 0).any():
        raise MeshFault("has a face with the vertex 0; an OBJ file counts from 1")
    if b"-" in named:  # counted back from where the face stands
        rows, places = ([found.start() for found in kind.finditer(text)] for kind in (_VERTEX, _FACE))
        before = np.repeat(np.searchsorted(rows, places), sizes)
        corners = np.where(corners < 0, corners + before + 1, corners)
    corners = corners - 1
    check_indices(corners, len(vertices))
    return vertices, triangulate(vertices, corners, sizes)


def _vertices(rows: list[bytes]) -> np.ndarray:
    """The first three numbers of each row, shape (v, 3); weights and colours may follow."""
    values = floats(b"\n".join(rows), "vertices")
    if any(row.count(b" ") != 2 for row in rows):
        words = [row.split() for row in rows]
        if any(len(one) < 3 for one in words):
            raise MeshFault("has a vertex of fewer than three numbers")
        if len(values) != 3 * len(rows):
            values = floats(b" ".join([word for one in words for word in one[:3]]), "vertices")
    return values.reshape(-1, 3)
