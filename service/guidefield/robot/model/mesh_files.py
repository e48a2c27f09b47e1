"""Mesh files around Pinocchio's reader: written plainly before it, their vertices checked after it."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import coal
import numpy as np
from lxml import etree

from guidefield.errors import RobotInvalid

FURTHEST_VERTEX = 1e4
"""No vertex may be further than this from its link along an axis [m]: a larger link is a mistake in its units."""

_VERTEX = re.compile(rb"^[ \t]*v[ \t][^\n]*", re.MULTILINE)
_BARE_POINT = re.compile(rb"(?<=[ \t])\.(?=\d)")
_MISREAD = re.compile(rb"^[ \t]*v[ \t](?:[^\n]*[ \t])?\.\d", re.MULTILINE)


@contextmanager
def written_plainly(urdf: str) -> Iterator[tuple[str, Mapping[str, str]]]:
    """A URDF with copies of those OBJ files that the reader would misread; they are there while the block runs.

    The reader takes no number that begins with its point, such as ``.1``: it leaves the vertex out, and the indices of
    all later ones are off by one.

    Args:
        urdf: A URDF whose meshes are absolute paths.

    Yields:
        The URDF to read, and the path of each file by that of its copy.
    """
    root = etree.fromstring(urdf.encode())
    copied: dict[str, str] = {}
    with tempfile.TemporaryDirectory(prefix="guidefield-") as folder:
        for mesh in root.iterfind(".//collision/geometry/mesh"):
            path = mesh.get("filename")
            content = Path(path).read_bytes() if path.lower().endswith(".obj") else b""
            if _MISREAD.search(content):
                copy = str(Path(folder) / f"{len(copied)}.obj")
                Path(copy).write_bytes(_VERTEX.sub(lambda line: _BARE_POINT.sub(b"0.", line[0]), content))
                mesh.set("filename", copy)
                copied[copy] = path
        yield (etree.tostring(root, encoding="unicode") if copied else urdf), copied


def check_vertices(model: Any, geometry: Any, uris: Mapping[str, str]) -> None:
    """Check what was read of mesh files.

    Args:
        model: Pinocchio model that the geometry belongs to.
        geometry: Pinocchio geometry model.
        uris: What the URDF calls a mesh, by the path of its file.

    Raises:
        RobotInvalid: if a vertex isn't finite, or is further than `FURTHEST_VERTEX` from its link; names mesh and link.
    """
    for shape in geometry.geometryObjects:
        if not isinstance(shape.geometry, coal.BVHModelBase):
            continue
        vertices = np.asarray(shape.geometry.vertices())
        wrong = np.flatnonzero(~np.all(np.abs(vertices) <= FURTHEST_VERTEX, axis=1))
        if len(wrong):
            link, uri = model.frames[shape.parentFrame].name, uris.get(shape.meshPath, shape.name)
            raise RobotInvalid(
                f"mesh {uri!r} of link {link!r} has a vertex at {vertices[wrong[0]].tolist()}; its coordinates must be "
                f"numbers of at most {FURTHEST_VERTEX:g} m",
                link=link,
                uri=uri,
            )
