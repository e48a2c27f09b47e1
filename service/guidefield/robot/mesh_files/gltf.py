"""Read glTF 2.0 files, as JSON with its buffers or as one binary: the scene's meshes, at their nodes, in metres.

The axes aren't turned: a URDF places the file's own frame. Numbers and names below are glTF's, but for `MAX_ZEROS`.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from guidefield.geometry.surfaces import frames
from guidefield.robot.mesh_files.numbers import Collected, MeshFault, Objects, Triangles, check_indices

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3}
TRIANGLES, STRIP, FAN = 4, 5, 6
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
"""Extensions under which geometry is packed in ways that aren't read."""
INSTANCED = "EXT_mesh_gpu_instancing"
MAX_ZEROS = 1_000_000  # an accessor of more values without a buffer, which are 0, is refused


def read_gltf(content: bytes, folder: Path | None) -> Objects:
    """Read a glTF file of either form, each node as an object; its buffers are in a folder.

    Skins and morph targets are read as the mesh at its node, lines and points are left out. MeshFault if it is
    malformed, its geometry is packed, or a buffer isn't in the folder.
    """
    document, binary = _document(content)
    return _Gltf(document, binary, folder).objects()


def buffer_files(content: bytes) -> list[str]:
    """Return the names of the files beside a glTF file that hold its buffers; MeshFault if it is no glTF file."""
    buffers = _document(content)[0].get("buffers", [])
    uris = [one.get("uri") for one in buffers if isinstance(one, Mapping)]
    return [unquote(uri) for uri in uris if isinstance(uri, str) and not uri.startswith("data:")]


def _document(content: bytes) -> tuple[Mapping[str, Any], bytes]:
    binary = b""
    if content.startswith(b"glTF"):
        stated = int.from_bytes(content[8:12], "little")
        if len(content) < stated:
            raise MeshFault(f"is cut short: it states {stated} bytes and has {len(content)}")
        chunks, at = dict[bytes, bytes](), 12
        while at + 8 <= stated:
            length = int.from_bytes(content[at : at + 4], "little")
            chunks.setdefault(content[at + 4 : at + 8], content[at + 8 : at + 8 + length])
            at += 8 + length
        content, binary = chunks.get(b"JSON", b""), chunks.get(b"BIN\0", b"")
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        raise MeshFault("is no glTF file: it isn't JSON") from None
    if not isinstance(document, dict) or not isinstance(document.get("asset"), dict):
        raise MeshFault("is no glTF file: it has no 'asset'")
    if not str(document["asset"].get("version", "")).startswith("2"):
        raise MeshFault(f"is glTF {document['asset'].get('version')!r}; version 2 is read")
    return document, binary


class _Gltf:
    def __init__(self, document: Mapping[str, Any], binary: bytes, folder: Path | None) -> None:
        self._document, self._binary, self._folder = document, binary, folder
        self._buffers: dict[int, bytes] = {}
        if packed := [name for name in COMPRESSED if name in document.get("extensionsRequired", ())]:
            raise MeshFault(f"packs its geometry by {packed[0]}, which is not read; export it without")

    def objects(self) -> Objects:
        try:
            return self._collect()
        except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
            if isinstance(error, MeshFault):
                raise
            raise MeshFault(f"is no proper glTF file: {type(error).__name__}: {error}") from None

    def _collect(self) -> Objects:
        nodes, meshes = self._document.get("nodes", []), self._document.get("meshes", [])
        collected, read = Collected(), dict[int, list[Triangles]]()
        pending = [(index, np.eye(4), 0) for index in reversed(self._roots(nodes))]
        while pending:
            index, above, depth = pending.pop()
            node = _entry(nodes, index, "node")
            collected.visit(depth, str(node.get("name", "")))
            if INSTANCED in node.get("extensions", {}):
                raise MeshFault(f"has instances by {INSTANCED}, which is not read; export them as nodes")
            placement = above @ _placement(node)
            if "mesh" in node:
                number = node["mesh"]
                if number not in read:
                    primitives = _entry(meshes, number, "mesh")["primitives"]
                    read[number] = [one for one in map(self._primitive, primitives) if one is not None]
                for one in read[number]:
                    collected.add(one, placement)
            pending += [(child, placement, depth + 1) for child in reversed(node.get("children", []))]
        return collected.objects()

    def _roots(self, nodes: Sequence[Any]) -> list[int]:
        if scenes := self._document.get("scenes"):
            return list(_entry(scenes, self._document.get("scene", 0), "scene").get("nodes", []))
        below = {child for node in nodes for child in node.get("children", [])}
        return [index for index in range(len(nodes)) if index not in below]

    def _primitive(self, primitive: Mapping[str, Any]) -> Triangles | None:
        mode = primitive.get("mode", TRIANGLES)
        if mode not in (TRIANGLES, STRIP, FAN) or "POSITION" not in primitive["attributes"]:
            return None
        if packed := [name for name in COMPRESSED if name in primitive.get("extensions", {})]:
            raise MeshFault(f"packs its geometry by {packed[0]}, which is not read; export it without")
        vertices = self._values(primitive["attributes"]["POSITION"], "VEC3").astype(np.float64)
        corners = np.arange(len(vertices))
        if "indices" in primitive:
            corners = self._values(primitive["indices"], "SCALAR").astype(np.int64).reshape(-1)
        check_indices(corners, len(vertices))
        if mode == TRIANGLES:
            return vertices, corners[: len(corners) // 3 * 3].reshape(-1, 3)
        first = np.full(max(len(corners) - 2, 0), corners[0] if len(corners) else 0)
        rows = np.column_stack([first if mode == FAN else corners[:-2], corners[1:-1], corners[2:]])
        if mode == STRIP:
            rows[1::2] = rows[1::2, [1, 0, 2]]
        return vertices, rows

    def _values(self, number: int, kind: str) -> np.ndarray:
        accessor = _entry(self._document.get("accessors", []), number, "accessor")
        if accessor["type"] != kind:
            raise MeshFault(f"has an accessor of {accessor['type']} where {kind} belongs")
        width, count = WIDTHS[kind], accessor["count"]
        form = np.dtype(COMPONENTS[accessor["componentType"]])
        if "bufferView" in accessor:
            values = self._view(accessor["bufferView"], accessor.get("byteOffset", 0), form, count, width)
        elif count <= MAX_ZEROS:
            values = np.zeros((count, width), form)
        else:
            raise MeshFault(f"has an accessor whose count is {count} without a buffer, at most {MAX_ZEROS} are read")
        if sparse := accessor.get("sparse"):
            at, new = sparse["indices"], sparse["values"]
            kinds = np.dtype(COMPONENTS[at["componentType"]])
            where = self._view(at["bufferView"], at.get("byteOffset", 0), kinds, sparse["count"], 1).reshape(-1)
            values = values.copy()
            check_indices(where.astype(np.int64), count)
            values[where] = self._view(new["bufferView"], new.get("byteOffset", 0), form, sparse["count"], width)
        if accessor.get("normalized") and form.kind in "iu":
            return np.maximum(values.astype(np.float64) / np.iinfo(form).max, -1.0)
        return values

    def _view(self, number: int, offset: int, form: np.dtype[Any], count: int, width: int) -> np.ndarray:
        view = _entry(self._document.get("bufferViews", []), number, "bufferView")
        if packed := [name for name in COMPRESSED if name in view.get("extensions", {})]:
            raise MeshFault(f"packs its geometry by {packed[0]}, which is not read; export it without")
        content = self._buffer(view["buffer"])
        start = view.get("byteOffset", 0) + offset
        stride = view.get("byteStride", width * form.itemsize)
        last = start + (count - 1) * stride + width * form.itemsize
        end = view.get("byteOffset", 0) + view["byteLength"]
        if count == 0:
            return np.empty((0, width), form)
        if start < 0 or last > min(end, len(content)) or stride < width * form.itemsize:
            raise MeshFault("is cut short: an accessor goes beyond its buffer")
        values: np.ndarray = np.ndarray((count, width), form, content, start, (stride, form.itemsize))
        return values

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            uri = _entry(self._document.get("buffers", []), number, "buffer").get("uri")
            if uri is None:
                content = self._binary
            elif uri.startswith("data:"):
                content = base64.b64decode(uri.partition(",")[2])
            else:
                content = beside(self._folder, unquote(uri)).read_bytes()
            self._buffers[number] = content
        return self._buffers[number]


def beside(folder: Path | None, name: str) -> Path:
    """Return the file in a folder, or below it, that a mesh file names; MeshFault if it isn't there."""
    path = None if folder is None else (folder / name).resolve()
    if folder is None or path is None or not path.is_relative_to(folder.resolve()):
        raise MeshFault(f"names the buffer {name!r}, which must be in its folder")
    if not path.is_file():
        raise MeshFault(f"names the buffer {name!r}, which is not there")
    return path


def _entry(rows: Sequence[Any], number: Any, what: str) -> Mapping[str, Any]:
    if not isinstance(number, int) or not 0 <= number < len(rows):
        raise MeshFault(f"names the {what} {number!r}, of {len(rows)}")
    entry: Mapping[str, Any] = rows[number]
    return entry


def _placement(node: Mapping[str, Any]) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    kept = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}
    shift, quaternion, scale = (np.array(node.get(name, none), np.float64) for name, none in kept.items())
    placement = np.eye(4)
    placement[:3] = frames(shift[None], quaternion[None]).reshape(3, 4)
    placement[:3, :3] *= scale
    return placement
