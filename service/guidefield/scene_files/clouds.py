"""Read point clouds from files: PCD (text, binary and compressed), PLY without faces, XYZ and NumPy's npz.

A further kind needs an entry in `READERS`, from which `reading.SUFFIXES` follows; files are untrusted, so sizes are
checked before memory is taken.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from guidefield.messages.scene import MAX_VERTICES
from guidefield.robot.mesh_files.numbers import MeshFault
from guidefield.robot.mesh_files.ply import read_ply
from guidefield.robot.mesh_files.reading import content_of

MAX_BYTES = 2**30  # a file that unpacks to more bytes is refused, and a larger scene file of any kind (reading.py)
_HEADER_BYTES = 65_536  # in which a PLY file's faces are looked for: a mesh with a longer header counts as a cloud
_FACES = re.compile(rb"^element[ \t]+(?:face|tristrips)[ \t]+0*[1-9]", re.MULTILINE)
_WIDTHS = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}  # bytes that a value of each type of PCD may have


def is_cloud(suffix: str, content: bytes) -> bool:
    """Return True if a file of a suffix holds a cloud: a PLY file does if it has no faces."""
    return suffix in READERS and not (suffix == ".ply" and _FACES.search(content, 0, _HEADER_BYTES))


def read_cloud(path: Path) -> tuple[np.ndarray, int]:
    """Read the points (n, 3) of a cloud in a file of `READERS`, and the number of those left out because they are NaN.

    Raises:
        MeshFault: if it can't be read, or has no points or more than a cloud of a scene.
    """
    try:
        points = np.asarray(READERS[path.suffix.lower()](content_of(path)), np.float64)
    except MeshFault:
        raise
    except (ValueError, LookupError, TypeError, OverflowError) as error:
        raise MeshFault(f"is malformed: {' '.join(str(error).split())}") from None
    measured = points[~np.isnan(points).any(axis=1)]
    if not len(measured):
        raise MeshFault("has no points")
    if len(measured) > MAX_VERTICES:
        raise MeshFault(f"has {len(measured)} points, at most {MAX_VERTICES} are read: thin them out, by a voxel grid")
    return measured, len(points) - len(measured)


def _read_xyz(content: bytes) -> np.ndarray:
    text = re.sub(rb"[,;]", b" ", content)
    return np.loadtxt(io.BytesIO(text), usecols=(0, 1, 2), comments=("#", "//"), ndmin=2)


def _read_npz(content: bytes) -> np.ndarray:
    """Read the array `points` of an archive, or its only array."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if (size := sum(one.file_size for one in archive.infolist())) > MAX_BYTES:
                raise MeshFault(f"unpacks to {size} bytes, more than {MAX_BYTES}")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            name = "points" if "points" in arrays.files or len(arrays.files) != 1 else arrays.files[0]
            if name not in arrays.files:
                raise MeshFault(f"has no array 'points', but {', '.join(arrays.files) or 'none'}")
            points = arrays[name]
    except (zipfile.BadZipFile, EOFError, OSError, MemoryError, NotImplementedError, RuntimeError) as error:
        raise MeshFault(f"is no npz archive, or damaged: {error}") from None
    if points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in "fiu":
        raise MeshFault(f"has {name!r} of shape {points.shape} and type {points.dtype}; numbers (n, 3) are read")
    return np.asarray(points[:, :3])


class _Header(NamedTuple):
    points: int  # their number
    form: str  # `ascii`, `binary` or `binary_compressed`
    fields: list[tuple[str, int, int]]  # type, bytes of a value and number of values of each field
    axes: list[int]  # index of the fields x, y and z
    end: int  # where the points begin


def _pcd_header(content: bytes) -> _Header:
    words, end = dict[str, list[str]](), 0
    while "DATA" not in words:
        begin, end = end, content.find(b"\n", end, _HEADER_BYTES) + 1
        if not end:
            raise MeshFault("is no PCD file: its header has no line DATA")
        word, *values = content[begin:end].decode(errors="replace").partition("#")[0].split() or [""]
        words[word.upper()] = values
    try:
        names = words["FIELDS"]
        sizes, counts = ([int(one) for one in words.get(word, ["1"] * len(names))] for word in ("SIZE", "COUNT"))
        points = int(words["POINTS"][0] if "POINTS" in words else words["WIDTH"][0])
        fields = list(zip(words["TYPE"], sizes, counts, strict=True))
        header = _Header(points, words["DATA"][0].lower(), fields, [names.index(axis) for axis in "xyz"], end)
    except (LookupError, ValueError) as error:
        raise MeshFault(f"has a header that doesn't say where x, y and z of how many points are: {error}") from None
    known = all(size in _WIDTHS.get(kind, ()) and many >= 0 for kind, size, many in fields)
    if not (known and 0 <= points <= MAX_BYTES // 12 and all(fields[axis][2] == 1 for axis in header.axes)):
        raise MeshFault(f"has a header that can't be: {points} points with fields {fields}")
    return header


def _read_pcd(content: bytes) -> np.ndarray:
    """Read a PCD file; its VIEWPOINT, from which it was taken, isn't applied."""
    points, form, fields, axes, end = _pcd_header(content)
    row = sum(size * many for _, size, many in fields)
    if form == "ascii":
        columns = [sum(many for *_, many in fields[:axis]) for axis in axes]
        found = np.loadtxt(io.BytesIO(content[end:]), usecols=columns, max_rows=points, ndmin=2)
        if len(found) < points:
            raise MeshFault(f"is cut short: it states {points} points and holds {len(found)}")
        return found
    if form not in ("binary", "binary_compressed"):
        raise MeshFault(f"has DATA {form!r}; ascii, binary and binary_compressed are read")
    body, by_field = content[end:], form == "binary_compressed"  # then all values of a field follow each other
    if by_field:
        packed, size = (int.from_bytes(body[k : k + 4], "little") for k in (0, 4))
        if size != points * row or size > MAX_BYTES or len(body) < 8 + packed:
            raise MeshFault(f"is cut short: it states {points} points of {row} bytes, and {packed} of {size} bytes")
        body = _unpack_lzf(body[8 : 8 + packed], size)
    if len(body) < points * row:
        raise MeshFault(f"is cut short: it states {points} points of {row} bytes and holds {len(body)} bytes")
    found = np.empty((points, 3))
    for column, axis in enumerate(axes):
        kind, size, _ = fields[axis]
        start = sum(width * many for _, width, many in fields[:axis]) * (points if by_field else 1)
        values = np.ndarray((points,), np.dtype(f"<{kind.lower()}{size}"), body, start, (size if by_field else row,))
        found[:, column] = values
    return found


def _unpack_lzf(packed: bytes, size: int) -> bytes:
    """Unpack LZF, runs of bytes and references to earlier ones, to a size; raises MeshFault if it is damaged."""
    body, at = bytearray(), 0
    try:
        while at < len(packed) and len(body) <= size:
            control = packed[at]
            if control < 32:
                body += packed[at + 1 : at + control + 2]
                at += control + 2
                continue
            length, at = control >> 5, at + 1
            if length == 7:
                length, at = length + packed[at], at + 1
            start, at = len(body) - ((control & 31) << 8) - packed[at] - 1, at + 1
            if start < 0:
                break
            repeated = body[start : start + length + 2]
            body += (repeated * (1 + (length + 2) // len(repeated)))[: length + 2]
    except IndexError:
        body.clear()
    if len(body) != size or at < len(packed):
        raise MeshFault("is damaged: its compressed points can't be unpacked")
    return bytes(body)


READERS: dict[str, Callable[[bytes], np.ndarray]] = {
    ".npz": _read_npz,
    ".pcd": _read_pcd,
    ".ply": lambda content: read_ply(content)[0],
    ".xyz": _read_xyz,
}
"""Reader by kind of file."""
