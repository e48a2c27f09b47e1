"""Read mesh files as triangles by Assimp's own command: independent of guidefield's readers (robot/mesh_files).

The command writes a scene as it has read it, "assbin", of which nodes and meshes are taken here: the command's own
flattening takes a node that is moved by less than a hundredth for one that isn't moved.
"""

from __future__ import annotations

import functools
import os
import re
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

PREFIX = "cmeel.prefix"  # folder of the packages among which Assimp is, as Coal needs it
SECONDS = 60.0  # a file that takes the command longer isn't read [s]
HEADER = 512
SCENE, NODE, MESH = 0x1239, 0x123C, 0x1237
POSITIONS, NORMALS, TANGENTS = 1, 2, 4
TEXTURES, COLORS = 0x100, 0x10000
"""First of the flags of texture coordinates and of colours, of which there may be eight sets."""

PREPARED = {
    ".dae": (re.compile(rb"(<(?:\w+:)?up_axis>)[^<]*"), rb"\1Y_UP"),  # the axis that Assimp leaves alone
    ".off": (re.compile(rb"[ \t]*#[^\r\n]*"), b""),  # a comment may keep Assimp for ever
}
"""By kind of file, what is replaced in it before Assimp reads it."""


class UnreadableMesh(ValueError):
    """A mesh file that Assimp can't read."""


class _Node(NamedTuple):
    """A node: its affine map in its parent, shape (4, 4), its meshes, and its children."""

    placement: np.ndarray
    meshes: tuple[int, ...]
    children: tuple[_Node, ...]


def read(path: Path) -> np.ndarray:
    """Read the triangles of a mesh file's scene, shape (t, 3, 3) [m]; those without extent are left out.

    The unit of a COLLADA file counts, as Assimp has it; its up axis doesn't. Numbers are in single precision.

    Raises:
        UnreadableMesh: if the command is missing, or can't read the file.
    """
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "read.assbin"
        if path.suffix.lower() in PREPARED:
            pattern, instead = PREPARED[path.suffix.lower()]
            content = pattern.sub(instead, path.read_bytes())
            path = Path(folder) / f"mesh{path.suffix}"
            path.write_bytes(content)
        _run("export", str(path), str(made), "-fassbin", "-tri")
        try:
            root, meshes = _scene(made.read_bytes())
        except (struct.error, ValueError, IndexError) as error:
            raise UnreadableMesh(f"what Assimp made of it can't be read: {error}") from None
    placed = [np.empty((0, 3, 3)), *_place_meshes(root, np.eye(4), meshes)]
    triangles: np.ndarray = np.concatenate(placed)
    if not len(triangles):
        raise UnreadableMesh("Assimp finds no triangles in it")
    distinct = [(triangles[:, i] != triangles[:, j]).any(axis=1) for i, j in ((0, 1), (1, 2), (2, 0))]
    proper: np.ndarray = np.logical_and.reduce(distinct)
    return triangles[proper] if proper.any() else triangles


@functools.cache
def _prefix() -> Path:
    """Find the folder of the command and its libraries: that of the package cmeel-assimp, or a conda environment's."""
    try:
        return Path(str(distribution("cmeel-assimp").locate_file(PREFIX)))
    except PackageNotFoundError:
        return Path(sys.prefix)


def _run(*arguments: str) -> None:
    prefix = _prefix()
    paths = dict.fromkeys(("LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH"), str(prefix / "lib"))
    try:
        ran = subprocess.run(  # noqa: S603 - of a package that is installed, with files of our own
            [str(prefix / "bin" / "assimp"), *arguments],
            env={**os.environ, **paths},
            capture_output=True,
            check=False,
            timeout=SECONDS,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UnreadableMesh(f"Assimp's command can't be run: {error}") from None
    if ran.returncode:
        last = (ran.stdout + ran.stderr).decode(errors="replace").strip().splitlines()
        raise UnreadableMesh(f"Assimp can't read it: {' '.join(last[-2:])}")


def _place_meshes(node: _Node, above: np.ndarray, meshes: list[np.ndarray]) -> Iterator[np.ndarray]:
    """Yield triangles of a node's meshes and of all below it, (t, 3, 3) each; a mirrored node's are turned round."""
    placement = above @ node.placement
    turned = slice(None, None, -1) if np.linalg.det(placement[:3, :3]) < 0.0 else slice(None)
    for index in node.meshes:
        yield (meshes[index] @ placement[:3, :3].T + placement[:3, 3])[:, turned]
    for child in node.children:
        yield from _place_meshes(child, placement, meshes)


def _scene(content: bytes) -> tuple[_Node, list[np.ndarray]]:
    scene = _Chunk(content, HEADER, SCENE)
    _, count, *_ = scene.take("7I")
    root = _node(scene.chunk(NODE))
    return root, [_mesh(scene.chunk(MESH)) for _ in range(count)]


def _node(chunk: _Chunk) -> _Node:
    (length,) = chunk.take("I")
    chunk.take(f"{length}s")
    placement = np.array(chunk.take("16f"), float).reshape(4, 4)
    children, meshes, _ = chunk.take("3I")
    own = chunk.take(f"{meshes}I")
    return _Node(placement, own, tuple(_node(chunk.chunk(NODE)) for _ in range(children)))


def _mesh(chunk: _Chunk) -> np.ndarray:
    _, vertices, faces, _, _, has = chunk.take("6I")
    if not has & POSITIONS:
        return np.empty((0, 3, 3))
    points = chunk.array("<f4", 3 * vertices).reshape(-1, 3).astype(float)
    chunk.array("<f4", 3 * vertices * (bool(has & NORMALS) + 2 * bool(has & TANGENTS)))
    chunk.array("<f4", 4 * vertices * sum(bool(has & COLORS << k) for k in range(8)))
    for _ in range(sum(bool(has & TEXTURES << k) for k in range(8))):
        chunk.take("I")
        chunk.array("<f4", 3 * vertices)
    kind = "<u2" if vertices < 1 << 16 else "<u4"
    table = np.dtype([("count", "<u2"), ("corners", kind, 3)])
    rows = chunk.array(table, faces, ahead=True)
    if rows is not None and (rows["count"] == 3).all():
        found: np.ndarray = points[rows["corners"].astype(int)]
        return found
    corners = []  # lines and points are among them
    for _ in range(faces):
        (count,) = chunk.take("H")
        face = chunk.array(kind, count)
        if count == 3:
            corners.append(face.astype(int))
    cut: np.ndarray = points[np.array(corners, int).reshape(-1, 3)]
    return cut


class _Chunk:
    """A chunk of an assbin file, read from its beginning on."""

    def __init__(self, content: bytes, at: int, magic: int) -> None:
        found, size = struct.unpack_from("<2I", content, at)
        if found != magic:
            raise ValueError(f"{found:#x} stands where {magic:#x} belongs")
        self._content, self._at, self.end = content, at + 8, at + 8 + size

    def take(self, form: str) -> tuple[Any, ...]:
        values = struct.unpack_from("<" + form, self._content, self._at)
        self._at += struct.calcsize("<" + form)
        return values

    def array(self, kind: Any, count: int, ahead: bool = False) -> Any:
        """Read `count` values; None if the chunk hasn't as many. With `ahead` the next read begins there again."""
        size = np.dtype(kind).itemsize * count
        if self._at + size > self.end:
            if ahead:
                return None
            raise ValueError("a chunk ends too early")
        values = np.frombuffer(self._content, kind, count, self._at)
        self._at += 0 if ahead else size
        return values

    def chunk(self, magic: int) -> _Chunk:
        """Return the next chunk within this one, and go on behind it."""
        inner = _Chunk(self._content, self._at, magic)
        self._at = inner.end
        return inner
