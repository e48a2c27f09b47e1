"""What is drawn of a robot, prepared once per robot: what it looks like, what is judged, a sketch for ghosts."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import pinocchio as pin
import rerun as rr
from rerun.chunk import Chunk

from guidefield.recorder import surface
from guidefield.recorder.chunks import entity, link_frame, still
from guidefield.recorder.spheres import cover_spheres
from guidefield.recorder.surface import Surface
from guidefield.recorder.visuals import Body, visual_bodies
from guidefield.robot.model.model import RobotModel

SKETCHED_APART = 2
"""Bodies of one link that are sketched one by one."""

COLLISION_COLOR = (96, 165, 250, 110)
"""Colour of collision geometry (RGBA)."""

FAULT_COLOR = (230, 57, 53, 255)
"""Colour of what is in collision (RGBA)."""

OUTSIDE = 0.003
"""How far outside of a link its red shape is drawn: neither shines through the other [m]."""

MEDIA_TYPE_GLB = "model/gltf-binary"


@dataclass(frozen=True, eq=False)
class RobotBodies:
    """A robot ready to be drawn.

    Attributes:
        chunks: `/robot/visual/<body>`, `/robot/collision/<body>` and `/robot/spheres/<link>`, each in its link's frame.
        links: Links that carry something.
        sketch: Per link the thinned-out hulls of its collision geometry, in the link's frame.
        faults: What can't be drawn.
    """

    chunks: tuple[Chunk, ...]
    links: tuple[str, ...]
    sketch: tuple[tuple[str, Surface], ...]
    faults: tuple[str, ...]


def prepare(robot: RobotModel) -> RobotBodies:
    """Read a robot's meshes and turn them into chunks, which may take seconds; `bodies_file.prepared` keeps them.

    A robot without visual geometry, or none that can be read, is drawn as its collision geometry.
    """
    seen, faults = visual_bodies(robot.source)
    judged = _collision_bodies(robot)
    chunks = [_chunk("visual", body) for body in seen or judged]
    chunks += [_chunk("collision", body, COLLISION_COLOR) for body in judged]
    chunks += cover_spheres(robot)
    return RobotBodies(
        chunks=tuple(chunks),
        links=tuple(dict.fromkeys(body.link for body in (*seen, *judged))),
        sketch=_sketch(judged),
        faults=faults,
    )


def highlighted(robot: RobotModel, links: Collection[str]) -> Iterator[Chunk]:
    """The collision geometry of some links once more, in red, as `/robot/at_fault/<body>`; just outside of the link."""
    for body in _collision_bodies(robot, links):
        assert isinstance(body.surface, Surface), "what is judged is a surface"
        yield _chunk("at_fault", replace(body, surface=body.surface.grown(OUTSIDE)), FAULT_COLOR)


def _collision_bodies(robot: RobotModel, links: Collection[str] | None = None) -> tuple[Body, ...]:
    """The shapes that are judged, in their links' frames; of some links only, if any are named."""
    bodies = []
    for index, shape in enumerate(robot.geometry.geometryObjects):
        link = robot.link_of_geometry(index)
        if links is not None and link not in links:
            continue
        in_link = robot.model.frames[robot.frame_id(link)].placement.inverse() * shape.placement
        bodies.append(Body(shape.name, link, surface.of_shape(shape.geometry).moved(in_link), pin.SE3.Identity()))
    return tuple(bodies)


def _sketch(judged: tuple[Body, ...]) -> tuple[tuple[str, Surface], ...]:
    """Hulls by link: of each body, or of all together where a link has many."""
    by_link: dict[str, list[Surface]] = {}
    for body in judged:
        if isinstance(body.surface, Surface):
            by_link.setdefault(body.link, []).append(body.surface)
    sketched = []
    for link, surfaces in by_link.items():
        whole = surfaces if len(surfaces) <= SKETCHED_APART else [surface.joined(surfaces)]
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
    """Rerun's mesh of a surface; `color` (RGBA) tints it as a whole."""
    return rr.Mesh3D(
        vertex_positions=drawn.vertices,
        triangle_indices=drawn.triangles,
        vertex_normals=drawn.normals,
        vertex_colors=drawn.colors,
        albedo_factor=color,
    )
