"""The entities of a recording: obstacles and guide planes; the robot's links over time, its tip, ghosts and forces.

Stores share drawn scenes by a hash that includes this file (`stored.py`); `view.py` shows entities by their names.
Numbers and colours here change pictures, drawing time and file size (`LARGEST_RECORDING` of rendering.py) alone.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import rerun as rr
from rerun.chunk import Chunk

from guidefield.memo import memoized_by_value
from guidefield.messages import scene as messages
from guidefield.messages.replies import MotionReply
from guidefield.messages.requests import PlanRequest, PoseGoal
from guidefield.potential import RobotField, moving_charges, origin_of
from guidefield.recorder import bodies, surface
from guidefield.recorder.bodies import Drawn
from guidefield.recorder.chunks import (
    GHOST_ENTITY,
    PATH_TIME,
    PICTURE,
    PICTURE_AT_START,
    WORLD,
    Color,
    entity,
    joint_frame,
    link_frame,
    make_columns,
    path_times,
    rgba,
    rgba32,
    still,
    timed_chunk,
)
from guidefield.recorder.motion import Poses, ShownMotion, link_placements
from guidefield.recorder.surface import Surface
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.joints import Configurations
from guidefield.robot.model.model import frame_index
from guidefield.scene.field_slice import Origin, field_in_time, field_slice, planes_along
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene, build

GOLDEN_ANGLE = 0.381966
"""Share of the colour circle between one obstacle's hue and the next: never close to those before it."""
FAILURE_COLOR = (255, 220, 215, 255)
GOAL_COLOR = (120, 220, 160, 255)
FLOOR_COLOR = (118, 122, 130, 255)
PLANE_HUES = (0.52, 0.60)  # hues of the first and the last guide plane
PANE_ALPHA = 40  # opacity of guide planes, of 255
SEE_THROUGH_ALPHA = 70  # opacity of an obstacle that stands between the eye and the path, of 255


def obstacles(
    all_of_them: Sequence[Obstacle], see_through: Collection[str], at_fault: Collection[str]
) -> Iterator[Chunk]:
    """Draw obstacles as solid bodies: an entity for all primitives of a kind, one for all polygons, one for each other.

    Obstacles that move, are at fault (red) or hide the path from the first view (translucent) have entities of their
    own, `/obstacles/single/<name>`, too; clouds are drawn as points.
    """
    alike: dict[type, list[tuple[Obstacle, Color]]] = {}
    walls: list[tuple[Obstacle, Color]] = []
    for number, obstacle in enumerate(all_of_them):
        color = bodies.FAULT_COLOR if obstacle.name in at_fault else obstacle_color(obstacle, number)
        if {obstacle.name}.isdisjoint({*see_through, *at_fault}) and obstacle.motion is None:
            kind = next((kind for kind in PRIMITIVES if obstacle.placed and isinstance(obstacle.shape, kind)), None)
            if kind is not None:
                alike.setdefault(kind, []).append((obstacle, color))
                continue
            if isinstance(obstacle.message, messages.Polygon):
                walls.append((obstacle, color))
                continue
        if obstacle.cloud is not None:
            points = rr.Points3D(obstacle.cloud.points, radii=[obstacle.cloud.radius], colors=[color])
            yield still(single(obstacle.name), points)
            continue
        drawn = surface.shade(obstacle.vertices, obstacle.triangles)
        alpha = SEE_THROUGH_ALPHA if obstacle.name in see_through else color[3]
        yield still(single(obstacle.name), bodies.mesh(drawn, (*color[:3], alpha)))
    for kind, members in alike.items():
        path, batch = PRIMITIVES[kind]
        shapes, placements = [one.shape for one, _ in members], [pin.SE3ToXYZQUAT(one.placement) for one, _ in members]
        drawn_as = batch(shapes, np.array(placements))
        names = {"labels": [one.name for one, _ in members], "show_labels": False, "fill_mode": "solid"}
        yield still(f"/obstacles/{path}", drawn_as(colors=[color for _, color in members], **names))
    if walls:
        yield _walls(walls)


def _walls(members: Sequence[tuple[Obstacle, Color]]) -> Chunk:
    """Draw polygons as one mesh, lit from both sides, with their names in the order of its triangles."""
    parts = []
    for one, color in members:
        corners = one.vertices[one.triangles].reshape(-1, 3).astype(np.float32)
        spanned = np.cross(corners[1::3] - corners[::3], corners[2::3] - corners[::3])
        normals = np.repeat(spanned / np.linalg.norm(spanned, axis=1, keepdims=True), 3, axis=0).astype(np.float32)
        parts.append(
            Surface(corners, np.arange(len(corners), dtype=np.uint32).reshape(-1, 3), normals).with_color(color)
        )
    return still(
        "/obstacles/walls", bodies.mesh(surface.join(parts)), rr.AnyValues(names=[one.name for one, _ in members])
    )


def single(name: str) -> str:
    """Return the entity of an obstacle that has its own."""
    return entity("obstacles", "single", name)


def moving(all_of_them: Sequence[Obstacle], times: np.ndarray) -> Iterator[Chunk]:
    """Draw moving obstacles, relative to where they are drawn at first, at times (n,) [s] of the trajectory."""
    for one in all_of_them:
        if one.motion is None:
            continue
        moved = [pin.SE3ToXYZQUAT(one.placement_at(time) * one.placement.inverse()) for time in times.tolist()]
        columns = make_columns(rr.Transform3D, translation=np.array(moved)[:, :3], quaternion=np.array(moved)[:, 3:])
        yield timed_chunk(single(one.name), [path_times(times)], columns)


def obstacle_color(obstacle: Obstacle, number: int) -> Color:
    """Return the colour of a scene's obstacle by its number (RGBA): muted, and unlike its neighbours'."""
    if isinstance(obstacle.message, messages.HalfSpace):
        return FLOOR_COLOR
    lightness, saturation = (0.60, 0.30) if number % 2 else (0.70, 0.28)
    return rgba((0.08 + GOLDEN_ANGLE * number) % 1.0, lightness, saturation, 255)


def guide_planes(planes: Sequence[messages.GuidePlane], size: float) -> Iterator[Chunk]:
    """Draw guide planes as translucent panes with outlines and names, all of them one entity."""
    if not planes:
        return
    shares = np.linspace(0.0, 1.0, len(planes)) if len(planes) > 1 else [0.0]
    hues = [PLANE_HUES[0] + share * (PLANE_HUES[1] - PLANE_HUES[0]) for share in shares]
    corners = [np.array(plane.vertices, float) for plane in planes]
    counts = [len(one) for one in corners]
    firsts = np.cumsum([0, *counts[:-1]])
    fans = [first + np.array([[0, i, i + 1] for i in range(1, n - 1)]) for first, n in zip(firsts, counts, strict=True)]
    pane = rr.Mesh3D(
        vertex_positions=np.concatenate(corners),
        triangle_indices=np.concatenate(fans),
        vertex_colors=[
            rgba(hue, 0.55, 0.9, 255) for hue, count in zip(hues, counts, strict=True) for _ in range(count)
        ],
        albedo_factor=(255, 255, 255, PANE_ALPHA),
    )
    outlines = [np.vstack([one, one[:1]]) for one in corners]
    edges = rr.LineStrips3D(outlines, colors=[rgba(hue, 0.6, 0.95, 255) for hue in hues], radii=[0.0025 * size])
    # not always the same corner: planes often stand close behind one another
    named = [one[number % len(one)] for number, one in enumerate(corners)]
    labels = rr.Points3D(
        named,
        labels=[plane.name for plane in planes],
        colors=[rgba(hue, 0.78, 0.95, 255) for hue in hues],
        show_labels=True,
    )
    yield still("/guide_planes", pane, edges, labels)


def goals(request: PlanRequest, size: float) -> Iterator[Chunk]:
    """Draw the poses that the tip is to reach, if goals are poses: their axes and their names."""
    named = [("goal", request.goal), *((f"steps[{index}]", step.goal) for index, step in enumerate(request.steps))]
    for name, goal in named:
        if isinstance(goal, PoseGoal):
            yield _goal(name, goal, size)


def _goal(called: str, pose: PoseGoal, size: float) -> Chunk:
    at = rr.Transform3D(translation=pose.position, quaternion=rr.Quaternion(xyzw=pose.quaternion_xyzw))
    name = rr.Points3D([[0.0, 0.0, 0.0]], labels=[called], colors=[GOAL_COLOR], radii=[0.008 * size], show_labels=True)
    path = "/path/goal" if called == "goal" else entity("path", "goals", called)
    return still(path, at, rr.TransformAxes3D(0.1 * size), name)


def failure(reply: MotionReply, tip: np.ndarray, size: float) -> Chunk:
    """Draw the place of a failure: a mark at the tip (3,) [m, world], and its reason in a few words."""
    pair = reply.status.details.get("pair")
    between = f": {pair[0]} - {pair[1]}" if isinstance(pair, list | tuple) and len(pair) == 2 else ""
    words = f"{reply.status.name.replace('_', ' ').lower()}{between}"
    mark = rr.Points3D([tip], labels=[words], colors=[FAILURE_COLOR], radii=[0.015 * size], show_labels=True)
    return still("/path/failure", mark)


def _boxes(shapes: list[Any], at: np.ndarray) -> Callable[..., Any]:
    sizes = np.array([shape.halfSide for shape in shapes])
    return functools.partial(rr.Boxes3D, half_sizes=sizes, centers=at[:, :3], quaternions=at[:, 3:])


def _balls(shapes: list[Any], at: np.ndarray) -> Callable[..., Any]:
    return functools.partial(rr.Ellipsoids3D, radii=[shape.radius for shape in shapes], centers=at[:, :3])


def _cylinders(shapes: list[Any], at: np.ndarray) -> Callable[..., Any]:
    lengths, radii = [2.0 * shape.halfLength for shape in shapes], [shape.radius for shape in shapes]
    return functools.partial(rr.Cylinders3D, lengths=lengths, radii=radii, centers=at[:, :3], quaternions=at[:, 3:])


PRIMITIVES: dict[type, tuple[str, Callable[[list[Any], np.ndarray], Callable[..., Any]]]] = {
    coal.Box: ("boxes", _boxes),
    coal.Sphere: ("balls", _balls),
    coal.Cylinder: ("cylinders", _cylinders),
}
"""Name of the entity and the function that draws it, by Coal shape; placements are rows of position and quaternion."""


MOMENTS = 13  # configurations at which forces are shown, of those at which the robot is shown; at least 1
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
        yield timed_chunk(in_its_frame.entity_path, [column], shown)
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
    return timed_chunk("/field/forces", [column], columns)


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
    return timed_chunk("/robot/model/frames", [column], columns)


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
