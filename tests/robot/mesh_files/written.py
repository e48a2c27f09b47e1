"""Mesh files of every kind, written by hand: several parts as materials, primitives, geometries, nodes, instances."""

import base64
import io
import json
import struct
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
"""Quadrilaterals of a box whose corners count up in z, then y, then x; counter-clockwise from outside."""
HALVES = np.array([half for a, b, c, d in SIDES for half in ((a, b, c), (a, c, d))])


@dataclass(frozen=True)
class Part:
    """A box: its lower corner, its size, and its affine map in the file, shape (4, 4)."""

    low: tuple[float, float, float]
    size: tuple[float, float, float]
    placement: np.ndarray

    @property
    def vertices(self) -> np.ndarray:
        """Corners in the part's own frame, shape (8, 3)."""
        return np.array(self.low) + np.indices((2, 2, 2)).reshape(3, 8).T * np.array(self.size)

    @property
    def placed(self) -> np.ndarray:
        """Corners in the file's frame, shape (8, 3)."""
        return self.vertices @ self.placement[:3, :3].T + self.placement[:3, 3]

    @property
    def triangles(self) -> np.ndarray:
        """Triangles of `placed`, outwards also where the placement mirrors them, shape (12, 3)."""
        return HALVES[:, ::-1] if np.linalg.det(self.placement[:3, :3]) < 0.0 else HALVES


def part(low: Sequence[float], size: Sequence[float], placement: np.ndarray | None = None) -> Part:
    """A box with a placement, or without."""
    (x, y, z), (a, b, c) = low, size
    return Part((x, y, z), (a, b, c), np.eye(4) if placement is None else placement)


def corners_of(parts: Sequence[Part]) -> np.ndarray:
    """Triangles of all parts in the file's frame, shape (t, 3, 3)."""
    return np.concatenate([one.placed[one.triangles] for one in parts])


def stl(parts: Sequence[Part], header: bytes = b"") -> bytes:
    """Binary."""
    corners = corners_of(parts)
    facets = [struct.pack("<12fH", 0, 0, 0, *corner.ravel(), 0) for corner in corners]
    return header.ljust(80, b" ") + struct.pack("<I", len(facets)) + b"".join(facets)


def stl_named_solid(parts: Sequence[Part]) -> bytes:
    """Binary, though it begins as a text does."""
    return stl(parts, b"solid of facet normal")


def stl_text(parts: Sequence[Part], name: str = "part") -> bytes:
    """A solid for each part."""
    lines = []
    for k, one in enumerate(parts):
        lines.append(f"solid {name} {k}")
        for corner in one.placed[one.triangles].tolist():
            rows = "".join(f"      vertex {x!r} {y!r} {z!r}\n" for x, y, z in corner)
            lines.append(f"  facet normal 0 0 0\n    outer loop\n{rows}    endloop\n  endfacet")
        lines.append(f"endsolid {name} {k}")
    return "\n".join([*lines, ""]).encode()


def obj_materials(parts: Sequence[Part]) -> bytes:
    """A material for each part, all vertices in one list, indices with texture coordinates and normals."""
    lines, count = ["mtllib m.mtl", "vt 0 0", "vn 0 0 1"], 0
    for k, one in enumerate(parts):
        lines += [f"usemtl part{k}", *(f"v {x!r} {y!r} {z!r}" for x, y, z in one.placed.tolist())]
        lines += [f"f {' '.join(f'{count + i + 1}/1/1' for i in face)}" for face in one.triangles.tolist()]
        count += 8
    return "\n".join([*lines, ""]).encode()


def obj_polygons(parts: Sequence[Part]) -> bytes:
    """Groups of quadrilaterals, by negative indices, lines continued; and points and lines that aren't judged."""
    lines = []
    for k, one in enumerate(parts):
        lines += [f"g part{k}", *(f"v {x!r} {y!r} \\\n {z!r}" for x, y, z in one.placed.tolist())]
        turned = np.linalg.det(one.placement[:3, :3]) < 0.0
        lines += [f"f {' '.join(f'{i - 8}' for i in (face[::-1] if turned else face))}" for face in SIDES]
        lines += ["l -1 -2", "p -3", "v 9 9 9"]
    return "\r\n".join([*lines, ""]).encode()


def off(parts: Sequence[Part]) -> bytes:
    """With colours and comments."""
    vertices, faces = np.concatenate([one.placed for one in parts]), []
    for k, one in enumerate(parts):
        faces += [f"3 {' '.join(str(i + 8 * k) for i in face)} 255 0 0" for face in one.triangles.tolist()]
    rows = [f"{x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    return "\n".join(["OFF # a file", f"{len(rows)} {len(faces)} 0", *rows, *faces, ""]).encode()


def ply_text(parts: Sequence[Part]) -> bytes:
    """Quadrilaterals, and an element that nobody knows."""
    rows = [f"{x!r} {y!r} {z!r}" for one in parts for x, y, z in one.placed.tolist()]
    faces = []
    for k, one in enumerate(parts):
        turned = np.linalg.det(one.placement[:3, :3]) < 0.0
        faces += [f"4 {' '.join(str(i + 8 * k) for i in (face[::-1] if turned else face))}" for face in SIDES]
    head = _ply_head("ascii", len(rows), len(faces), "double") + "element odd 1\nproperty list uchar int some\n"
    return "\n".join([head + "end_header", *rows, *faces, "2 7 7", ""]).encode()


def ply_binary(parts: Sequence[Part]) -> bytes:
    """Of the other byte order, with faces of different numbers of corners."""
    rows = np.concatenate([one.placed for one in parts]).astype(">f8").tobytes()
    faces, count = b"", 0
    for k, one in enumerate(parts):
        for face in one.triangles.tolist():
            faces, count = faces + struct.pack(">B3i", 3, *(i + 8 * k for i in face)), count + 1
    faces, count = faces + struct.pack(">B2i", 2, 0, 1), count + 1
    head = _ply_head("binary_big_endian", 8 * len(parts), count, "double") + "end_header\n"
    return head.encode() + rows + faces


def _ply_head(form: str, vertices: int, faces: int, kind: str) -> str:
    axes = "".join(f"property {kind} {axis}\n" for axis in "xyz")
    listed = "property list uchar int vertex_indices\n"
    return f"ply\nformat {form} 1.0\nelement vertex {vertices}\n{axes}element face {faces}\n{listed}"


def dae(
    parts: Sequence[Part], form: str = "nodes", unit: str = "1", up: str = "Z_UP", primitive: str = "triangles"
) -> bytes:
    """A COLLADA file.

    Args:
        parts: Its parts.
        form: `primitives` of one mesh, `geometries` of one node, `nodes` in one another, `library` of nodes, `skins`.
        unit: Its length in metres.
        up: The axis that is said to be up.
        primitive: `triangles`, `polylist`, `polygons`, `trifans` or `tristrips`.
    """
    if form == "primitives":
        pieces = [
            _dae_primitive(primitive, one, 8 * k, inward=np.linalg.det(one.placement[:3, :3]) < 0.0)
            for k, one in enumerate(parts)
        ]
        geometries = _dae_geometry("g", np.concatenate([one.placed for one in parts]), "".join(pieces))
        nodes = '<node><instance_geometry url="#g"/></node>'
    else:
        geometries = "".join(
            _dae_geometry(f"g{k}", one.vertices, _dae_primitive(primitive, one, 0, inward=False))
            for k, one in enumerate(parts)
        )
        nodes = ""
    extra = ""
    if form == "geometries":
        assert all((one.placement == np.eye(4)).all() for one in parts), "geometries of one node share its placement"
        instances = "".join(f'<instance_geometry url="#g{k}"/>' for k in range(len(parts)))
        nodes = f"<node>{instances}</node>"
    if form == "nodes":  # each below the one before it
        above = np.eye(4)
        for k, one in enumerate(parts):
            own = np.linalg.solve(above, one.placement)
            above, nodes = one.placement, nodes + f"<node>{_dae_matrix(own)}" + f'<instance_geometry url="#g{k}"/>'
        nodes += "</node>" * len(parts)
    if form == "library":
        shared = "".join(f'<node id="n{k}"><instance_geometry url="#g{k}"/></node>' for k in range(len(parts)))
        extra = f"<library_nodes>{shared}</library_nodes>"
        nodes = "".join(
            f'<node>{_dae_matrix(one.placement)}<instance_node url="#n{k}"/></node>' for k, one in enumerate(parts)
        )
    if form == "skins":
        skins = "".join(
            f'<controller id="c{k}"><skin source="#g{k}"><bind_shape_matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1'
            f"</bind_shape_matrix>{_DAE_JOINTS.format(k=k)}</skin></controller>"
            for k in range(len(parts))
        )
        extra = f"<library_controllers>{skins}</library_controllers>"
        nodes = "".join(
            f'<node id="root{k}">{_dae_matrix(one.placement)}<instance_controller url="#c{k}"/></node>'
            for k, one in enumerate(parts)
        )
    return (
        '<?xml version="1.0" encoding="utf-8"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
        f'version="1.4.1"><asset><!-- <unit meter="7"/> --><unit name="u" meter="{unit}"/><up_axis>{up}</up_axis>'
        "</asset>"
        f"<library_geometries>{geometries}</library_geometries>{extra}"
        f'<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    ).encode()


_DAE_JOINTS = (
    '<source id="j{k}"><Name_array id="ja{k}" count="1">root{k}</Name_array><technique_common>'
    '<accessor source="#ja{k}" count="1" stride="1"><param name="JOINT" type="name"/></accessor></technique_common>'
    "</source>"
    '<source id="b{k}"><float_array id="ba{k}" count="16">1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</float_array>'
    "<technique_common>"
    '<accessor source="#ba{k}" count="1" stride="16"><param name="T" type="float4x4"/></accessor></technique_common>'
    '</source><source id="w{k}"><float_array id="wa{k}" count="1">1</float_array><technique_common><accessor '
    'source="#wa{k}" count="1" stride="1"><param name="WEIGHT" type="float"/></accessor></technique_common></source>'
    '<joints><input semantic="JOINT" source="#j{k}"/><input semantic="INV_BIND_MATRIX" source="#b{k}"/></joints>'
    '<vertex_weights count="8"><input semantic="JOINT" source="#j{k}" offset="0"/><input semantic="WEIGHT" '
    'source="#w{k}" offset="1"/><vcount>1 1 1 1 1 1 1 1</vcount><v>0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0</v></vertex_weights>'
)


def _dae_matrix(placement: np.ndarray) -> str:
    return f"<matrix>{' '.join(map(repr, placement.ravel().tolist()))}</matrix>"


def _dae_geometry(name: str, vertices: np.ndarray, primitives: str) -> str:
    numbers = " ".join(map(repr, vertices.ravel().tolist()))
    axes = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    return (
        f'<geometry id="{name}"><mesh><source id="{name}p"><float_array id="{name}a" count="{vertices.size}">{numbers}'
        f'</float_array><technique_common><accessor source="#{name}a" count="{len(vertices)}" stride="3">{axes}'
        f'</accessor></technique_common></source><source id="{name}n"><float_array id="{name}na" count="3">0 0 1'
        f'</float_array><technique_common><accessor source="#{name}na" count="1" stride="3">{axes}</accessor>'
        f'</technique_common></source><vertices id="{name}v"><input semantic="POSITION" source="#{name}p"/></vertices>'
        f"{primitives.replace('@', name)}</mesh></geometry>"
    )


def _dae_primitive(kind: str, one: Part, first: int, inward: bool) -> str:
    """The faces of a box, with normals among the indices; beside lines."""
    inputs = '<input semantic="NORMAL" source="#@n" offset="1"/><input semantic="VERTEX" source="#@v" offset="0"/>'

    def p(face: Sequence[int]) -> str:
        turned = face[::-1] if inward else face
        return " ".join(f"{i + first} 0" for i in turned)

    lines = f'<lines count="1">{inputs}<p>{first} 0 {first + 7} 0</p></lines>'
    material = f'material="m{first}"'
    if kind == "triangles":
        body = f"<p>{' '.join(p(half) for half in HALVES.tolist())}</p>"
        return lines + f'<triangles {material} count="12">{inputs}{body}</triangles>'
    if kind == "polylist":
        body = f"<vcount>{' '.join('4' for _ in SIDES)}</vcount><p>{' '.join(map(p, SIDES))}</p>"
        return lines + f'<polylist {material} count="6">{inputs}{body}</polylist>'
    if kind == "tristrips":
        strips = [(a, b, d, c) if not inward else (b, a, c, d) for a, b, c, d in SIDES]
        body = "".join(f"<p>{' '.join(f'{i + first} 0' for i in strip)}</p>" for strip in strips)
        return lines + f'<tristrips {material} count="6">{inputs}{body}</tristrips>'
    body = "".join(f"<p>{p(face)}</p>" for face in SIDES)
    return lines + f'<{kind} {material} count="6">{inputs}{body}</{kind}>'


def gltf(parts: Sequence[Part], form: str = "nodes", binary: bool = False, buffer: str | None = None) -> bytes:
    """A glTF file.

    Args:
        parts: Its parts.
        form: `primitives` of one mesh, or `nodes` in one another.
        binary: As .glb.
        buffer: The name of the file with its buffer, which is `buffer_of(parts, form)`; else it is in it.
    """
    content = buffer_of(parts, form)
    views, accessors, at = [], [], 0
    for _ in parts:
        for size, kind, component, count in ((96, "VEC3", 5126, 8), (72, "SCALAR", 5123, 36)):
            views.append({"buffer": 0, "byteOffset": at, "byteLength": size})
            accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": count, "type": kind})
            at += size
    primitives = [{"attributes": {"POSITION": 2 * k}, "indices": 2 * k + 1} for k in range(len(parts))]
    nodes: list[dict[str, object]] = []
    if form == "primitives":
        meshes = [{"primitives": primitives}]
        nodes.append({"mesh": 0})
    else:
        meshes, above = [{"primitives": [one]} for one in primitives], np.eye(4)
        for k, one in enumerate(parts):
            own = np.linalg.solve(above, one.placement)
            above = one.placement
            nodes.append({"mesh": k, "matrix": own.T.ravel().tolist()})
            if k + 1 < len(parts):
                nodes[-1]["children"] = [k + 1]
    source = {"uri": buffer or "data:application/octet-stream;base64," + base64.b64encode(content).decode()}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": meshes,
        "buffers": [{"byteLength": len(content), **({} if binary else source)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(document).encode()
    if not binary:
        return text
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(content), b"BIN\0") + content
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def buffer_of(parts: Sequence[Part], form: str = "nodes") -> bytes:
    """Positions and indices of each part; those of primitives are where the part is."""
    content = b""
    for one in parts:
        mirrored = form == "primitives" and np.linalg.det(one.placement[:3, :3]) < 0.0
        corners = one.placed if form == "primitives" else one.vertices
        content += corners.astype("<f4").tobytes() + (HALVES[:, ::-1] if mirrored else HALVES).astype("<u2").tobytes()
    return content


def three_mf(parts: Sequence[Part], unit: str = "meter") -> bytes:
    """Components of one object, each an object of its own."""
    objects = ""
    for k, one in enumerate(parts):
        rows = "".join(f'<vertex x="{x!r}" y="{y!r}" z="{z!r}"/>' for x, y, z in one.vertices.tolist())
        faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in HALVES.tolist())
        mesh = f"<mesh><vertices>{rows}</vertices><triangles>{faces}</triangles></mesh>"
        objects += f'<object id="{k + 1}" type="model">{mesh}</object>'
    placed = "".join(
        f'<component objectid="{k + 1}" transform="{" ".join(map(repr, one.placement[:3].T.ravel().tolist()))}"/>'
        for k, one in enumerate(parts)
    )
    objects += f'<object id="99" type="model"><components>{placed}</components></object>'
    model = (
        f'<?xml version="1.0" encoding="UTF-8"?><model unit="{unit}" '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'
        f'<resources>{objects}</resources><build><item objectid="99"/></build></model>'
    )
    relations = (
        '<?xml version="1.0"?><Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
        '<Relationship Target="/3D/3dmodel.model" Id="r" '
        'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
    )
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("_rels/.rels", relations)
        archive.writestr("3D/3dmodel.model", model)
    return packed.getvalue()


WRITERS: dict[str, tuple[str, Callable[[Sequence[Part]], bytes]]] = {
    "stl": (".stl", stl),
    "stl that begins with solid": (".stl", stl_named_solid),
    "stl text": (".STL", stl_text),
    "obj materials": (".obj", obj_materials),
    "obj polygons": (".obj", obj_polygons),
    "off": (".off", off),
    "ply text": (".ply", ply_text),
    "ply binary": (".ply", ply_binary),
    "dae primitives": (".dae", lambda parts: dae(parts, "primitives")),
    "dae nodes": (".dae", lambda parts: dae(parts, "nodes")),
    "dae library": (".dae", lambda parts: dae(parts, "library")),
    "dae skins": (".dae", lambda parts: dae(parts, "skins", up="Y_UP")),
    "dae polylist": (".dae", lambda parts: dae(parts, "primitives", primitive="polylist", up="X_UP")),
    "dae polygons": (".dae", lambda parts: dae(parts, "nodes", primitive="polygons")),
    "dae fans": (".dae", lambda parts: dae(parts, "library", primitive="trifans")),
    "dae strips": (".DAE", lambda parts: dae(parts, "primitives", primitive="tristrips")),
    "gltf primitives": (".gltf", lambda parts: gltf(parts, "primitives")),
    "gltf nodes": (".gltf", gltf),
    "glb primitives": (".glb", lambda parts: gltf(parts, "primitives", binary=True)),
    "glb nodes": (".glb", lambda parts: gltf(parts, binary=True)),
    "3mf": (".3mf", three_mf),
}
"""Suffix and writer by what a file is like."""
