"""Read the mesh formats in XML, COLLADA and 3MF: meshes placed by the nodes, or components, that refer to them.

COLLADA: the visual scene, in metres by the file's unit. The axis that is said to be up isn't turned, as in RViz and
MoveIt: a URDF places the file's own frame. 3MF: the objects of the <build>. As other tools for robots have it, their
numbers are metres, with the `scale` of the URDF: a file's own unit, which is millimetres by default, is reported in a
warning; files of scenes are scaled by it (`scene_files/reading.py`). The names are the formats', so `UNITS` has to be
right. Files are untrusted: XML opens nothing else (`STRICT_XML`), and `MAX_PART_BYTES` bounds what is unpacked.
"""

from __future__ import annotations

import io
import math
import posixpath
import zipfile
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from lxml import etree

from guidefield.robot.mesh_files.numbers import (
    Collected,
    MeshFault,
    Objects,
    Triangles,
    check_indices,
    floats,
    integers,
    triangulate,
    triangulate_strip,
    triangulate_with_holes,
)

Element = Any  # an element of lxml, for which there are no types

MAX_PART_BYTES = 2**30  # an unpacked part of more bytes is refused
THREE_MF_START = "3D/3dmodel.model"
THREE_MF_START_KIND = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
UNITS = {"micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "inch": 0.0254, "foot": 0.3048, "meter": 1.0}

STRICT_XML = {
    "resolve_entities": False,
    "no_network": True,
    "load_dtd": False,
    "huge_tree": True,
    "remove_comments": True,
}
"""Options of a parser of XML that opens nothing else."""


def local_name(named: Element | str) -> str:
    """Return the name of an element or attribute without its namespace."""
    return str(named if isinstance(named, str) else named.tag).rpartition("}")[2]


def children(element: Element, tag: str) -> list[Element]:
    """Return the children of a local name."""
    return [child for child in element if local_name(child) == tag]


def child_of(element: Element, tag: str) -> Element | None:
    """Return the first child of a local name."""
    return next(iter(children(element, tag)), None)


def read_collada(content: bytes) -> Objects:
    """Read a COLLADA file, each node as an object. Skins are read as the mesh in its bind pose, lines are left out.

    MeshFault if it isn't COLLADA, is malformed, names something that isn't there, or has a geometry that is no mesh.
    """
    document = _ColladaDocument(_parse_collada(content))
    collected = Collected()
    for geometry, placement in document.instances(collected.visit):
        collected.add(document.mesh(geometry), placement)
    objects, unit = collected.objects(), collada_unit(document.root)
    return objects if unit == 1.0 else objects._replace(vertices=objects.vertices * unit)


def read_collada_up_axis(content: bytes) -> str:
    """Return the axis that a COLLADA file says to be up, `x`, `y` or `z`, else y; MeshFault if it is another."""
    asset = child_of(_parse_collada(content), "asset")
    stated = None if asset is None else child_of(asset, "up_axis")
    axis = "Y_UP" if stated is None else (stated.text or "").strip()
    if axis not in ("X_UP", "Y_UP", "Z_UP"):
        raise MeshFault(f"has <up_axis>{axis}</up_axis>, which must be X_UP, Y_UP or Z_UP")
    return axis[0].lower()


def read_collada_unit(content: bytes) -> float:
    """Return the length of a COLLADA file's unit [m]; MeshFault if it isn't positive."""
    return collada_unit(_parse_collada(content))


def collada_unit(root: Element) -> float:
    """Return the length of a document's unit [m], 1 where it states none; MeshFault if it isn't a positive number."""
    asset = child_of(root, "asset")
    unit = None if asset is None else child_of(asset, "unit")
    stated = "1" if unit is None else unit.get("meter", "1")
    try:
        length = float(stated)
    except ValueError:
        length = math.nan
    if not 0.0 < length < math.inf:
        raise MeshFault(f"has <unit meter={stated!r}>, which must be a positive number")
    return length


def _parse_collada(content: bytes) -> Element:
    try:
        root = etree.fromstring(content, etree.XMLParser(**STRICT_XML))
    except (etree.XMLSyntaxError, ValueError) as error:
        raise MeshFault(f"is not XML: {error}") from None
    if local_name(root) != "COLLADA":
        raise MeshFault(f"is no COLLADA file: its root element is <{local_name(root)}>")
    return root


class _ColladaDocument:
    def __init__(self, root: Element) -> None:
        self.root = root
        self._named = {element.get("id"): element for element in root.iter(etree.Element) if element.get("id")}
        self._meshes: dict[Element, Triangles] = {}
        self._sources: dict[Element, np.ndarray] = {}

    def instances(self, visit: Callable[[int, str], None]) -> Iterator[tuple[Element, np.ndarray]]:
        """Yield each `<geometry>` and its placement, shape (4, 4); `visit` gets a node's depth and name."""
        pending = [(node, np.eye(4), 0) for node in reversed(children(self._visual_scene(), "node"))]
        while pending:
            node, above, depth = pending.pop()
            visit(depth, node.get("name") or node.get("id", ""))
            placement, below = above @ _node_placement(node), []
            for child in node:
                match local_name(child):
                    case "instance_geometry":
                        yield self._find_target(child, "geometry"), placement
                    case "instance_controller":
                        yield self._find_skinned(self._find_target(child, "controller"), placement)
                    case "instance_node":
                        below.append((self._find_target(child, "node"), placement, depth + 1))
                    case "node":
                        below.append((child, placement, depth + 1))
            pending += reversed(below)

    def mesh(self, geometry: Element) -> Triangles:
        if geometry not in self._meshes:
            mesh = child_of(geometry, "mesh")
            if mesh is None:
                kinds = ", ".join(
                    f"<{local_name(child)}>" for child in geometry if local_name(child) not in ("asset", "extra")
                )
                raise MeshFault(f"has the geometry {geometry.get('id')!r} of {kinds or 'nothing'}, which is no mesh")
            collected = Collected()
            for primitive in mesh:
                if read := PRIMITIVES.get(local_name(primitive)):
                    vertices, outlines = self._positions(primitive)
                    if vertices is not None:
                        triangles = read(primitive, vertices, outlines)
                        check_indices(triangles.reshape(-1), len(vertices))
                        collected.add((vertices, triangles), np.eye(4))
            self._meshes[geometry] = collected.triangles()
        return self._meshes[geometry]

    def _visual_scene(self) -> Element:
        scene = child_of(self.root, "scene")
        instance = None if scene is None else child_of(scene, "instance_visual_scene")
        if instance is not None:
            return self._find_target(instance, "visual_scene")
        scenes = [
            one for library in children(self.root, "library_visual_scenes") for one in children(library, "visual_scene")
        ]
        if len(scenes) != 1:
            raise MeshFault(f"has no <scene>, and {len(scenes)} visual scenes to choose from")
        return scenes[0]

    def _find_skinned(self, controller: Element, placement: np.ndarray) -> tuple[Element, np.ndarray]:
        """Return the geometry that a controller deforms, and its placement in the bind pose."""
        seen = set()
        while local_name(controller) == "controller" and controller not in seen:
            seen.add(controller)
            deformer = next((child for child in controller if local_name(child) in ("skin", "morph")), None)
            if deformer is None:
                raise MeshFault(f"has the controller {controller.get('id')!r} without <skin> or <morph>")
            bound = child_of(deformer, "bind_shape_matrix")
            placement = placement if bound is None else placement @ _read_matrix(bound)
            controller = self._find_target(deformer, "geometry", "controller", attribute="source")
        return controller, placement

    def _positions(self, primitive: Element) -> tuple[np.ndarray | None, Callable[[Element], np.ndarray]]:
        """Return the vertices (v, 3) of a primitive, and a function from a `<p>` to indices of vertices."""
        inputs = children(primitive, "input")
        stride = max((int(one.get("offset", "0")) for one in inputs), default=0) + 1
        for one in inputs:
            source, offset = one, int(one.get("offset", "0"))
            if one.get("semantic") == "VERTEX":
                vertices = self._find_target(one, "vertices", attribute="source")
                source = next(
                    (some for some in children(vertices, "input") if some.get("semantic") == "POSITION"), None
                )
            if source is not None and source.get("semantic") == "POSITION":

                def outline(p: Element, offset: int = offset) -> np.ndarray:
                    indices = integers((p.text or "").encode(), "indices")
                    if len(indices) % stride:
                        raise MeshFault(
                            f"has a <p> of {len(indices)} indices, which is no multiple of its {stride} inputs"
                        )
                    return indices[offset::stride]

                return self._source(self._find_target(source, "source", attribute="source")), outline
        if any((p.text or "").strip() for p in primitive.iter("{*}p")):
            raise MeshFault(f"has <{local_name(primitive)}> without the positions of its vertices")
        return None, lambda _: np.empty(0, np.int64)

    def _source(self, source: Element) -> np.ndarray:
        if source in self._sources:
            return self._sources[source]
        technique = child_of(source, "technique_common")
        accessor = None if technique is None else child_of(technique, "accessor")
        array = child_of(source, "float_array")
        if accessor is not None and accessor.get("source"):
            array = self._find_target(accessor, "float_array", attribute="source")
        if array is None:
            raise MeshFault(f"has the source {source.get('id')!r} without a <float_array>")
        values = floats((array.text or "").encode(), "positions")
        stride = 3 if accessor is None else int(accessor.get("stride", "1"))
        offset = 0 if accessor is None else int(accessor.get("offset", "0"))
        named = [] if accessor is None else [param.get("name", "").upper() for param in children(accessor, "param")]
        columns = [named.index(axis) for axis in "XYZ"] if {"X", "Y", "Z"} <= set(named) else [0, 1, 2]
        if stride <= max(columns) or offset < 0:
            raise MeshFault(f"has the source {source.get('id')!r} whose stride is {stride}, of points in space")
        count = (len(values) - offset) // stride
        if accessor is not None and int(accessor.get("count", str(count))) > count:
            raise MeshFault(f"has the source {source.get('id')!r} with fewer numbers than it states")
        points = values[offset : offset + count * stride].reshape(-1, stride)[:, columns]
        self._sources[source] = points
        return points

    def _find_target(self, element: Element, *tags: str, attribute: str = "url") -> Element:
        reference = element.get(attribute, "").strip()
        found = self._named.get(reference.removeprefix("#"))
        if not reference.startswith("#") or found is None or local_name(found) not in tags:
            raise MeshFault(f"refers to {reference!r}, which is no <{tags[0]}> of it")
        return found


Outline = Callable[[Element], np.ndarray]


def _read_triangles(primitive: Element, _vertices: np.ndarray, outline: Outline) -> np.ndarray:
    corners = [outline(p) for p in children(primitive, "p")]
    joined = np.concatenate(corners) if corners else np.empty(0, np.int64)
    if len(joined) % 3:
        raise MeshFault(f"has <triangles> of {len(joined)} corners")
    return joined.reshape(-1, 3)


def _read_polylist(primitive: Element, vertices: np.ndarray, outline: Outline) -> np.ndarray:
    counts, p = child_of(primitive, "vcount"), child_of(primitive, "p")
    sizes = integers(b"" if counts is None else (counts.text or "").encode(), "counts")
    corners = np.empty(0, np.int64) if p is None else outline(p)
    if len(corners) != sizes.sum():
        raise MeshFault(f"has a <polylist> of {len(corners)} corners, where its <vcount> states {sizes.sum()}")
    check_indices(corners, len(vertices))
    return triangulate(vertices, corners, sizes)


def _read_polygons(primitive: Element, vertices: np.ndarray, outline: Outline) -> np.ndarray:
    found = [np.empty((0, 3), np.int64)]
    for child in primitive:
        if local_name(child) == "p":
            rings = [outline(child)]
        elif local_name(child) == "ph":
            rings = [outline(ring) for ring in child if local_name(ring) in ("p", "h")]
        else:
            continue
        check_indices(np.concatenate(rings), len(vertices))
        if len(rings) == 1:
            found.append(triangulate(vertices, rings[0], np.array([len(rings[0])])))
        else:
            found.append(triangulate_with_holes(vertices, rings))
    return np.concatenate(found)


def _read_fans(primitive: Element, _vertices: np.ndarray, outline: Outline) -> np.ndarray:
    found = [np.empty((0, 3), np.int64)]
    for p in children(primitive, "p"):
        fan = outline(p)
        found.append(np.column_stack([np.full(max(len(fan) - 2, 0), fan[0] if len(fan) else 0), fan[1:-1], fan[2:]]))
    return np.concatenate(found)


def _read_strips(primitive: Element, _vertices: np.ndarray, outline: Outline) -> np.ndarray:
    found = [np.empty((0, 3), np.int64)]
    for p in children(primitive, "p"):
        found.append(triangulate_strip(outline(p)))
    return np.concatenate(found)


PRIMITIVES: dict[str, Callable[[Element, np.ndarray, Outline], np.ndarray]] = {
    "triangles": _read_triangles,
    "polylist": _read_polylist,
    "polygons": _read_polygons,
    "trifans": _read_fans,
    "tristrips": _read_strips,
}
"""Functions to triangles (t, 3) by kind of primitive; other kinds are left out."""


def _node_placement(node: Element) -> np.ndarray:
    """Return the affine map of a node's transformations, in their order, shape (4, 4)."""
    placement = np.eye(4)
    for child in node:
        if transform := TRANSFORMS.get(local_name(child)):
            placement = placement @ transform(child)
    return placement


def _read_values(element: Element, count: int) -> np.ndarray:
    values = floats((element.text or "").encode(), f"<{local_name(element)}>")
    if len(values) != count or not np.isfinite(values).all():
        raise MeshFault(f"has a <{local_name(element)}> that is not {count} finite numbers")
    return values


def _read_matrix(element: Element) -> np.ndarray:
    return _read_values(element, 16).reshape(4, 4)


def _read_translation(element: Element) -> np.ndarray:
    placement = np.eye(4)
    placement[:3, 3] = _read_values(element, 3)
    return placement


def _read_rotation(element: Element) -> np.ndarray:
    """Return the rotation about an axis by an angle in degrees, by Rodrigues' formula, shape (4, 4)."""
    *axis, degrees = _read_values(element, 4).tolist()
    angle, placement, length = math.radians(degrees), np.eye(4), float(np.linalg.norm(axis))
    if length > 0.0:
        x, y, z = np.array(axis) / length
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        placement[:3, :3] += math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    return placement


def _read_look_at(element: Element) -> np.ndarray:
    eye, target, up = _read_values(element, 9).reshape(3, 3)
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(up, back) / np.linalg.norm(np.cross(up, back))
    placement = np.eye(4)
    placement[:3] = np.column_stack([right, np.cross(back, right), back, eye])
    return placement


def _read_skew(element: Element) -> np.ndarray:
    """Return RenderMan's skew, (4, 4): an angle, the axis that is turned, and the axis towards which it is turned."""
    degrees, *axes = _read_values(element, 7).tolist()
    turned, towards = np.array(axes).reshape(2, 3)
    towards = towards / np.linalg.norm(towards)
    along = float(turned @ towards)
    across = turned - along * towards
    height = float(np.linalg.norm(across))
    moved = height * math.tan(math.radians(degrees) + math.atan2(along, height)) - along
    placement = np.eye(4)
    placement[:3, :3] += np.outer(moved * towards, across) / height**2
    return placement


TRANSFORMS: dict[str, Callable[[Element], np.ndarray]] = {
    "lookat": _read_look_at,
    "matrix": _read_matrix,
    "rotate": _read_rotation,
    "scale": lambda element: np.diag([*_read_values(element, 3), 1.0]),
    "skew": _read_skew,
    "translate": _read_translation,
}
"""Functions to the affine map (4, 4) by kind of transformation."""


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
        placement = above @ _item_placement(reference)
        if (mesh := child_of(found, "mesh")) is not None:
            collected.add(_read_object_mesh(mesh), placement)
        components = child_of(found, "components")
        below = [] if components is None else children(components, "component")
        pending += [(part, component, placement, depth + 1) for component in reversed(below)]
    return collected.objects()


def read_three_mf_unit(content: bytes) -> str:
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
            return THREE_MF_START
        for one in children(self._xml("_rels/.rels"), "Relationship"):
            if one.get("Type") == THREE_MF_START_KIND:
                return posixpath.normpath(str(one.get("Target", THREE_MF_START)).lstrip("/"))
        return THREE_MF_START

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
            if self._archive.getinfo(part).file_size > MAX_PART_BYTES:
                raise MeshFault(f"unpacks to more than {MAX_PART_BYTES} bytes")
            return etree.fromstring(self._archive.read(part), etree.XMLParser(**STRICT_XML))
        except KeyError:
            raise MeshFault(f"is no 3MF file: it has no part {part!r}") from None
        except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, EOFError) as error:
            raise MeshFault(f"can't be unpacked: {error}") from None
        except etree.XMLSyntaxError as error:
            raise MeshFault(f"has a part {part!r} that is not XML: {error}") from None


def _read_object_mesh(mesh: Element) -> Triangles:
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


def _item_placement(reference: Element) -> np.ndarray:
    """Return the affine map of an item or component, shape (4, 4): the file has it transposed, for rows."""
    placement = np.eye(4)
    if (text := reference.get("transform")) is not None:
        values = floats(text.encode(), "transform")
        if len(values) != 12:
            raise MeshFault(f"has a transform of {len(values)} numbers, not 12")
        placement[:3] = values.reshape(4, 3).T
    return placement
