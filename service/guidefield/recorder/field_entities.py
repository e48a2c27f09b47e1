"""The field in a recording: charged points coloured by the force on them, forces on the links, a picture of a plane."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.messages import scene as messages
from guidefield.potential import RobotField, moving_charges, origin_of
from guidefield.recorder.chunks import PICTURE, PICTURE_AT_START, entity, rgba32, still, timed
from guidefield.recorder.robot_entities import moved_frame
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.spaces import Configurations
from guidefield.scene.field_in_time import Origin, field_in_time
from guidefield.scene.field_slice import field_slice, planes_along
from guidefield.scene.scene import Scene, build

MOMENTS = 13
"""Configurations at which forces are shown, of those at which the robot is shown."""
LONGEST_ARROW = 0.25
"""Length of the arrow of the largest force of a recording, at size 1 [m]."""
FORCE_DECADES = 2.0
"""Powers of ten of force that the colours of points and the lengths of arrows tell apart."""
RESOLUTION = 80
"""Pixels along the longer side of the picture."""
EVALUATED_EVERY = 3
"""Of the pixels of a row and of a column one in so many has its field evaluated where no wall is near."""
NOTHING = build(messages.Scene(name="nothing"))
ARROW_COLOR = (255, 140, 60, 255)
POINT_RADIUS = 0.007

WEAK, STRONG = np.array([70.0, 110.0, 220.0]), np.array([255.0, 70.0, 50.0])
"""Colours of the weakest and the strongest force on a point (RGB)."""


def charges(
    group: PlanningGroup, scene: Scene, times: np.ndarray | None, configurations: Configurations, column: rr.TimeColumn
) -> Iterator[Chunk]:
    """The robot's charged points in their links, coloured by the scene's force on them, and the force on each link.

    The scene's force on a point of weight w is -w grad Phi; arrows are its sum over each link and the repulsion by
    other links. Both are on a scale of `FORCE_DECADES` powers of ten below the largest.

    Args:
        group: The joints that were planned for.
        scene: What is charged.
        times: When the robot is there, shape (n,) [s]; None: all obstacles are where they are at first.
        configurations: Shape (n, nq).
        column: Column of n times, as they are shown.
    """
    charged = moving_charges(group)
    points, joints = charged.place_points(configurations), charged.joints
    forces = -charged.weights[:, None] * field_in_time(scene, points, times, origin_of(group))[1]
    colors = _colors(_share(np.linalg.norm(forces, axis=2)))
    moved = np.unique(joints)
    for joint, in_its_frame in zip(moved, _points_of_joints(group), strict=True):
        yield in_its_frame
        own = joints == joint
        shown = rr.Points3D.columns(colors=colors[:, own].ravel()).partition([int(own.sum())] * len(points))
        yield timed(in_its_frame.entity_path, [column], shown)
    of_links = RobotField(group, NOTHING)
    on_links = np.array([of_links.evaluate(q).wrenches[:, :3] for q in configurations])[:, moved]
    on_links += np.stack([forces[:, joints == joint].sum(axis=1) for joint in moved], axis=1)
    origins = np.stack([points[:, joints == joint].mean(axis=1) for joint in moved], axis=1)
    yield _arrows(on_links, origins, column, group.size)


@memoized_for_alike
def _points_of_joints(group: PlanningGroup) -> list[Chunk]:
    """The charged points of each joint that has some, in its frame."""
    charged, chunks = moving_charges(group), []
    for joint in np.unique(charged.joints).tolist():
        points = rr.Points3D(charged.points[charged.joints == joint], radii=[POINT_RADIUS * group.size])
        path = entity("field", "charges", group.model.names[joint])
        chunks.append(still(path, rr.CoordinateFrame(moved_frame(group, joint)), points))
    return chunks


def picture_of_plane(scene: Scene, tip: np.ndarray, origin: Origin) -> Iterator[Chunk]:
    """The field in the plane that fits the tip's way best: as a picture with the way on it, and at its place.

    Args:
        scene: What is charged; nothing is drawn of a scene without charge.
        tip: The tip's way, shape (n, 3) [m, world].
        origin: A place near it for which the field's tables are kept [m, world].
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
    """From 0 to 1 on a logarithmic scale of `FORCE_DECADES` below the largest."""
    largest = max(float(strength.max(initial=0.0)), 1e-30)
    share: np.ndarray = np.clip(1.0 + np.log10(np.maximum(strength, 1e-30) / largest) / FORCE_DECADES, 0.0, 1.0)
    return share


def _colors(share: np.ndarray) -> np.ndarray:
    """Colours of shares of any shape, as Rerun packs them."""
    red, green, blue = (
        np.round(weak + share * (strong - weak)).astype(np.uint32) for weak, strong in zip(WEAK, STRONG, strict=True)
    )
    packed: np.ndarray = red << 24 | green << 16 | blue << 8 | np.uint32(255)
    return packed


def _arrows(forces: np.ndarray, origins: np.ndarray, column: rr.TimeColumn, robot_size: float) -> Chunk:
    """Forces (n, k, 3) as arrows from their origins (n, k, 3) [m, world], at n times."""
    sizes = np.linalg.norm(forces, axis=2, keepdims=True)
    vectors = robot_size * LONGEST_ARROW * _share(sizes) * forces / np.maximum(sizes, 1e-30)
    columns = rr.Arrows3D.columns(
        origins=origins.reshape(-1, 3),
        vectors=vectors.reshape(-1, 3),
        colors=np.full(sizes.size, rgba32(ARROW_COLOR)),
        radii=np.full(sizes.size, 0.004 * robot_size),
    )
    return timed("/field/forces", [column], columns.partition([forces.shape[1]] * len(forces)))
