"""Read PLY files, ASCII and binary of either byte order: meshes of robots and scenes, and point clouds.

Words of types, orders and lists are PLY's. A further name of a list belongs in `OUTLINES`: faces under another name are
passed over, and a file of such alone is refused for having no triangles. A file whose header has no faces is a cloud
(`scene_files/clouds.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from guidefield.robot.mesh_files.numbers import MeshFault, Triangles, check_indices, triangulate, triangulate_strip

TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
OUTLINES = ("vertex_indices", "vertex_index")  # names of the list of a face's vertices


@dataclass
class _Element:
    """One kind of rows: its number, and its properties as name, type, and type of the count of a list."""

    name: str
    count: int
    properties: list[tuple[str, str, str | None]] = field(default_factory=list)


def read_ply(content: bytes) -> Triangles:
    """Read a PLY file; all but positions, faces and strips is left out. MeshFault if it is malformed or cut short."""
    order, elements, body = _header(content)
    values: dict[str, list[np.ndarray]] = {}  # by element, of each property its flat values
    sizes: dict[str, list[np.ndarray]] = {}
    reader = _Words(body) if not order else _Bytes(body, order)
    for element in elements:
        values[element.name], sizes[element.name] = reader.rows(element)
    by_name = {element.name: element for element in elements}
    if "vertex" not in by_name:
        raise MeshFault("is a PLY file without vertices")
    names = [name for name, _, _ in by_name["vertex"].properties]
    if not {"x", "y", "z"} <= set(names):
        raise MeshFault("is a PLY file whose vertices have no x, y and z")
    vertices = np.column_stack([values["vertex"][names.index(axis)].astype(np.float64) for axis in "xyz"])
    triangles = [np.empty((0, 3), np.int64)]
    for kind in ("face", "tristrips"):
        for k, (name, _, counted) in enumerate(by_name[kind].properties if kind in by_name else ()):
            if counted is None or name not in OUTLINES:
                continue
            corners = values[kind][k].astype(np.int64)
            if kind == "tristrips":
                triangles.append(_strips(corners, len(vertices)))
            else:
                check_indices(corners, len(vertices))
                triangles.append(triangulate(vertices, corners, sizes[kind][k].astype(np.int64)))
    return vertices, np.concatenate(triangles)


def _strips(corners: np.ndarray, count: int) -> np.ndarray:
    found = []
    for part in np.split(corners, np.flatnonzero(corners == -1)):
        strip = part[part != -1]
        check_indices(strip, count)
        if len(strip) > 2:
            found.append(triangulate_strip(strip))
    return np.concatenate(found) if found else np.empty((0, 3), np.int64)


def _header(content: bytes) -> tuple[str, list[_Element], bytes]:
    """Return byte order ("" where it is text), elements, and the rest behind the header."""
    if not content.startswith(b"ply"):
        raise MeshFault("is no PLY file: it doesn't begin with 'ply'")
    head, end, body = content.partition(b"end_header")
    if not end:
        raise MeshFault("is cut short: its header has no end")
    body = body[2:] if body.startswith(b"\r\n") else body[1:]
    order, elements = None, list[_Element]()
    for line in head.decode(errors="replace").splitlines()[1:]:
        match line.split():
            case ["format", kind, _] if kind in ORDERS:
                order = ORDERS[kind]
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count)))
            case ["property", "list", counted, kind, name] if counted in TYPES and kind in TYPES and elements:
                elements[-1].properties.append((name, TYPES[kind], TYPES[counted]))
            case ["property", kind, name] if kind in TYPES and elements:
                elements[-1].properties.append((name, TYPES[kind], None))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise MeshFault(f"has the line {line[:60]!r} in its header, which is not understood")
    if order is None:
        raise MeshFault("states no format in its header")
    return order, elements, body


class _Words:
    def __init__(self, body: bytes) -> None:
        self._words, self._at = body.split(), 0

    def rows(self, element: _Element) -> tuple[list[np.ndarray], list[np.ndarray]]:
        columns: list[list[bytes]] = [[] for _ in element.properties]
        counts: list[list[int]] = [[] for _ in element.properties]
        listed = any(counted for _, _, counted in element.properties)
        width = len(element.properties)
        if not listed:
            table = self._next(element.count * width)
            columns = [table[k::width] for k in range(width)]
        for _ in range(element.count if listed else 0):
            for k, (_, _, counted) in enumerate(element.properties):
                word = self._next(1)[0] if counted else b"1"
                if not word.isdigit():
                    raise MeshFault(f"has a list of {word[:20].decode(errors='replace')!r} values")
                size = int(word)
                counts[k].append(size)
                columns[k] += self._next(size)
        try:
            return [np.array(column, np.float64) for column in columns], [np.array(one, np.int64) for one in counts]
        except ValueError:
            raise MeshFault(f"has a {element.name} with something that is not a number") from None

    def _next(self, count: int) -> list[bytes]:
        words = self._words[self._at : self._at + count]
        self._at += count
        if len(words) < count:
            raise MeshFault("is cut short: it holds fewer rows than its header states")
        return words


class _Bytes:
    def __init__(self, body: bytes, order: str) -> None:
        self._body, self._order, self._at = body, order, 0

    def rows(self, element: _Element) -> tuple[list[np.ndarray], list[np.ndarray]]:
        for size in (3, 4):  # whole tables of triangles or quadrilaterals are read at once
            found = self._table(element, size)
            if found is not None:
                return found
        return self._one_by_one(element)

    def _table(self, element: _Element, size: int) -> tuple[list[np.ndarray], list[np.ndarray]] | None:
        """Read all rows at once, if each list has `size` values; None if not."""
        fields: list[tuple[str, str, tuple[int, ...]]] = []
        for k, (_, kind, counted) in enumerate(element.properties):
            if counted is not None:
                fields.append((f"n{k}", self._order + counted, ()))
            fields.append((f"v{k}", self._order + kind, (size,) if counted else ()))
        row = np.dtype(fields)
        if not element.properties or len(self._body) - self._at < element.count * row.itemsize:
            return None
        table = np.frombuffer(self._body, row, element.count, self._at)
        if any(counted and not (table[f"n{k}"] == size).all() for k, (_, _, counted) in enumerate(element.properties)):
            return None
        self._at += element.count * row.itemsize
        values = [table[f"v{k}"].reshape(-1) for k in range(len(element.properties))]
        return values, [np.full(element.count, size)] * len(element.properties)

    def _one_by_one(self, element: _Element) -> tuple[list[np.ndarray], list[np.ndarray]]:
        columns: list[list[np.ndarray]] = [[] for _ in element.properties]
        counts: list[list[int]] = [[] for _ in element.properties]
        for _ in range(element.count):
            for k, (_, kind, counted) in enumerate(element.properties):
                size = int(self._next(counted, 1)[0]) if counted else 1
                counts[k].append(size)
                columns[k].append(self._next(kind, size))
        values = [np.concatenate(column) if column else np.empty(0) for column in columns]
        return values, [np.array(one, np.int64) for one in counts]

    def _next(self, kind: str, count: int) -> np.ndarray:
        row = np.dtype(self._order + kind)
        if count < 0 or len(self._body) - self._at < count * row.itemsize:
            raise MeshFault("is cut short: it holds fewer rows than its header states")
        values = np.frombuffer(self._body, row, count, self._at)
        self._at += count * row.itemsize
        return values
