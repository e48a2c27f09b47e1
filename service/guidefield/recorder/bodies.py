"""The bodies of a robot as Rerun chunks: meshes, collision shapes, bounding spheres; made once, kept in a file.

The file's name is a hash of the robot, of packages, and of the source of this file, of `surface.py` and of the mesh
files' `reading.py`, so that a change of these draws all robots anew; after one of a format's reader, files that are
there stay. Entities are those that `view.py` shows.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import rerun as rr
from lxml import etree
from rerun.chunk import Chunk

from guidefield.errors import strip_path
from guidefield.geometry import cache
from guidefield.memo import MISSING, Answers
from guidefield.recorder import surface
from guidefield.recorder.chunks import UNREADABLE, encode_recording, entity, link_frame, read_chunks, read_meshes, still
from guidefield.recorder.surface import GREY, Surface
from guidefield.robot.link_bounds import recall_coverage
from guidefield.robot.mesh_files import reading as mesh_files
from guidefield.robot.model.model import RobotModel, RobotSource
from guidefield.whole_file import DRAFT, write_whole

SKETCHED_APART = 2  # a link with more bodies is sketched as one body
COLLISION_COLOR = (96, 165, 250, 110)  # colour of collision geometry (RGBA)
FAULT_COLOR = (230, 57, 53, 255)  # colour of links and obstacles in collision (RGBA)
OUTSIDE = 0.003  # distance outside of a link at which its red shape is drawn: neither shines through the other [m]
MEDIA_TYPE_GLB = "model/gltf-binary"
MOST_FILES = 64
"""Robots' files in a folder; recordings of a robot that was dropped leave the store without its meshes."""
ABANDONED_S = 3600.0  # age of a draft from which its writer must have ended [s]
NAMES = "/prepared"  # the entity with the names of links and sketches in a file, and its faults


@dataclass(frozen=True, eq=False)
class Drawn:
    """A robot ready to be drawn, but for its meshes, which are in a file."""

    # with `/robot/visual/<body>`, `/robot/collision/<body>`, `/robot/spheres/<link>`, in links' frames
    file: Path
    links: tuple[str, ...]  # links with bodies
    sketch: tuple[tuple[str, Surface], ...]  # links with coarse hulls of their collision geometry, in links' frames
    faults: tuple[str, ...]  # sentences about bodies that can't be drawn, or a file that can't be written


def prepare(robot: RobotModel, file: Path) -> tuple[Drawn, list[Chunk]]:
    """Read a robot's meshes into chunks for a file, in seconds; without visual geometry draw its collision geometry."""
    seen, faults = visual_bodies(robot.source)
    colliding = collision_bodies(robot)
    chunks = [_chunk("visual", body) for body in seen or colliding]
    chunks += [_chunk("collision", body, COLLISION_COLOR) for body in colliding]
    chunks += cover_spheres(robot)
    links = tuple(dict.fromkeys(body.link for body in (*seen, *colliding)))
    return Drawn(file, links, _sketch(colliding), faults), chunks


def highlight(robot: RobotModel, links: Collection[str]) -> Iterator[Chunk]:
    """Draw the collision geometry of some links again, in red, as `/robot/at_fault/<body>`, just outside the link."""
    for body in collision_bodies(robot, links):
        assert isinstance(body.surface, Surface), "collision geometry is a surface"
        yield _chunk("at_fault", replace(body, surface=body.surface.grow(OUTSIDE)), FAULT_COLOR)


def collision_bodies(robot: RobotModel, links: Collection[str] | None = None) -> tuple[Body, ...]:
    """Return the collision shapes in their links' frames, if links are named, of these only."""
    bodies = []
    for index, shape in enumerate(robot.geometry.geometryObjects):
        link = robot.link_of_geometry(index)
        if links is not None and link not in links:
            continue
        in_link = robot.model.frames[robot.frame_id(link)].placement.inverse() * shape.placement
        bodies.append(Body(shape.name, link, surface.of_shape(shape.geometry).move(in_link), pin.SE3.Identity()))
    return tuple(bodies)


def _sketch(bodies: tuple[Body, ...]) -> tuple[tuple[str, Surface], ...]:
    by_link: dict[str, list[Surface]] = {}
    for body in bodies:
        if isinstance(body.surface, Surface):
            by_link.setdefault(body.link, []).append(body.surface)
    sketched = []
    for link, surfaces in by_link.items():
        whole = surfaces if len(surfaces) <= SKETCHED_APART else [surface.join(surfaces)]
        sketched += [(link, surface.sketch(one)) for one in whole]
    return tuple(sketched)


def _chunk(tree: str, body: Body, color: tuple[int, int, int, int] | None = None) -> Chunk:
    frame = rr.CoordinateFrame(link_frame(body.link))
    path = entity("robot", tree, body.name)
    if isinstance(body.surface, bytes):
        pose = rr.InstancePoses3D(
            translations=[body.placement.translation], quaternions=[pin.Quaternion(body.placement.rotation).coeffs()]
        )
        return still(path, frame, rr.Asset3D(contents=body.surface, media_type=MEDIA_TYPE_GLB), pose)
    return still(path, frame, mesh(body.surface, color or (body.color if body.surface.colors is None else None)))


def mesh(drawn: Surface, color: tuple[int, int, int, int] | None = None) -> rr.Mesh3D:
    """Return Rerun's mesh of a surface; `color` (RGBA) tints it as a whole."""
    return rr.Mesh3D(
        vertex_positions=drawn.vertices,
        triangle_indices=drawn.triangles,
        vertex_normals=drawn.normals,
        vertex_colors=drawn.colors,
        albedo_factor=color,
    )


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body of a link."""

    name: str  # `<link>_<number>`, or the collision shape's
    link: str
    surface: Surface | bytes  # in the link's frame, or the content of a GLB file in the body's
    placement: Any  # of the GLB file's content in the link, T_link_body
    color: tuple[int, int, int, int] = GREY


def visual_bodies(source: RobotSource) -> tuple[tuple[Body, ...], tuple[str, ...]]:
    """Read the visual bodies of a checked robot in the URDF's order, and a sentence for each that can't be drawn."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True)
    root = etree.fromstring(source.urdf_text.encode(), parser)
    materials = {material.get("name"): material for material in root.findall("material")}
    bodies, faults = [], []
    for link in root.findall("link"):
        for number, element in enumerate(link.findall("visual")):
            name = f"{link.get('name')}_{number}"
            try:
                bodies.append(_body(name, link.get("name"), element, materials))
            except (ValueError, KeyError, TypeError, IndexError, AttributeError, OSError) as error:
                # Readers of foreign mesh files raise all of these; a picture may lack a part, a plan doesn't.
                faults.append(f"visual {name} is not drawn: {error}")
    return tuple(bodies), tuple(faults)


def _body(name: str, link: str, element: Any, materials: dict[str, Any]) -> Body:
    placement = _placement(element.find("origin"))
    color = _color(element.find("material"), materials)
    shape = element.find("geometry")[0]
    if shape.tag == "mesh":
        scale = _numbers(shape.get("scale", "1 1 1"))
        drawn = surface.read_mesh(Path(shape.get("filename")), scale, color)
    elif shape.tag in PRIMITIVES:
        drawn = surface.of_shape(PRIMITIVES[shape.tag](shape))
    else:
        raise ValueError(f"<{shape.tag}> is no geometry")
    if isinstance(drawn, Surface):
        drawn, placement = drawn.move(placement), pin.SE3.Identity()
    return Body(name, link, drawn, placement, color or GREY)


def _placement(origin: Any) -> Any:
    if origin is None:
        return pin.SE3.Identity()
    if (quaternion := origin.get("quat_xyzw")) is not None:
        rotation = pin.Quaternion(_numbers(quaternion)).normalized().matrix()
    else:
        rotation = pin.rpy.rpyToMatrix(_numbers(origin.get("rpy", "0 0 0")))
    return pin.SE3(rotation, _numbers(origin.get("xyz", "0 0 0")))


def _color(material: Any, materials: dict[str, Any]) -> tuple[int, int, int, int] | None:
    """RGBA of a <material>, its own or the one it names; None where neither says."""
    for one in (material, None if material is None else materials.get(material.get("name"))):
        color = None if one is None else one.find("color")
        if color is not None:
            rgba = np.round(255.0 * np.clip(_numbers(color.get("rgba")), 0.0, 1.0)).astype(int)
            return int(rgba[0]), int(rgba[1]), int(rgba[2]), int(rgba[3])
    return None


def _numbers(text: str) -> np.ndarray:
    return np.array([float(number) for number in text.split()])


PRIMITIVES: dict[str, Callable[[Any], Any]] = {
    "box": lambda box: coal.Box(*_numbers(box.get("size"))),
    "sphere": lambda sphere: coal.Sphere(float(sphere.get("radius"))),
    "cylinder": lambda c: coal.Cylinder(float(c.get("radius")), float(c.get("length"))),
    "capsule": lambda c: coal.Capsule(float(c.get("radius")), float(c.get("length"))),
}
"""Coal shape by URDF element."""
SPHERE_COLOR = (125, 175, 240, 255)  # colour of bounding spheres (RGBA)


def list_sphere_counts(robot: RobotModel) -> str:
    """List the numbers of the shapes' bounding spheres; "-" for a shape without any."""
    return " ".join("-" if one is None else f"{len(one.cover.spheres)}" for one in recall_coverage(robot))


def cover_spheres(robot: RobotModel) -> Iterator[Chunk]:
    """Draw `/robot/spheres/<link>`: the bounding spheres of a link's collision shapes, in its frame."""
    by_link: dict[str, list[np.ndarray]] = {}
    for index, (shape, one) in enumerate(zip(robot.geometry.geometryObjects, recall_coverage(robot), strict=True)):
        if one is None:
            continue
        link = robot.link_of_geometry(index)
        in_link = robot.model.frames[robot.frame_id(link)].placement.inverse() * shape.placement
        balls = one.cover.spheres
        centers = balls[:, :3] @ in_link.rotation.T + in_link.translation
        by_link.setdefault(link, []).append(np.column_stack([centers, balls[:, 3]]))
    for link, parts in by_link.items():
        balls = np.concatenate(parts)
        drawn = rr.Points3D(balls[:, :3], radii=balls[:, 3], colors=[SPHERE_COLOR])
        yield still(entity("robot", "spheres", link), rr.CoordinateFrame(link_frame(link)), drawn)


def cache_folder() -> Path:
    """Return the folder of prepared robots for runs without a store, beside the geometry's cache."""
    return cache.folder().with_name("drawn")


def load_drawn(robot: RobotModel, folder: Path) -> Drawn:
    """Return a robot ready to be drawn, from its file in a folder, made if need be; a disk's refusal is a fault."""
    drawn = _PREPARED.of(robot, folder)
    if drawn is MISSING or not (drawn.faults or drawn.file.exists()):  # somebody may have cleared the folder away
        _PREPARED.forget(robot, folder)
        drawn = _PREPARED.keep(robot, folder, _prepare(robot, folder))
    return drawn


def meshes(robot: RobotModel, drawn: Drawn) -> list[Chunk]:
    """Return a robot's meshes, as `prepare` makes them; from its file if that is whole."""
    try:
        return read_meshes(drawn.file)
    except UNREADABLE:
        return prepare(robot, drawn.file)[1]


_PREPARED = Answers[Drawn]()


def _prepare(robot: RobotModel, folder: Path) -> Drawn:
    file = folder / f"{_fingerprint(robot)}.rrd"
    try:
        known = _read(file)
    except UNREADABLE:
        drawn, chunks = prepare(robot, file)
    else:
        with contextlib.suppress(OSError):
            os.utime(file)  # files that weren't used as lately are dropped before it
        return known
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(file, encode_recording(file.stem, [*chunks, *_sketch_chunks(drawn)], None), durable=False)
    except OSError as error:
        return replace(drawn, faults=(*drawn.faults, f"the robot's meshes could not be kept: {strip_path(error)}"))
    with contextlib.suppress(OSError):  # another process may make room too
        _make_room(folder)
    return drawn


def _make_room(folder: Path) -> None:
    """Drop the least recently used robots, if there are too many, and drafts of killed writers."""
    files = sorted(folder.glob("*.rrd"), key=lambda file: file.stat().st_mtime, reverse=True)
    for old in files[MOST_FILES:]:
        old.unlink(missing_ok=True)
    for draft in folder.glob(f".*{DRAFT}"):
        if time.time() - draft.stat().st_mtime > ABANDONED_S:
            draft.unlink(missing_ok=True)


def _fingerprint(robot: RobotModel) -> str:
    source = robot.source.urdf_text.encode()
    digest = hashlib.sha256(f"{rr.__version__} {version('trimesh')} {list_sphere_counts(robot)} ".encode() + source)
    for module in (__file__, mesh_files.__file__, surface.__file__):
        digest.update(Path(module).read_bytes())
    for element in etree.fromstring(source).iter("mesh"):
        path = Path(element.get("filename"))
        if path.exists():
            state = path.stat()
            digest.update(f"{path} {state.st_size} {state.st_mtime_ns}".encode())
    return digest.hexdigest()[:32]


def _sketch_chunks(drawn: Drawn) -> list[Chunk]:
    sketched = [still(entity("sketch", f"{number}"), mesh(one)) for number, (_, one) in enumerate(drawn.sketch)]
    names = {"links": list(drawn.links), "sketched": [link for link, _ in drawn.sketch], "faults": list(drawn.faults)}
    lists = {name: [one or "" for one in values] or [""] for name, values in names.items()}
    return [*sketched, still(NAMES, rr.AnyValues(**lists))]


def _read(file: Path) -> Drawn:
    chunks = {chunk.entity_path: chunk for chunk in read_chunks(file)}
    batch = chunks[NAMES].to_record_batch()
    links, sketched, faults = (
        tuple(filter(None, batch.column(name).to_pylist()[0])) for name in ("links", "sketched", "faults")
    )
    sketch = tuple((link, _surface(chunks[entity("sketch", f"{number}")])) for number, link in enumerate(sketched))
    return Drawn(file, links, sketch, faults)


def _surface(chunk: Chunk) -> Surface:
    batch = chunk.to_record_batch()
    vertices, triangles, normals = (
        batch.column(f"Mesh3D:{name}").flatten().flatten().to_numpy().reshape(-1, 3)
        for name in ("vertex_positions", "triangle_indices", "vertex_normals")
    )
    return Surface(vertices, triangles, normals)
