"""Read 3MF files: the objects of the <build>, components placed.

As other tools for robots have it, their numbers are metres, with the `scale` of the URDF: a file's own unit, which is
millimetres by default, is reported in a warning. Files of scenes are scaled by it (`scene_files/reading.py`). The names
are 3MF's, so `UNITS` has to be right.
"""

from __future__ import annotations

import io
import posixpath
import zipfile

import numpy as np
from lxml import etree

from guidefield.robot.mesh_files.numbers import (
    STRICT_XML,
    Collected,
    Element,
    MeshFault,
    Objects,
    Triangles,
    check_indices,
    child_of,
    children,
    floats,
    integers,
    local_name,
)

MAX_BYTES = 2**30  # an unpacked part of more bytes is refused
START = "3D/3dmodel.model"
START_KIND = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
UNITS = {"micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "inch": 0.0254, "foot": 0.3048, "meter": 1.0}


def read_three_mf(content: bytes) -> Objects:
    """Read a 3MF file, by its objects; MeshFault if it is no archive, is malformed, or names what isn't in it."""
    package = _Package(content)
    collected = Collected()
    build = child_of(package.model(package.start), "build")
    items = [] if build is None else children(build, "item")
    pending = [(package.start, item, np.eye(4), 0) for item in reversed(items)]
    while pending:
        part, reference, above, depth = pending.pop()
        named = next((value for key, value in reference.attrib.items() if local_name(key) == "path"), None)
        part = part if named is None else named.lstrip("/")
        found = package.object(part, reference.get("objectid", ""))
        collected.visit(depth, found.get("name", ""))
        placement = above @ _placement(reference)
        if (mesh := child_of(found, "mesh")) is not None:
            collected.add(_mesh(mesh), placement)
        components = child_of(found, "components")
        below = [] if components is None else children(components, "component")
        pending += [(part, component, placement, depth + 1) for component in reversed(below)]
    return collected.objects()


def read_stated_unit(content: bytes) -> str:
    """Return the unit that a 3MF file states, a key of `UNITS`; MeshFault if it is malformed, or states another one."""
    package = _Package(content)
    unit = package.model(package.start).get("unit", "millimeter")
    if unit not in UNITS:
        raise MeshFault(f"states the unit {unit!r}; one is {', '.join(UNITS)}")
    return str(unit)


class _Package:
    def __init__(self, content: bytes) -> None:
        try:
            self._archive = zipfile.ZipFile(io.BytesIO(content))
        except zipfile.BadZipFile as error:
            raise MeshFault(f"is no 3MF archive: {error}") from None
        self._models: dict[str, Element] = {}
        self._objects: dict[str, dict[str, Element]] = {}
        self.start = self._start()

    def _start(self) -> str:
        if "_rels/.rels" not in self._archive.namelist():
            return START
        for one in children(self._xml("_rels/.rels"), "Relationship"):
            if one.get("Type") == START_KIND:
                return posixpath.normpath(str(one.get("Target", START)).lstrip("/"))
        return START

    def model(self, part: str) -> Element:
        if part not in self._models:
            self._models[part] = self._xml(part)
            resources = child_of(self._models[part], "resources")
            objects = [] if resources is None else children(resources, "object")
            self._objects[part] = {one.get("id", ""): one for one in objects}
        return self._models[part]

    def object(self, part: str, number: str) -> Element:
        self.model(part)
        if number not in self._objects[part]:
            raise MeshFault(f"names the object {number!r}, which is not in it")
        return self._objects[part][number]

    def _xml(self, part: str) -> Element:
        try:
            if self._archive.getinfo(part).file_size > MAX_BYTES:
                raise MeshFault(f"unpacks to more than {MAX_BYTES} bytes")
            return etree.fromstring(self._archive.read(part), etree.XMLParser(**STRICT_XML))
        except KeyError:
            raise MeshFault(f"is no 3MF file: it has no part {part!r}") from None
        except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, EOFError) as error:
            raise MeshFault(f"can't be unpacked: {error}") from None
        except etree.XMLSyntaxError as error:
            raise MeshFault(f"has a part {part!r} that is not XML: {error}") from None


def _mesh(mesh: Element) -> Triangles:
    rows = [one for group in children(mesh, "vertices") for one in children(group, "vertex")]
    faces = [one for group in children(mesh, "triangles") for one in children(group, "triangle")]
    vertices = floats(_write_elements(rows, ("x", "y", "z")), "vertices").reshape(-1, 3)
    triangles = integers(_write_elements(faces, ("v1", "v2", "v3")), "triangles").reshape(-1, 3)
    check_indices(triangles.reshape(-1), len(vertices))
    return vertices, triangles


def _write_elements(elements: list[Element], attributes: tuple[str, ...]) -> bytes:
    words = [one.get(attribute, "") for one in elements for attribute in attributes]
    if not all(word.strip() for word in words):
        raise MeshFault(f"has a <{local_name(elements[0])}> without {', '.join(attributes)}")
    return " ".join(words).encode()


def _placement(reference: Element) -> np.ndarray:
    """Return the affine map of an item or component, shape (4, 4): the file has it transposed, for rows."""
    placement = np.eye(4)
    if (text := reference.get("transform")) is not None:
        values = floats(text.encode(), "transform")
        if len(values) != 12:
            raise MeshFault(f"has a transform of {len(values)} numbers, not 12")
        placement[:3] = values.reshape(4, 3).T
    return placement
