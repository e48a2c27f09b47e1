"""STL files, binary and ASCII, of one solid or several."""

from __future__ import annotations

import re

import numpy as np

from guidefield.robot.mesh_files.fault import MeshFault
from guidefield.robot.mesh_files.numbers import Triangles, floats

HEADER = 84
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

_VERTEX = re.compile(rb"^[ \t]*vertex[ \t]+([^\r\n]*)", re.MULTILINE | re.IGNORECASE)
_FACET = re.compile(rb"^[ \t]*facet\b", re.MULTILINE | re.IGNORECASE)
_SOLID = re.compile(rb"^[ \t]*solid\b", re.MULTILINE | re.IGNORECASE)
_END = re.compile(rb"^[ \t]*end[ \t]*solid\b", re.MULTILINE | re.IGNORECASE)


def read_stl(content: bytes) -> Triangles:
    """Read an STL file.

    Its first word doesn't tell its kind: many a binary file begins with ``solid``. The length does, which a binary file
    states as a number of facets.

    Raises:
        MeshFault: if it is cut short or malformed.
    """
    stated = int.from_bytes(content[80:HEADER], "little") if len(content) >= HEADER else -1
    if len(content) == HEADER + stated * FACET.itemsize:
        return _binary(content, stated)
    if content.lstrip()[:5].lower() == b"solid" and _FACET.search(content):
        return _ascii(content.replace(b"\r\n", b"\n").replace(b"\r", b"\n"))
    if stated < 0:
        if content.lstrip()[:5].lower() == b"solid":
            return np.empty((0, 3)), np.empty((0, 3), np.int64)
        raise MeshFault(f"is no STL: it has {len(content)} bytes, and a binary one at least {HEADER}")
    if len(content) > HEADER + stated * FACET.itemsize:  # some writers append what nobody asks for
        return _binary(content, stated)
    whole = (len(content) - HEADER) // FACET.itemsize
    raise MeshFault(f"is cut short or no STL: it states {stated} facets and holds {whole}")


def _binary(content: bytes, count: int) -> Triangles:
    corners = np.frombuffer(content, FACET, count, HEADER)["corners"]
    return corners.reshape(-1, 3).astype(np.float64), np.arange(3 * count).reshape(-1, 3)


def _ascii(content: bytes) -> Triangles:
    facets = len(_FACET.findall(content))
    rows = _VERTEX.findall(content)
    if len(rows) != 3 * facets:
        raise MeshFault(f"is cut short or malformed: it has {facets} facets and {len(rows)} vertices")
    if len(_END.findall(content)) < len(_SOLID.findall(content)):
        raise MeshFault("is cut short: a solid has no 'endsolid'")
    vertices = floats(b" ".join(rows), "vertices")
    if len(vertices) != 9 * facets:
        raise MeshFault(f"has vertices that are not three numbers: {len(vertices)} numbers for {len(rows)} of them")
    return vertices.reshape(-1, 3), np.arange(3 * facets).reshape(-1, 3)
