"""A mesh file of any kind as triangles: vertices at one place merged, in metres, scaled as a URDF says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from guidefield.geometry.closed import compact
from guidefield.robot.mesh_files.collada import read_collada, read_unit
from guidefield.robot.mesh_files.fault import MeshFault
from guidefield.robot.mesh_files.gltf import beside, buffer_files, read_gltf
from guidefield.robot.mesh_files.numbers import Triangles
from guidefield.robot.mesh_files.obj import read_obj
from guidefield.robot.mesh_files.off import read_off
from guidefield.robot.mesh_files.ply import read_ply
from guidefield.robot.mesh_files.stl import read_stl
from guidefield.robot.mesh_files.three_mf import UNITS, read_three_mf, stated_unit

FARTHEST_VERTEX = 1e4
"""No vertex may be farther than this from its link along an axis [m]: a larger link is a mistake in its units."""

READERS: dict[str, Callable[[bytes, Path], Triangles]] = {
    ".3mf": lambda content, _: read_three_mf(content),
    ".dae": lambda content, _: read_collada(content),
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".obj": lambda content, _: read_obj(content),
    ".off": lambda content, _: read_off(content),
    ".ply": lambda content, _: read_ply(content),
    ".stl": lambda content, _: read_stl(content),
}
"""Reader by kind of file."""

POINTER = b"version https://git-lfs.github.com/spec/"
PAGES = (b"<!doctype html", b"<html")


class FileMesh(NamedTuple):
    """The triangles of a mesh file; both arrays are read-only.

    Attributes:
        vertices: Shape (v, 3) [m], those that triangles use, each once.
        triangles: Indices of vertices, shape (t, 3), each with three different ones; counter-clockwise from outside as
            in the file, also where a negative scale mirrors it.
    """

    vertices: np.ndarray
    triangles: np.ndarray


def read_mesh(path: Path, scale: np.ndarray | None = None) -> FileMesh:
    """Read a mesh file.

    Args:
        path: The file; its suffix says of which kind it is.
        scale: Factors along its axes, shape (3,).

    Raises:
        MeshFault: if it can't be read, has no triangles, or a vertex isn't within `FARTHEST_VERTEX`.
    """
    content = content_of(path)
    try:
        vertices, triangles = READERS[path.suffix.lower()](content, path.parent)
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
    merged, kept = _merged(vertices, triangles)
    for array in (merged, kept):
        array.setflags(write=False)
    return FileMesh(merged, kept)


def content_of(path: Path) -> bytes:
    """Return the bytes of a mesh file.

    Raises:
        MeshFault: if it can't be opened, is empty, or is something that stands in for a file.
    """
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
    """Return the files that hold part of a mesh, as paths relative to its folder: the buffers of a glTF file.

    Raises:
        MeshFault: if the file can't be read, or one isn't in its folder.
    """
    if path.suffix.lower() not in (".gltf", ".glb"):
        return []
    names = list(dict.fromkeys(buffer_files(content_of(path))))
    return [beside(path.parent, name).relative_to(path.parent.resolve()).as_posix() for name in names]


def unit_of(path: Path) -> float:
    """Return the length of the unit by which a file's numbers become metres; 1 for all kinds but COLLADA.

    Raises:
        MeshFault: if the file can't be read.
    """
    return read_unit(content_of(path)) if path.suffix.lower() == ".dae" else 1.0


def ignored_unit(path: Path) -> str | None:
    """Return the name of a unit other than metres that a file states and that isn't applied, as 3MF files do.

    Raises:
        MeshFault: if the file can't be read.
    """
    if path.suffix.lower() != ".3mf":
        return None
    unit = stated_unit(content_of(path))
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


def _merged(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices at one place merged; triangles without three of them left out, if others are left."""
    finite = np.where(np.isfinite(vertices), vertices, 0.0)  # those that no triangle uses may be anything
    merged, kept, _ = compact(finite, triangles)
    if not len(kept):
        return finite[triangles.reshape(-1)], np.arange(3 * len(triangles)).reshape(-1, 3)
    return merged, kept
