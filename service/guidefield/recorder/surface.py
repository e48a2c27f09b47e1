"""Make triangle meshes with normals and colours to draw: of a collision shape, a mesh file, or as a coarse sketch.

Numbers here change pictures and sizes of files. Any change of this file has all robots and large scenes drawn anew:
their files are named by a hash of it (`bodies.py`, `stored.py`).
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import trimesh
from PIL import EpsImagePlugin

from guidefield.geometry.closed import find_connected
from guidefield.geometry.convex import FlatError, convex_hull
from guidefield.geometry.surfaces import area_of
from guidefield.robot.mesh_files import reading as mesh_files
from guidefield.robot.mesh_files.numbers import MeshFault
from guidefield.robot.model.collision_shapes import triangulation

CREASE = np.radians(40.0)  # faces that meet at less than this angle are shaded as one smooth surface [rad]
SKETCH_CREASE = np.radians(85.0)  # the same for sketches, which have few and coarse faces [rad]
MERGED_DIGITS = 6  # decimals of a metre to which merged vertices are equal
SKETCH_VERTICES = 32  # most vertices of a body in a sketch
SIDES = 48  # sides of a drawn cylinder
SAME_EXTENT, SAME_AREA = 1e-3, 0.05
"""Our reading and trimesh's are the same if they differ by at most these shares: polygons may be cut differently."""
TEXTURE_SIZE = 512  # longest side of a texture, in pixels
GREY = (204, 204, 208, 255)  # colour of a body that has none of its own (RGBA)

_GHOSTSCRIPT = threading.Lock()


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh with normals."""

    vertices: np.ndarray  # shape (v, 3), float32 [m]
    triangles: np.ndarray  # vertex indices, shape (t, 3), uint32, counter-clockwise from outside
    normals: np.ndarray  # unit normals of the vertices, shape (v, 3), float32
    colors: np.ndarray | None = None  # RGBA per vertex, shape (v, 4), uint8; None where the whole body has one colour

    def move(self, placement: Any) -> Surface:
        """Return the surface in another frame, given its placement there (pinocchio.SE3)."""
        rotation = placement.rotation.T.astype(np.float32)
        vertices = self.vertices @ rotation + placement.translation.astype(np.float32)
        return Surface(vertices, self.triangles, self.normals @ rotation, self.colors)

    def grow(self, by: float) -> Surface:
        """Return the surface with its vertices moved out along their normals [m]."""
        return Surface(self.vertices + np.float32(by) * self.normals, self.triangles, self.normals, self.colors)

    def with_color(self, color: Sequence[int]) -> Surface:
        """Return the surface in one colour (RGBA)."""
        colors = np.full((len(self.vertices), 4), color, np.uint8)
        return Surface(self.vertices, self.triangles, self.normals, colors)


def shade(vertices: np.ndarray, triangles: np.ndarray, crease: float = CREASE) -> Surface:
    """Return a surface of vertices (v, 3) [m] and triangles (t, 3), smooth except at edges of a crease angle [rad]."""
    places, merged = np.unique(np.round(vertices, MERGED_DIGITS), axis=0, return_inverse=True)
    corners = merged.reshape(-1)[np.asarray(triangles)]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    areas = 0.5 * np.cross(places[corners[:, 1]] - places[corners[:, 0]], places[corners[:, 2]] - places[corners[:, 0]])
    shared = _smooth_corners(corners, areas, crease)
    count = int(shared.max(initial=-1)) + 1
    normals = np.column_stack([np.bincount(shared, np.repeat(component, 3), count) for component in areas.T])
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    positions = np.empty((count, 3), np.float32)
    positions[shared] = places[corners.ravel()]
    return Surface(positions, shared.reshape(-1, 3).astype(np.uint32), normals.astype(np.float32))


def join(surfaces: list[Surface]) -> Surface:
    """Return several surfaces as one; they are all coloured, or none is."""
    counts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    colors = [surface.colors for surface in surfaces if surface.colors is not None]
    return Surface(
        np.concatenate([surface.vertices for surface in surfaces]),
        np.concatenate([s.triangles + np.uint32(offset) for s, offset in zip(surfaces, counts[:-1], strict=True)]),
        np.concatenate([surface.normals for surface in surfaces]),
        np.concatenate(colors) if colors else None,
    )


def of_shape(shape: Any) -> Surface:
    """Return the surface of a Coal shape in its own frame; raises ValueError if it can't be drawn."""
    for kind, outline in OUTLINES.items():
        if isinstance(shape, kind):
            return shade(*outline(shape))
    raise ValueError(f"a {type(shape).__name__} can't be drawn")


def sketch(surface: Surface) -> Surface:
    """Return the hull of few of a surface's points, evenly spread, to show a pose; a flat surface unchanged."""
    try:
        hull = convex_hull(_spread_points(surface.vertices.astype(float), SKETCH_VERTICES))
    except FlatError:
        return surface
    return shade(*hull, crease=SKETCH_CREASE)


def read_mesh(path: Path, scale: np.ndarray, override: Sequence[int] | None) -> Surface | bytes:
    """Read a mesh file, scaled (3,), by our reader; colours are trimesh's if that reads the same shape.

    Returns a coloured surface, in one RGBA if `override` has one; or, if the file has textures and there is none, the
    content of a GLB file with small textures. Raises ValueError if there is nothing to draw in it.
    """
    try:
        plain = mesh_files.read_mesh(path, scale)
    except MeshFault as fault:
        raise ValueError(f"{path.name} {fault}") from None
    with _without_ghostscript():
        meshes = _file_meshes(path)
        for mesh in meshes:
            mesh.apply_scale(scale * mesh_files.unit_of(path))
        if not _same_extent(meshes, plain):
            return shade(plain.vertices, plain.triangles).with_color(GREY if override is None else override)
        if override is None and any(_texture(mesh) is not None for mesh in meshes):
            return _as_glb(meshes)
        return join([_color_mesh(mesh, override) for mesh in meshes])


@contextlib.contextmanager
def _without_ghostscript() -> Iterator[None]:
    """Keep Pillow from running textures that are PostScript, which it recognizes by content, whatever their name.

    Only here: the process may be a user's, who reads such files elsewhere.
    """
    with _GHOSTSCRIPT:
        before, EpsImagePlugin.gs_binary = EpsImagePlugin.gs_binary, False
        try:
            yield
        finally:
            EpsImagePlugin.gs_binary = before


def _file_meshes(path: Path) -> list[trimesh.Trimesh]:
    """Return the meshes of a file in its frame; none if trimesh can't read it."""
    try:
        parts = trimesh.load_scene(path).dump()
    except (KeyError, IndexError, AttributeError, TypeError, ValueError, ImportError):  # of its readers, for odd files
        return []
    return [mesh for mesh in parts if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]


def _same_extent(meshes: list[trimesh.Trimesh], plain: mesh_files.FileMesh) -> bool:
    if not meshes:
        return False
    boxes = np.array([mesh.bounds for mesh in meshes])
    box = np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    ours = np.array([plain.vertices.min(axis=0), plain.vertices.max(axis=0)])
    area, wanted = sum(float(mesh.area) for mesh in meshes), area_of(plain.vertices[plain.triangles])
    size = float(np.abs(ours).max())
    return bool(np.abs(box - ours).max() <= SAME_EXTENT * size and abs(area - wanted) <= SAME_AREA * wanted)


def _as_glb(meshes: list[trimesh.Trimesh]) -> bytes:
    for mesh in meshes:
        if (image := _texture(mesh)) is not None:
            small = image.convert("RGB")
            small.thumbnail((TEXTURE_SIZE, TEXTURE_SIZE))
            small.format = "JPEG"
            material = trimesh.visual.material.PBRMaterial(
                baseColorTexture=small, metallicFactor=0.0, roughnessFactor=0.8
            )
            mesh.visual = trimesh.visual.TextureVisuals(uv=mesh.visual.uv, material=material)
    glb: bytes = trimesh.Scene(meshes).export(file_type="glb")
    return glb


def _color_mesh(mesh: trimesh.Trimesh, override: Sequence[int] | None) -> Surface:
    if override is not None:
        return shade(mesh.vertices, mesh.faces).with_color(override)
    visual = mesh.visual
    if isinstance(visual, trimesh.visual.TextureVisuals):
        return shade(mesh.vertices, mesh.faces).with_color(visual.material.main_color)
    if visual.kind is None:
        return shade(mesh.vertices, mesh.faces).with_color(GREY)
    # Colours by face or by corner don't survive merging: flat shading leaves them unchanged.
    triangles = np.arange(3 * len(mesh.faces), dtype=np.uint32).reshape(-1, 3)
    by_face = visual.kind == "face"
    colors = visual.face_colors.repeat(3, axis=0) if by_face else visual.vertex_colors[mesh.faces].reshape(-1, 4)
    vertices = np.asarray(mesh.triangles, np.float32).reshape(-1, 3)
    normals = np.asarray(mesh.face_normals, np.float32).repeat(3, axis=0)
    return Surface(vertices, triangles, normals, np.asarray(colors, np.uint8))


def _texture(mesh: trimesh.Trimesh) -> Any:
    material = getattr(mesh.visual, "material", None)
    if getattr(mesh.visual, "uv", None) is None:
        return None
    image = getattr(material, "image", None)
    return image if image is not None else getattr(material, "baseColorTexture", None)


def _spread_points(points: np.ndarray, count: int) -> np.ndarray:
    """Choose at most a number of the points (n, 3), each the farthest from those before it."""
    distances = np.linalg.norm(points - points.mean(axis=0), axis=1)
    chosen = []
    for _ in range(min(count, len(points))):
        chosen.append(int(np.argmax(distances)))
        distances = np.minimum(distances, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]


def _smooth_corners(corners: np.ndarray, areas: np.ndarray, crease: float) -> np.ndarray:
    """Label corners (3 t,) from 0: those joined across edges that aren't creases share a vertex and a normal.

    Triangles (t, 3) are of merged vertices, with area vectors (t, 3); an edge is sharp from an angle on [rad].
    """
    starts, ends = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    at_end = np.roll(np.arange(len(starts)).reshape(-1, 3), -1, axis=1).ravel()
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    order = np.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    one, other = order[:-1][same], order[1:][same]
    units = areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), 1e-30)
    cosines = np.einsum("ij,ij->i", units[one // 3], units[other // 3])
    one, other = one[cosines > np.cos(crease)], other[cosines > np.cos(crease)]
    # Edge k of a triangle runs from its corner k to the next; the neighbour's edge runs the same way or the other.
    along = starts[one] == starts[other]
    pairs = np.vstack(
        [
            np.column_stack([one, np.where(along, other, at_end[other])]),
            np.column_stack([at_end[one], np.where(along, at_end[other], other)]),
        ]
    )
    labels = find_connected(len(starts), pairs)
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def _mesh(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


OUTLINES: dict[type, Callable[[Any], tuple[np.ndarray, np.ndarray]]] = {
    coal.Box: lambda box: _mesh(trimesh.creation.box(2.0 * box.halfSide)),
    coal.Sphere: lambda ball: _mesh(trimesh.creation.icosphere(subdivisions=3, radius=ball.radius)),
    coal.Ellipsoid: lambda e: _mesh(trimesh.creation.icosphere(subdivisions=3).apply_scale(e.radii)),
    coal.Cylinder: lambda c: _mesh(trimesh.creation.cylinder(c.radius, 2.0 * c.halfLength, sections=SIDES)),
    coal.Capsule: lambda c: _mesh(trimesh.creation.capsule(2.0 * c.halfLength, c.radius, (24, 24))),
    coal.BVHModelBase: triangulation,
    coal.ConvexBase: triangulation,
}
"""Vertices and triangles by kind of Coal shape."""
