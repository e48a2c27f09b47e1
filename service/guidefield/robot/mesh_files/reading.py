"""Read mesh files of any kind (OBJ, OFF and STL here), vertices at one place merged, in metres, scaled by the URDF.

Collision, drawing and cases for the referee use this reader. A further kind needs an entry in `READERS`, its mark in
kinds.py, branches in `companions`, `unit_of`, `up_axis`, Assimp to know it, and entries in sent_meshes.py if sent.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from guidefield.geometry.closed import compact
from guidefield.robot.mesh_files.gltf import beside, buffer_files, read_gltf
from guidefield.robot.mesh_files.kinds import STL_FACET, STL_HEADER, is_binary_stl, recognize
from guidefield.robot.mesh_files.numbers import (
    MeshFault,
    Objects,
    Triangles,
    check_indices,
    floats,
    integers,
    triangulate,
)
from guidefield.robot.mesh_files.ply import read_ply
from guidefield.robot.mesh_files.xml_formats import (
    UNITS,
    read_collada,
    read_collada_unit,
    read_collada_up_axis,
    read_three_mf,
    read_three_mf_unit,
)

FARTHEST_VERTEX = 1e4
"""No vertex may be farther than this from its link along an axis [m]: a larger link is a mistake in its units."""

READERS: dict[str, Callable[[bytes, Path], Objects]] = {
    ".3mf": lambda content, _: read_three_mf(content),
    ".dae": lambda content, _: read_collada(content),
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".obj": lambda content, _: read_obj(content),
    ".off": lambda content, _: Objects(*read_off(content)),
    ".ply": lambda content, _: Objects(*read_ply(content)),
    ".stl": lambda content, _: read_stl(content),
}
"""Reader by kind of file."""

POINTER = b"version https://git-lfs.github.com/spec/"
PAGES = (b"<!doctype html", b"<html")


class FileMesh(NamedTuple):
    """The triangles of a mesh file, read-only."""

    vertices: np.ndarray  # shape (v, 3) [m], those that triangles use, each once
    # indices of vertices, shape (t, 3), each with three different ones; counter-clockwise from outside as in the file,
    # also where a negative scale mirrors it
    triangles: np.ndarray


def read_mesh(path: Path, scale: np.ndarray | None = None) -> FileMesh:
    """Read a mesh file, by its content or, where that is unclear, its suffix, with factors (3,) along its axes.

    Raises:
        MeshFault: if it can't be read, has no triangles, or a vertex isn't within `FARTHEST_VERTEX`.
    """
    vertices, triangles, _ = _scale_objects(path, scale)
    return _merge(vertices, triangles)


def read_objects(path: Path, scale: np.ndarray | None = None) -> list[tuple[str, FileMesh]]:
    """Read the objects of a mesh file as `read_mesh`: nodes, groups or solids with their names, "" if unnamed."""
    vertices, triangles, firsts = _scale_objects(path, scale)
    names, begins = ["", *(name for name, _ in firsts)], [0, *(first for _, first in firsts)]
    ends = [*begins[1:], len(triangles)]
    objects = []
    for name, begin, end in zip(names, begins, ends, strict=True):
        if end > begin:
            used, rows = np.unique(triangles[begin:end], return_inverse=True)
            objects.append((name, _merge(vertices[used], rows.reshape(-1, 3))))
    return objects


def _scale_objects(path: Path, scale: np.ndarray | None) -> Objects:
    kind, content = _kind_and_content(path)
    try:
        vertices, triangles, firsts = READERS[kind](content, path.parent)
    except MeshFault:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise MeshFault(f"is malformed: {error}") from None
    if scale is not None and (scale != 1.0).any():
        with np.errstate(over="ignore", invalid="ignore"):
            vertices = vertices * scale
        triangles = triangles[:, ::-1] if np.prod(np.sign(scale)) < 0.0 else triangles
    if not len(triangles):
        raise MeshFault("has no triangles")
    _check_places(vertices, triangles)
    return Objects(vertices, triangles, firsts)


def plain_file(path: Path) -> tuple[str, bytes]:
    """Return name and content of a mesh file for any reader: with the suffix of its content, no byte order mark."""
    kind, content = _kind_and_content(path)
    return path.name if kind == path.suffix.lower() else f"{path.name}{kind}", content


def _kind_and_content(path: Path) -> tuple[str, bytes]:
    return recognize(content_of(path), path.suffix.lower())


def content_of(path: Path) -> bytes:
    """Return the bytes of a file; MeshFault if it can't be opened, is empty, or something stands in for it."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise MeshFault(f"can't be opened: {error.strerror}") from None
    if not content:
        raise MeshFault("is empty: it has 0 bytes")
    if content.startswith(POINTER):
        raise MeshFault("is a pointer of git-LFS and not the file itself: run `git lfs pull` where it comes from")
    if content[:200].lstrip(b"\xef\xbb\xbf \t\r\n").lower().startswith(PAGES):
        raise MeshFault("is an HTML page and not the file itself: download that")
    return content


def companions(path: Path) -> list[str]:
    """Return the files, relative to its folder, that hold part of a mesh: buffers of glTF; MeshFault if beyond it."""
    if path.suffix.lower() not in (".gltf", ".glb"):
        return []
    names = list(dict.fromkeys(buffer_files(content_of(path))))
    return [beside(path.parent, name).relative_to(path.parent.resolve()).as_posix() for name in names]


def unit_of(path: Path) -> float:
    """Return the length of the unit by which a file's numbers become metres; 1 for all kinds but COLLADA."""
    return read_collada_unit(content_of(path)) if path.suffix.lower() == ".dae" else 1.0


def up_axis(path: Path) -> str:
    """Return the axis that is up in a file: y of glTF, as stated of COLLADA, else z; `read_mesh` doesn't turn it."""
    kind, content = _kind_and_content(path)
    return read_collada_up_axis(content) if kind == ".dae" else "y" if kind in (".gltf", ".glb") else "z"


def find_ignored_unit(path: Path) -> str | None:
    """Return the name of a unit other than metres that a file states and that isn't applied, as 3MF files do."""
    if path.suffix.lower() != ".3mf":
        return None
    unit = read_three_mf_unit(content_of(path))
    return unit if UNITS[unit] != 1.0 else None


def _check_places(vertices: np.ndarray, triangles: np.ndarray) -> None:
    if (np.abs(vertices) <= FARTHEST_VERTEX).all():  # false where one isn't a number
        return
    used = vertices[triangles.reshape(-1)]
    wrong = np.flatnonzero(~np.all(np.abs(used) <= FARTHEST_VERTEX, axis=1))
    if len(wrong):
        raise MeshFault(
            f"has a vertex at {used[wrong[0]].tolist()}; its coordinates must be numbers of at most "
            f"{FARTHEST_VERTEX:g} m"
        )


def _merge(vertices: np.ndarray, triangles: np.ndarray) -> FileMesh:
    """Merge vertices at one place; leave out triangles without three of them, if others are left."""
    finite = np.where(np.isfinite(vertices), vertices, 0.0)  # those that no triangle uses may be anything
    merged, kept, _ = compact(finite, triangles)
    if not len(kept):
        merged, kept = finite[triangles.reshape(-1)], np.arange(3 * len(triangles)).reshape(-1, 3)
    for array in (merged, kept):
        array.setflags(write=False)
    return FileMesh(merged, kept)


def _lines(content: bytes) -> bytes:
    return content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")


_COMMENT = re.compile(rb"#[^\n]*")
_FREE = re.compile(rb"^[ \t]*(curv2?|surf)[ \t]", re.MULTILINE)
_VERTEX = re.compile(rb"^[ \t]*v[ \t]+([^\n]*)", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*fo?[ \t]+([^\n]*)", re.MULTILINE)
_OTHERS = re.compile(rb"/[^\s]*")  # texture coordinates and normals of a corner
_OBJECT = re.compile(rb"^[ \t]*o[ \t]+([^\n]*)", re.MULTILINE)
_GROUP = re.compile(rb"^[ \t]*g[ \t]+([^\n]*)", re.MULTILINE)


def read_obj(content: bytes) -> Objects:
    """Read an OBJ file, its objects, or groups where it has none. Lines and points are left out.

    MeshFault if it is malformed, or has free forms.
    """
    text = _lines(content).replace(b"\\\n", b" ")
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
    objects = list(_OBJECT.finditer(text) if _OBJECT.search(text) else _GROUP.finditer(text))
    places = [found.start() for found in _FACE.finditer(text)] if objects else []
    before = np.r_[0, np.cumsum(np.maximum(sizes - 2, 0))]
    return Objects(vertices, triangulate(vertices, corners, sizes), _firsts(objects, places, before))


def _firsts(heads: Sequence[re.Match[bytes]], places: Sequence[int], before: np.ndarray) -> tuple[tuple[str, int], ...]:
    """Return name and first triangle of each object by its head, places of faces, triangles before these (f + 1,)."""
    rows = before[np.searchsorted(places, [head.start() for head in heads])].tolist()
    return tuple((head[1].decode(errors="replace").strip(), row) for head, row in zip(heads, rows, strict=True))


def _vertices(rows: list[bytes]) -> np.ndarray:
    """Read the first three numbers of each row, shape (v, 3); weights and colours may follow."""
    values = floats(b"\n".join(rows), "vertices")
    if any(row.count(b" ") != 2 for row in rows):
        words = [row.split() for row in rows]
        if any(len(one) < 3 for one in words):
            raise MeshFault("has a vertex of fewer than three numbers")
        if len(values) != 3 * len(rows):
            values = floats(b" ".join([word for one in words for word in one[:3]]), "vertices")
    return values.reshape(-1, 3)


_KEYWORD = re.compile(rb"(ST)?C?N?(4?n?)OFF")


def read_off(content: bytes) -> Triangles:
    """Read an OFF file; normals, colours and texture coordinates are left out.

    MeshFault if it is binary, of other than three dimensions, cut short or malformed.
    """
    lines = [line for line in (row.partition(b"#")[0].split() for row in _lines(content).split(b"\n")) if line]
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


FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

_STL_VERTEX = re.compile(rb"^[ \t]*vertex[ \t]+([^\r\n]*)", re.MULTILINE | re.IGNORECASE)
_FACET = re.compile(rb"^[ \t]*facet\b", re.MULTILINE | re.IGNORECASE)
_STL_WORD = re.compile(rb"\s+(facet|outer|vertex|endloop|endfacet|endsolid)\b", re.IGNORECASE)
"""Words that begin a line, though some files have one line alone."""
_SOLID = re.compile(rb"^[ \t]*solid\b([^\n]*)", re.MULTILINE | re.IGNORECASE)
_END = re.compile(rb"^[ \t]*end[ \t]*solid\b", re.MULTILINE | re.IGNORECASE)


def read_stl(content: bytes) -> Objects:
    """Read an STL file; one of text by its solids. MeshFault if it is cut short or malformed.

    Its first word doesn't tell its kind: many a binary file begins with ``solid``. The length does, which a binary file
    states as a number of facets.
    """
    stated = int.from_bytes(content[80:STL_HEADER], "little") if len(content) >= STL_HEADER else -1
    if is_binary_stl(content):
        return _binary(content, stated)
    is_text = content.lstrip()[:5].lower() == b"solid"
    if is_text and re.search(rb"\bfacet\s+normal\b", content, re.IGNORECASE):
        text = _lines(content)
        return _ascii(text if _FACET.search(text) else _STL_WORD.sub(rb"\n\1", text))
    if stated < 0:
        if is_text:
            return Objects(np.empty((0, 3)), np.empty((0, 3), np.int64))
        raise MeshFault(f"is no STL: it has {len(content)} bytes, and a binary one at least {STL_HEADER}")
    if len(content) > STL_HEADER + stated * STL_FACET:  # some writers append what nobody asks for
        return _binary(content, stated)
    whole = (len(content) - STL_HEADER) // STL_FACET
    raise MeshFault(f"is cut short or no STL: it states {stated} facets and holds {whole}")


def _binary(content: bytes, count: int) -> Objects:
    corners = np.frombuffer(content, FACET, count, STL_HEADER)["corners"]
    return Objects(corners.reshape(-1, 3).astype(np.float64), np.arange(3 * count).reshape(-1, 3))


def _ascii(content: bytes) -> Objects:
    places = [found.start() for found in _FACET.finditer(content)]
    facets = len(places)
    rows = _STL_VERTEX.findall(content)
    if len(rows) != 3 * facets:
        raise MeshFault(f"is cut short or malformed: it has {facets} facets and {len(rows)} vertices")
    solids = list(_SOLID.finditer(content))
    if len(_END.findall(content)) < len(solids):
        raise MeshFault("is cut short: a solid has no 'endsolid'")
    vertices = floats(b" ".join(rows), "vertices")
    if len(vertices) != 9 * facets:
        raise MeshFault(f"has vertices that are not three numbers: {len(vertices)} numbers for {len(rows)} of them")
    firsts = _firsts(solids, places, np.arange(facets + 1))
    return Objects(vertices.reshape(-1, 3), np.arange(3 * facets).reshape(-1, 3), firsts)
