"""Build Coal's shapes of what a case declares, of mesh files too, which Assimp's command reads; check their surfaces.

What is built must be what docs/referee.md says of a case; the page promises `SINGLE`, too. Mesh files are read without
guidefield's readers (robot/mesh_files), so that a part which these lose is seen. The command writes the scene that it
has read, "assbin", of which nodes and meshes are taken: its own flattening takes a node that is moved by less than a
hundredth for one that isn't moved. `ASSIMP_SECONDS` decides which files are refused as too slow.
"""

from __future__ import annotations

import base64
import functools
import itertools
import os
import re
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

SPECK = 1e-9  # side of the triangle that represents a point [m], and as a share of its distance from the origin
SINGLE = 1e-6  # rounding of single precision, as a share of a mesh's largest coordinate or of 1 m

NO_TRIANGLES = np.empty((0, 3, 3))

PREFIX = "cmeel.prefix"  # folder of the packages among which Assimp is, as Coal needs it
ASSIMP_SECONDS = 60.0  # a file that takes the command longer isn't read [s]
ASSBIN_HEADER = 512  # bytes before the first chunk
SCENE, NODE, MESH = 0x1239, 0x123C, 0x1237  # marks of chunks
POSITIONS, NORMALS, TANGENTS = 1, 2, 4  # flags of what a mesh has
TEXTURES, COLORS = 0x100, 0x10000
"""First of the flags of texture coordinates and of colours, of which there may be eight sets."""

PREPARED = {
    ".dae": (re.compile(rb"(<(?:\w+:)?up_axis>)[^<]*"), rb"\1Y_UP"),  # the axis that Assimp leaves alone
    ".off": (re.compile(rb"[ \t]*#[^\r\n]*"), b""),  # a comment may keep Assimp for ever
}
"""By kind of file, what is replaced in it before Assimp reads it: as a copy, without other files that it names."""


def distinct(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find distinct points among points (n, 3): indices of one of each, (m,), sorted by value; and its place of each.

    It is `np.unique` for rows, which takes 14 ms for its imports.
    """
    order = np.lexsort(points.T[::-1])
    is_new = np.ones(len(points), bool)
    is_new[1:] = (np.diff(points[order], axis=0) != 0.0).any(axis=1)
    place = np.empty(len(points), int)
    place[order] = np.cumsum(is_new) - 1
    return order[is_new], place


def is_closed(triangles: np.ndarray) -> bool:
    """Return whether every edge of triangles (t, 3, 3) is run through as often in one direction as in the other."""
    index = distinct(triangles.reshape(-1, 3))[1].reshape(-1, 3)
    edges = np.column_stack([index.ravel(), np.roll(index, -1, axis=1).ravel()])
    return len(edges) > 0 and sorted(edges.tolist()) == sorted(edges[:, ::-1].tolist())


def winding(point: np.ndarray, triangles: np.ndarray) -> float:
    """Return how often closed triangles (t, 3, 3) wind around a point (3,): their solid angles over 4 pi."""
    arms = triangles - point
    (a, b, c), (ab, bc, ca) = np.linalg.norm(arms, axis=2).T, (arms * np.roll(arms, -1, axis=1)).sum(axis=2).T
    return float(np.arctan2(np.linalg.det(arms), a * b * c + ab * c + bc * a + ca * b).sum() / (2 * np.pi))


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape, and its placement in the frame that declares it; the other fields are those of `case.Body`."""

    exact: Any
    placement: Any
    rounding: float
    corners: np.ndarray
    triangles: np.ndarray
    points: np.ndarray


def distance(a: Any, at_a: Any, b: Any, at_b: Any) -> float:
    """Return the distance of two of Coal's shapes at coal.Transform3s [m]; where they overlap it isn't positive.

    Of two capsules it is that of their axes, by the ends and by where both slopes are zero: Coal's is off by up to
    23 um where they are short.
    """
    if not (isinstance(a, coal.Capsule) and isinstance(b, coal.Capsule)):
        return float(coal.distance(a, at_a, b, at_b, coal.DistanceRequest(), coal.DistanceResult()))
    u, v = (one.halfLength * at.getRotation()[:, 2] for one, at in ((a, at_a), (b, at_b)))
    w, between = at_a.getTranslation() - at_b.getTranslation(), max((u @ u) * (v @ v) - (u @ v) ** 2, 1e-300)
    along = [(u @ v * (w @ v) - v @ v * (w @ u)) / between, (u @ u * (w @ v) - u @ v * (w @ u)) / between]
    ends = [(s, (w + s * u) @ v / max(v @ v, 1e-300)) for s in (-1.0, 1.0)]
    ends += [((t * v - w) @ u / max(u @ u, 1e-300), t) for t in (-1.0, 1.0)]
    near = np.clip([along, *ends], -1.0, 1.0)
    apart = np.linalg.norm(w + near[:, :1] * u - near[:, 1:] * v, axis=1).min()
    return float(apart - a.radius - b.radius)


def placement_of(told: Mapping[str, Any]) -> Any:
    """Read a pinocchio.SE3 from `position` and `quaternion_xyzw`, of which either may be missing."""
    x, y, z, w = told.get("quaternion_xyzw", (0.0, 0.0, 0.0, 1.0))
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized(), np.array(told.get("position", (0.0, 0.0, 0.0)), float))


def shape_of(told: Mapping[str, Any], divided: Any = None) -> Shape | None:
    """Build the shape of an obstacle or held object; None of a kind that isn't known.

    Args:
        told: Its declaration.
        divided: Triangles (n - 2, 3) that the case says a polygon is divided into; None if it doesn't say.

    Raises:
        ValueError: if a polygon isn't simple, or isn't divided so.
    """
    kind, here = told["type"], placement_of(told)
    if kind == "half_space":
        normal = np.array(told["normal"], float)
        length = float(np.linalg.norm(normal))
        exact = coal.Halfspace(normal / length, float(told["offset"]) / length)
        return Shape(exact, pin.SE3.Identity(), 0.0, np.zeros((8, 3)), NO_TRIANGLES, np.empty((0, 3)))
    if kind in ("mesh", "polygon"):
        vertices = points_of(told["vertices"])
        triangles = np.array(told["triangles"], int) if kind == "mesh" else ears(vertices)
        if kind == "polygon" and divided is not None:
            triangles = np.array(divided, int)
            if not is_divided(vertices, triangles):
                raise ValueError("a polygon isn't divided into such triangles")
        return shape(surface(vertices, triangles), here)
    if kind == "point_cloud":
        points, radius = points_of(told["points"]), float(told["radius"])
        size = SPECK * (1.0 + np.abs(points).max())
        specks = (points[:, None] + size * np.eye(3)).reshape(-1, 3)
        exact = surface(specks, np.arange(len(specks)).reshape(-1, 3))
        return Shape(exact, here, radius, box_corners(exact, radius), NO_TRIANGLES, points)
    primitives = {
        "box": lambda: coal.Box(*map(float, told["size"])),
        "sphere": lambda: coal.Sphere(float(told["radius"])),
        "cylinder": lambda: coal.Cylinder(float(told["radius"]), float(told["length"])),
        "capsule": lambda: coal.Capsule(float(told["radius"]), float(told["length"])),
    }
    return shape(primitives[kind](), here) if kind in primitives else None


def shape(exact: Any, placement: Any) -> Shape:
    """Build the shape of a bounded Coal shape that stands at a pinocchio.SE3.

    A ball becomes a capsule without length: Coal finds balls in contact with triangles without area, wherever they are.
    """
    if isinstance(exact, coal.Sphere):
        exact = coal.Capsule(exact.radius, 0.0)
    corners, points, triangles = box_corners(exact, 0.0), np.zeros((1, 3)), NO_TRIANGLES
    if isinstance(exact, coal.BVHModelBase):
        vertices = np.array(exact.vertices()) + 0.0  # so that 0 and -0 are the same
        faces = np.array([[face[0], face[1], face[2]] for face in map(exact.tri_indices, range(exact.num_tris))])
        triangles, points = vertices[faces], vertices[first_of_each_piece(vertices, faces)]
    elif isinstance(exact, coal.ConvexBase):
        points = np.mean(exact.points(), axis=0, keepdims=True)
    return Shape(exact, placement, 0.0, corners, triangles, points)


def box_corners(exact: Any, more: float) -> np.ndarray:
    """Return the corners of the box about a Coal shape, larger all around by `more` [m], shape (8, 3)."""
    exact.computeLocalAABB()
    low, high = np.array(exact.aabb_local.min_) - more, np.array(exact.aabb_local.max_) + more
    return np.where(np.indices((2, 2, 2)).reshape(3, 8).T, high, low)


def points_of(told: Any) -> np.ndarray:
    """Read points, shape (n, 3) [m]: triples, or packed as little-endian float32 in base64."""
    if isinstance(told, dict):
        return np.frombuffer(base64.b64decode(told["float32"]), "<f4").astype(float).reshape(-1, 3)
    return np.array(told, float).reshape(-1, 3)


def surface(vertices: np.ndarray, triangles: np.ndarray) -> Any:
    """Build Coal's tree of triangles (t, 3) between vertices (v, 3) [m]."""
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(len(triangles), len(vertices))
    tree.addVertices(np.ascontiguousarray(vertices, float))
    tree.addTriangles(np.ascontiguousarray(triangles, np.int64))
    tree.endModel()
    return tree


def hull(points: np.ndarray) -> Any:
    """Build Coal's convex hull of points, shape (n, 3) [m], that don't lie in a plane.

    Its faces are found where the points are spread alike in all directions: on thin plates Qhull gives up.
    """
    offsets = points - points.mean(axis=0)
    _, spread, axes = np.linalg.svd(offsets, full_matrices=False)
    even = np.sign(np.linalg.det(axes)) * offsets @ (axes.T / spread) * np.sqrt(len(points))
    found = coal.Convex.convexHull(_vector(even), True, "Qt")
    place = {point.tobytes(): index for index, point in enumerate(even)}
    index = [place[vertex.tobytes()] for vertex in np.asarray(found.points())]
    faces = coal.StdVec_Triangle()
    for face in map(found.polygons, range(found.num_polygons)):
        faces.append(coal.Triangle(face[0], face[1], face[2]))
    return coal.Convex(_vector(points[index]), faces)


def _vector(points: np.ndarray) -> Any:
    vector = coal.StdVec_Vec3s()
    for point in points:
        vector.append(point)
    return vector


def first_of_each_piece(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return a vertex of each connected piece of triangles (t, 3) between vertices (v, 3): indices, shape (p,)."""
    first, same = distinct(vertices)
    corners = same[triangles]
    labels, before = np.arange(len(first)), None
    while before is None or (labels != before).any():
        before = labels.copy()
        np.minimum.at(labels, corners, labels[corners].min(axis=1, keepdims=True))
        labels = labels[labels]
    pieces: np.ndarray = first[sorted(set(labels[corners].ravel().tolist()))]
    return pieces


def snap_to_corners(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Move points (n, 3) to the nearest corner of triangles (t, 3, 3) if it is within single precision.

    The writer of the file has read a mesh in double precision, and Assimp reads it in single.
    """
    corners = triangles.reshape(-1, 3)
    corners = corners[distinct(corners)[0]]
    near = SINGLE * (1.0 + float(np.abs(corners).max(initial=0.0)))
    cells: dict[tuple[int, ...], list[np.ndarray]] = {}
    for corner, cell in zip(corners, np.floor(corners / (2.0 * near)).astype(int).tolist(), strict=True):
        cells.setdefault(tuple(cell), []).append(corner)
    found = points.copy()
    for k, (x, y, z) in enumerate(np.round(points / (2.0 * near)).astype(int).tolist()):
        around = itertools.product((x - 1, x), (y - 1, y), (z - 1, z))
        close = [corner for cell in around for corner in cells.get(cell, ())]
        nearest = min(close, key=lambda corner: float(np.abs(corner - points[k]).max()), default=points[k])
        if np.abs(nearest - points[k]).max() <= near:
            found[k] = nearest
    return found


def ears(corners: np.ndarray) -> np.ndarray:
    """Triangulate a flat, simple polygon with corners (n, 3) by cutting ears, (n - 2, 3) (Meisters 1975).

    Raises:
        ValueError: if it isn't simple.
    """
    flat = _flatten(corners)
    left, cut = list(range(len(corners))), []
    while len(left) > 2:
        ear = max(range(len(left)), key=lambda k: _area_of_ear(flat, left, k))
        if _area_of_ear(flat, left, ear) < 0.0:
            raise ValueError("a polygon isn't simple")
        cut.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return np.array(cut)


def is_divided(corners: np.ndarray, triangles: np.ndarray) -> bool:
    """Return whether triangles (t, 3) between the corners (n, 3) of a flat, simple polygon make it up.

    They do where all turn as it does, and their edges but for those of two, which go both ways, are its own.
    """
    if triangles.shape != (len(corners) - 2, 3) or not ((triangles >= 0) & (triangles < len(corners))).all():
        return False
    flat = _flatten(corners)
    areas = [float(_twice_area(flat[a], flat[b], flat[c][None])[0]) for a, b, c in triangles.tolist()]
    turned = [row if area >= 0.0 else row[::-1] for row, area in zip(triangles.tolist(), areas, strict=True)]
    edges = {(row[k - 1], row[k]) for row in turned for k in range(3)}
    own = {(k, (k + 1) % len(corners)) for k in range(len(corners))}
    return {(a, b) for a, b in edges if (b, a) not in edges} == own and len(edges) == 3 * len(triangles)


def _flatten(corners: np.ndarray) -> np.ndarray:
    """Return the corners (n, 3) of a flat polygon in a plane in which they turn to the left, shape (n, 2)."""
    following = np.roll(corners, -1, axis=0)
    normal = np.cross(corners - corners[0], following - corners[0]).sum(axis=0)
    drop = int(np.argmax(np.abs(normal)))
    flat: np.ndarray = np.delete(corners, drop, axis=1) * [1.0, np.sign(normal[drop]) * (-1.0 if drop == 1 else 1.0)]
    return flat


def _area_of_ear(flat: np.ndarray, left: Sequence[int], k: int) -> float:
    """Return the area that cutting off the corner left[k] removes; -1 if it can't be cut."""
    a, b, c = flat[left[k - 1]], flat[left[k]], flat[left[(k + 1) % len(left)]]
    others = flat[[one for one in left if one not in (left[k - 1], left[k], left[(k + 1) % len(left)])]]
    sides = [_twice_area(p, q, others) for p, q in ((a, b), (b, c), (c, a))]
    area = float(_twice_area(a, b, c[None])[0])
    within = np.all(np.array(sides) >= 0.0, axis=0) & (others != a).any(axis=1) & (others != c).any(axis=1)
    return area if area >= 0.0 and not (area > 0.0 and within.any()) else -1.0


def _twice_area(a: np.ndarray, b: np.ndarray, points: np.ndarray) -> np.ndarray:
    (x, y), (u, v) = b - a, (points - a).T
    area: np.ndarray = x * v - y * u
    return area


class UnreadableMesh(ValueError):
    """A mesh file that Assimp can't read."""


class _Node(NamedTuple):
    """A node: its affine map in its parent, shape (4, 4), its meshes, and its children."""

    placement: np.ndarray
    meshes: tuple[int, ...]
    children: tuple[_Node, ...]


def read_mesh_file(path: Path) -> np.ndarray:
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
        _run_assimp("export", str(path), str(made), "-fassbin", "-tri")
        try:
            root, meshes = _read_scene(made.read_bytes())
        except (struct.error, ValueError, IndexError) as error:
            raise UnreadableMesh(f"what Assimp made of it can't be read: {error}") from None
    placed = [np.empty((0, 3, 3)), *_place_meshes(root, np.eye(4), meshes)]
    triangles: np.ndarray = np.concatenate(placed)
    if not len(triangles):
        raise UnreadableMesh("Assimp finds no triangles in it")
    differ = [(triangles[:, i] != triangles[:, j]).any(axis=1) for i, j in ((0, 1), (1, 2), (2, 0))]
    proper: np.ndarray = np.logical_and.reduce(differ)
    return triangles[proper] if proper.any() else triangles


@functools.cache
def _find_prefix() -> Path:
    """Find the folder of the command and its libraries: that of the package cmeel-assimp, or a conda environment's."""
    try:
        return Path(str(distribution("cmeel-assimp").locate_file(PREFIX)))
    except PackageNotFoundError:
        return Path(sys.prefix)


def _run_assimp(*arguments: str) -> None:
    prefix = _find_prefix()
    paths = dict.fromkeys(("LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH"), str(prefix / "lib"))
    try:
        ran = subprocess.run(  # noqa: S603 - of a package that is installed, with files of our own
            [str(prefix / "bin" / "assimp"), *arguments],
            env={**os.environ, **paths},
            capture_output=True,
            check=False,
            timeout=ASSIMP_SECONDS,
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


def _read_scene(content: bytes) -> tuple[_Node, list[np.ndarray]]:
    scene = _Chunk(content, ASSBIN_HEADER, SCENE)
    _, count, *_ = scene.take("7I")
    root = _read_node(scene.chunk(NODE))
    return root, [_read_mesh(scene.chunk(MESH)) for _ in range(count)]


def _read_node(chunk: _Chunk) -> _Node:
    (length,) = chunk.take("I")
    chunk.take(f"{length}s")
    placement = np.array(chunk.take("16f"), float).reshape(4, 4)
    children, meshes, _ = chunk.take("3I")
    own = chunk.take(f"{meshes}I")
    return _Node(placement, own, tuple(_read_node(chunk.chunk(NODE)) for _ in range(children)))


def _read_mesh(chunk: _Chunk) -> np.ndarray:
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
