"""Recognize the kind of a mesh file by its content, or by its suffix where the content is unclear.

Readers and the check of sent files (`sent_meshes.py`) use the same function, so that no file is checked as one kind and
read as another. Nothing here loads numpy, because the process that receives requests imports that check for its limits.
"""

from __future__ import annotations

import re

_MARKS: dict[str, re.Pattern[bytes]] = {
    ".3mf": re.compile(rb"PK\x03\x04"),
    ".dae": re.compile(rb"\s*(?:<\?xml[^>]*>\s*)?(?:<!--(?:(?!-->).)*-->\s*)*<COLLADA\b", re.DOTALL),
    ".glb": re.compile(rb"glTF[\x01\x02]\0\0\0"),
    ".gltf": re.compile(rb"\s*\{[^\0]*\"asset\""),
    ".obj": re.compile(rb"[^\0]*?^v[ \t]+[-+.\d]+[ \t]+[-+.\d]+[ \t]+[-+.\d]", re.MULTILINE),
    ".off": re.compile(rb"(?:ST)?C?N?OFF\s"),
    ".ply": re.compile(rb"ply\r?\n"),
    ".stl": re.compile(rb"\s*solid\b[^\0]*\bfacet\s+normal\b", re.IGNORECASE),
}
"""How files of each kind begin; if that of the suffix doesn't fit, the first that does counts; scene files, too."""

MESH_SUFFIXES = tuple(_MARKS)  # kinds of mesh files that are read

_BEGINNING = 65_536  # the number of bytes in which a mark is searched for

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"

STL_HEADER = 84  # bytes of a binary STL file before its facets; the last four are their number
STL_FACET = 50  # bytes of each facet


def recognize(content: bytes, suffix: str) -> tuple[str, bytes]:
    """Return the kind by which a mesh file is read, one of `MESH_SUFFIXES`, and its content without a byte order mark.

    The kind is the file's suffix, one of `MESH_SUFFIXES`, unless the content lacks the mark of that and has the mark of
    another.
    """
    if not is_binary_stl(content):
        content = content.removeprefix(_BYTE_ORDER_MARK)

    def has_mark(kind: str) -> bool:
        return (kind == ".stl" and is_binary_stl(content)) or bool(_MARKS[kind].match(content, 0, _BEGINNING))

    return suffix if has_mark(suffix) else next(filter(has_mark, _MARKS), suffix), content


def is_binary_stl(content: bytes) -> bool:
    """Return whether a file is as long as a binary STL of the number of facets that it states."""
    return len(content) == STL_HEADER + STL_FACET * int.from_bytes(content[STL_HEADER - 4 : STL_HEADER], "little")
