"""Draw the robot in a recording: its links over time, its tip, ghosts, and the field's forces on it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin
import rerun as rr
from rerun.chunk import Chunk

from guidefield.memo import memoized_by_value
from guidefield.messages import scene as messages
from guidefield.potential import RobotField, moving_charges, origin_of
from guidefield.recorder import bodies, surface
from guidefield.recorder.bodies import Drawn
from guidefield.recorder.chunks import (
    GHOST_ENTITY,
    PATH_TIME,
    PICTURE,
    PICTURE_AT_START,
    WORLD,
    entity,
    joint_frame,
    link_frame,
    make_columns,
    path_times,
    rgba32,
    still,
    timed,
)
from guidefield.recorder.motion import Poses, ShownMotion, link_placements
from guidefield.recorder.surface import Surface
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.model import frame_index
from guidefield.robot.model.spaces import Configurations
from guidefield.scene.field_slice import Origin, field_in_time, field_slice, planes_along
from guidefield.scene.scene import Scene, build

MOMENTS = 13  # configurations at which forces are shown, of those at which the robot is shown
LONGEST_ARROW = 0.25  # length of the arrow of the largest force of a recording, at size 1 [m]
FORCE_DECADES = 2.0  # powers of ten of force that the colours of points and the lengths of arrows tell apart
RESOLUTION = 80  # pixels along the longer side of the picture
EVALUATED_EVERY = 3  # distance of the pixels at which the field is evaluated where no wall is near [pixels]
EMPTY_SCENE = build(messages.Scene(name="nothing"))  # of which a robot's field is only that of its links
ARROW_COLOR = (255, 140, 60, 255)
POINT_RADIUS = 0.007  # radius of a charged point, at size 1 [m]

WEAK, STRONG = np.array([70.0, 110.0, 220.0]), np.array([255.0, 70.0, 50.0])
"""Colours of the weakest and the strongest force on a point (RGB)."""


def charges(
    group: PlanningGroup, scene: Scene, times: np.ndarray | None, configurations: Configurations, column: rr.TimeColumn
) -> Iterator[Chunk]:
    """Draw the robot's charged points in their links, coloured by the scene's force on them, and each link's force.

    The scene's force on a point of weight w is -w grad Phi; arrows are its sum over each link and the repulsion by
    other links. Both are on a scale of `FORCE_DECADES` powers of ten below the largest. Configurations (n, nq) are at
    times (n,) [s], shown at a column of n times; without times all obstacles are where they are at first.
    """
    charged = moving_charges(group)
    points, joints = charged.place_points(configurations), charged.joints
    forces = -charged.weights[:, None] * field_in_time(scene, points, times, origin_of(group))[1]
    colors = _colors(_share(np.linalg.norm(forces, axis=2)))
    moved = np.unique(joints)
    for joint, in_its_frame in zip(moved, _points_of_joints(group), strict=True):
        yield in_its_frame
        own = joints == joint
        shown = make_columns(rr.Points3D, np.full(len(points), own.sum()), colors=colors[:, own].ravel())
        yield timed(in_its_frame.entity_path, [column], shown)
    of_links = RobotField(group, EMPTY_SCENE)
    on_links = np.array([of_links.evaluate(q).wrenches[:, :3] for q in configurations])[:, moved]
    on_links += np.stack([forces[:, joints == joint].sum(axis=1) for joint in moved], axis=1)
    origins = np.stack([points[:, joints == joint].mean(axis=1) for joint in moved], axis=1)
    yield _arrows(on_links, origins, column, group.size)


@memoized_for_alike
def _points_of_joints(group: PlanningGroup) -> list[Chunk]:
    charged, chunks = moving_charges(group), []
    for joint in np.unique(charged.joints).tolist():
        points = rr.Points3D(charged.points[charged.joints == joint], radii=[POINT_RADIUS * group.size])
        path = entity("field", "charges", group.model.names[joint])
        chunks.append(still(path, rr.CoordinateFrame(moved_frame(group, joint)), points))
    return chunks


def picture_of_plane(scene: Scene, tip: np.ndarray, origin: Origin) -> Iterator[Chunk]:
    """Draw the field in the plane that fits the tip's path (n, 3) best: as a picture with the path, and in the scene.

    Nothing is drawn of a scene without charge. The field's single-precision tables are those about the origin.
    """
    plane = planes_along(tip)[0]
    drawn = field_slice(scene, plane, RESOLUTION, origin, EVALUATED_EVERY)
    if not np.isfinite(drawn.log_potential).any():
        return
    rows, columns = drawn.image.shape[:2]
    way = rr.LineStrips2D([plane.projected(tip, rows, columns)], colors=[(255, 255, 255, 255)], radii=[0.4])
    picture = rr.Image(drawn.image, magnification_filter=rr.components.MagnificationFilter.Bicubic)
    yield still(PICTURE_AT_START if scene.moves else PICTURE, picture, way)
    pane = rr.Mesh3D(
        vertex_positions=plane.corners,
        triangle_indices=[(0, 2, 1), (0, 3, 2)],
        vertex_texcoords=[(0, 0), (1, 0), (1, 1), (0, 1)],
        albedo_texture=np.ascontiguousarray(drawn.image[::2, ::2]),
    )
    yield still("/field/slice", pane)


def _share(strength: np.ndarray) -> np.ndarray:
    """Map strengths to 0 to 1 on a logarithmic scale of `FORCE_DECADES` below the largest."""
    largest = max(float(strength.max(initial=0.0)), 1e-30)
    share: np.ndarray = np.clip(1.0 + np.log10(np.maximum(strength, 1e-30) / largest) / FORCE_DECADES, 0.0, 1.0)
    return share


def _colors(share: np.ndarray) -> np.ndarray:
    red, green, blue = (
        np.round(weak + share * (strong - weak)).astype(np.uint32) for weak, strong in zip(WEAK, STRONG, strict=True)
    )
    packed: np.ndarray = red << 24 | green << 16 | blue << 8 | np.uint32(255)
    return packed


def _arrows(forces: np.ndarray, origins: np.ndarray, column: rr.TimeColumn, robot_size: float) -> Chunk:
    """Draw forces (n, k, 3) as arrows from their origins (n, k, 3) [m, world], at n times."""
    sizes = np.linalg.norm(forces, axis=2, keepdims=True)
    vectors = robot_size * LONGEST_ARROW * _share(sizes) * forces / np.maximum(sizes, 1e-30)
    columns = make_columns(
        rr.Arrows3D,
        np.full(len(forces), forces.shape[1]),
        origins=origins.reshape(-1, 3),
        vectors=vectors.reshape(-1, 3),
        colors=np.full(sizes.size, rgba32(ARROW_COLOR)),
        radii=np.full(sizes.size, 0.004 * robot_size),
    )
    return timed("/field/forces", [column], columns)


GHOSTS = 6  # configurations shown along the motion, both ends included
GHOST_STEP = 0.02  # distance that some point of a part has to move before the part is drawn again, at size 1 [m]
AXES = 0.08  # length of the axes of the tip's frame, at size 1 [m]


def tip_axes(group: PlanningGroup) -> Chunk:
    """Draw the axes of the tip's frame."""
    return _axes_of(group.tip, AXES * group.size)


@memoized_by_value(64)
def _axes_of(link: str, length: float) -> Chunk:
    return still("/robot/tip", rr.CoordinateFrame(link_frame(link)), rr.TransformAxes3D(length))


def link_motion(group: PlanningGroup, links: Sequence[str], at: Poses, times: np.ndarray, timeline: str) -> Chunk:
    """Draw the frames of links and of the tip: one entity with those that joints move, and those fixed to them.

    Times (n,) rise; they are seconds on `PATH_TIME`, or the planner's steps on `STEP`.
    """
    names, parents, fixed = _fixed_frames(group, tuple(dict.fromkeys((*links, group.tip))))
    moved = [joint_frame(group.model.names[joint]) for joint in at.joints]
    placements = np.concatenate([fixed, at.placements.reshape(-1, 7)])
    columns = make_columns(
        rr.Transform3D,
        translation=placements[:, :3],
        quaternion=placements[:, 3:],
        child_frame=[*names, *moved * len(times)],
        parent_frame=[*parents, *[WORLD] * (len(moved) * len(times))],
    )
    each = np.concatenate([np.repeat(times[:1], len(fixed)), np.repeat(times, len(moved))])
    column = path_times(each) if timeline == PATH_TIME else rr.TimeColumn(timeline, sequence=each)
    return timed("/robot/model/frames", [column], columns)


@memoized_for_alike
def _fixed_frames(group: PlanningGroup, links: tuple[str, ...]) -> tuple[list[str], list[str], np.ndarray]:
    """Return the names of links' frames and of those that they are fixed to, and placements there, (links, 7)."""
    frames = [group.model.frames[frame_index(group.model, link)] for link in links]
    fixed = np.array([pin.SE3ToXYZQUAT(frame.placement) for frame in frames]).reshape(-1, 7)
    return [link_frame(link) for link in links], [moved_frame(group, frame.parentJoint) for frame in frames], fixed


def ghosts(group: PlanningGroup, drawn: Drawn, motion: ShownMotion) -> Chunk | None:
    """Draw sketches of the robot evenly along its path in joint space, bright at first, dark at the end; None without.

    A part that has hardly moved since it was last drawn isn't drawn again: it would only flicker.
    """
    chosen = spread_along(motion.configurations, GHOSTS)
    placed = link_placements(group, motion.configurations[chosen], drawn.links).astype(np.float32)
    greys = np.linspace(240.0, 25.0, len(chosen)).round().astype(np.uint8)
    parts = []
    for link, sketch in drawn.sketch:
        there = placed[:, drawn.links.index(link)]
        vertices = sketch.vertices @ there[:, :, :3].swapaxes(1, 2) + there[:, None, :, 3]
        shown = [0]
        for number in range(1, len(chosen)):
            if np.abs(vertices[number] - vertices[shown[-1]]).max() > GHOST_STEP * group.size:
                shown.append(number)
        for number in shown:
            colors = np.full((len(sketch.vertices), 4), greys[number])
            colors[:, 3] = 255
            normals = sketch.normals @ there[number, :, :3].T
            parts.append(Surface(vertices[number], sketch.triangles, normals, colors))
    return still(GHOST_ENTITY, bodies.mesh(surface.join(parts))) if parts else None


def extent(group: PlanningGroup, drawn: Drawn, configurations: Configurations) -> np.ndarray:
    """Return corners (m, 3) [m, world] of the boxes about the links that move, at configurations (n, nq)."""
    placed = link_placements(group, configurations, drawn.links)
    corners = [np.empty((0, 3))]
    for link, sketch in drawn.sketch:
        if group.model.frames[frame_index(group.model, link)].parentJoint:
            there = placed[:, drawn.links.index(link)]
            vertices = sketch.vertices @ there[:, :, :3].swapaxes(1, 2) + there[:, None, :, 3]
            corners += [vertices.min(axis=1), vertices.max(axis=1)]
    return np.concatenate(corners)


def spread_along(configurations: Configurations, count: int) -> list[int]:
    """Return rows of configurations (n, nq), first and last included, about evenly spaced along the path."""
    steps = np.linalg.norm(np.diff(configurations, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    if arc[-1] == 0.0:
        return [0]
    return sorted({int(np.argmin(np.abs(arc - at))) for at in np.linspace(0.0, arc[-1], count)})


def moved_frame(group: PlanningGroup, joint: int) -> str:
    """Return the name of the frame that a joint moves, by Pinocchio's index; 0 is the world's."""
    return joint_frame(group.model.names[joint]) if joint else WORLD
