"""The field in a recording: charged points coloured by the force on them, forces on the links, a picture of a plane."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin
import rerun as rr
from PIL import Image
from rerun.chunk import Chunk

from guidefield.kernels.field.field import field_at_points
from guidefield.potential import RobotField
from guidefield.recorder.chunks import PICTURE, PICTURE_AT_START, entity, still, timed
from guidefield.recorder.robot_entities import moved_frame
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.spaces import Configurations
from guidefield.scene.field_slice import field_slice
from guidefield.scene.scene import Scene
from guidefield.scene.slice_plane import planes_along

MOMENTS, MOMENTS_AMONG_MOVING = 13, 7
"""Configurations at which forces are shown, of those at which the robot is; a scene each where obstacles move."""

LONGEST_ARROW = 0.25
"""Length of the arrow of the largest force of a recording [m]."""

FORCE_DECADES = 2.0
"""How many powers of ten of force the colours of points and the lengths of arrows tell apart."""

RESOLUTION, MAGNIFIED = 120, 3
"""Pixels along the longer side at which the field is known, and how many a picture has for each: it is smooth."""

QUALITY = 75
"""Of the picture's compression (JPEG, 0 to 100)."""

ARROW_COLOR = (255, 140, 60, 255)
POINT_RADIUS = 0.007

WEAK, STRONG = np.array([70.0, 110.0, 220.0]), np.array([255.0, 70.0, 50.0])
"""Colours of the weakest and the strongest force on a point (RGB)."""


def charges(
    group: PlanningGroup, scenes: Sequence[Scene], configurations: Configurations, times: rr.TimeColumn
) -> Iterator[Chunk]:
    """The robot's charged points in their links, coloured by the scene's force on them, and the force on each link.

    The scene's force on a point of weight w is -w grad Phi; arrows are what `RobotField` sums up for each link, its
    repulsion by other links included. Both are on a scale of `FORCE_DECADES` powers of ten below the largest.

    Args:
        group: The joints that were planned for.
        scenes: What is charged at each time, n of them.
        configurations: Shape (n, nq).
        times: Column of the n times.
    """
    field = RobotField(group, scenes[0])
    moving = field.charged[2] > 0
    points, weights, joints = (part[moving] for part in field.charged[:3])
    data, placed, wrenches = group.model.createData(), [], []
    for scene, q in zip(scenes, configurations, strict=True):
        field = field if scene is scenes[0] else RobotField(group, scene)
        pin.forwardKinematics(group.model, data, group.expand(q))
        placed.append(_placed(points, joints, data.oMi))
        wrenches.append(field.evaluate(q).wrenches[:, :3])
    world = np.array(placed)
    pulls = _gradients(scenes, world)
    strength = np.linalg.norm(pulls, axis=2) * weights
    colors = _colors(_share(strength))
    for joint in np.unique(joints):
        own = joints == joint
        path = entity("field", "charges", group.model.names[int(joint)])
        radii = rr.Points3D(points[own], radii=[POINT_RADIUS])
        yield still(path, rr.CoordinateFrame(moved_frame(group, int(joint))), radii)
        shown = rr.Points3D.columns(colors=colors[:, own].reshape(-1, 4)).partition([int(own.sum())] * len(world))
        yield timed(path, [times], shown)
    yield _arrows(np.array(wrenches), world, joints, times)


def picture_of_plane(scene: Scene, tip: np.ndarray) -> Iterator[Chunk]:
    """The field in the plane that fits the tip's way best: as a picture with the way on it, and at its place.

    Args:
        scene: What is charged; nothing is drawn of a scene without charge.
        tip: The tip's way, shape (n, 3) [m, world].
    """
    plane = planes_along(tip)[0]
    drawn = field_slice(scene, plane, RESOLUTION)
    if not np.isfinite(drawn.log_potential).any():
        return
    rows, columns = (MAGNIFIED * size for size in drawn.image.shape[:2])
    way = rr.LineStrips2D([plane.projected(tip, rows, columns)], colors=[(255, 255, 255, 255)], radii=[0.4 * MAGNIFIED])
    smooth = np.asarray(Image.fromarray(drawn.image).resize((columns, rows), Image.Resampling.BICUBIC))
    picture = rr.Image(smooth).compress(jpeg_quality=QUALITY)
    yield still(PICTURE_AT_START if scene.moves else PICTURE, picture, way)
    pane = rr.Mesh3D(
        vertex_positions=plane.corners,
        triangle_indices=[(0, 2, 1), (0, 3, 2)],
        vertex_texcoords=[(0, 0), (1, 0), (1, 1), (0, 1)],
        albedo_texture=np.ascontiguousarray(drawn.image[::2, ::2]),
    )
    yield still("/field/slice", pane)


def _gradients(scenes: Sequence[Scene], world: np.ndarray) -> np.ndarray:
    """Grad Phi of each scene at its points, both shape (n, points, 3)."""
    if all(scene is scenes[0] for scene in scenes):
        found = field_at_points(scenes[0].tables, world.reshape(-1, 3)).gradient
        return found.reshape(world.shape)
    return np.array([field_at_points(scene.tables, at).gradient for scene, at in zip(scenes, world, strict=True)])


def _placed(points: np.ndarray, joints: np.ndarray, placements: list[pin.SE3]) -> np.ndarray:
    """Points (n, 3) in the frames of their joints, in the world."""
    rotations = np.array([placement.rotation for placement in placements])[joints]
    translations = np.array([placement.translation for placement in placements])[joints]
    placed: np.ndarray = np.einsum("nij,nj->ni", rotations, points) + translations
    return placed


def _share(strength: np.ndarray) -> np.ndarray:
    """From 0 to 1 on a logarithmic scale of `FORCE_DECADES` below the largest."""
    largest = max(float(strength.max(initial=0.0)), 1e-30)
    share: np.ndarray = np.clip(1.0 + np.log10(np.maximum(strength, 1e-30) / largest) / FORCE_DECADES, 0.0, 1.0)
    return share


def _colors(share: np.ndarray) -> np.ndarray:
    """RGBA of shares of any shape, uint8."""
    rgb = WEAK + share[..., None] * (STRONG - WEAK)
    return np.concatenate([rgb, np.full((*share.shape, 1), 255.0)], axis=-1).round().astype(np.uint8)


def _arrows(forces: np.ndarray, world: np.ndarray, joints: np.ndarray, times: rr.TimeColumn) -> Chunk:
    """The force (n, njoints, 3) on what each joint moves, from the middle of its charged points (n, points, 3)."""
    moved = np.unique(joints)
    origins = np.stack([world[:, joints == joint].mean(axis=1) for joint in moved], axis=1)
    acting = forces[:, moved]
    sizes = np.linalg.norm(acting, axis=2, keepdims=True)
    vectors = LONGEST_ARROW * _share(sizes) * acting / np.maximum(sizes, 1e-30)
    columns = rr.Arrows3D.columns(
        origins=origins.reshape(-1, 3),
        vectors=vectors.reshape(-1, 3),
        colors=[ARROW_COLOR] * vectors[..., 0].size,
        radii=np.full(vectors[..., 0].size, 0.004),
    )
    return timed("/field/forces", [times], columns.partition([len(moved)] * len(forces)))
