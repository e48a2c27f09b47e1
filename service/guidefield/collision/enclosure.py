"""Enclosure: a body wholly inside a closed mesh touches nothing, because Coal judges such a mesh as a surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.geometry.closed import connected_pieces
from guidefield.kept import kept_with
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.shapes import triangulation
from guidefield.robot.model.spaces import ModelConfiguration
from guidefield.scene.mesh import mesh_surface
from guidefield.scene.scene import Scene


def enclosed(world: World, q: ModelConfiguration) -> tuple[str, str] | None:
    """Names of the first pair of bodies, one wholly inside the other's closed mesh, or None.

    Without contact a connected body is inside with all of its points or with none, so one point of each connected piece
    tells. A body that touches may be reported too: it is partly inside.
    A motion without contact can't change the answer: it is asked for once, at the start.

    Args:
        world: The robot among obstacles.
        q: Configuration of the group's model, shape (model.nq,).
    """
    could = _enclosable(world)
    if not (len(could.pairs) or could.about_clouds):
        return None
    pin.forwardKinematics(world.model, world.data, q)
    for pair, outer, solid, points in could.about_clouds:
        if _around_a_point(world, outer, solid, points):
            return world.pair_names(pair)
    if not len(could.pairs):
        return None
    joints = np.array([world.data.oMi[joint].homogeneous[:3] for joint in could.joints])
    placed = joints[could.joint_of] @ could.placements
    points = np.einsum("kij,kj->ki", placed[could.inner, :, :3], could.points) + placed[could.inner, :, 3]
    local = np.einsum("kji,kj->ki", placed[could.outer, :, :3], points - placed[could.outer, :, 3])
    within = ((local > could.boxes[:, 0]) & (local < could.boxes[:, 1])).all(axis=1)
    for row in np.flatnonzero(within).tolist():
        if abs(winding_number(local[row], could.surfaces[row])) > 0.5:
            return world.pair_names(int(could.pairs[row]))
    return None


def _around_a_point(world: World, outer: int, solid: _Solid, points: np.ndarray) -> bool:
    """Whether a robot body where the world's data stand is around one of some points (n, 3) [m, world]."""
    assert solid.surface is not None, "only closed meshes are asked for"
    joint, placement = _on_joint(world, outer)
    there = world.data.oMi[joint] * placement
    low, high = solid.box
    middle, reach, near = there.act(0.5 * (low + high)), 0.5 * float(np.linalg.norm(high - low)), points
    for axis in range(3):  # one after another: few are left after the first
        near = near[np.abs(near[:, axis] - middle[axis]) < reach]
    local = (near - there.translation) @ there.rotation
    within = local[((local > low) & (local < high)).all(axis=1)]
    return any(abs(winding_number(point, solid.surface)) > 0.5 for point in within)


def winding_number(point: np.ndarray, corners: np.ndarray) -> float:
    """How often a surface winds around a point: whole numbers for a closed one, 0 outside.

    The sum of the triangles' solid angles over 4 pi (A. van Oosterom and J. Strackee, IEEE Trans. Biomedical
    Engineering 30(2), 1983).

    Args:
        point: Shape (3,) [m], in the surface's frame.
        corners: Triangles in the same frame, shape (t, 3, 3) [m].
    """
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(arm, axis=1) for arm in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = [np.einsum("ij,ij->i", *arms) for arms in ((a, b), (b, c), (c, a))]
    solid_angles = 2.0 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb)
    return float(solid_angles.sum() / (4.0 * np.pi))


_NOWHERE = np.array([np.full(3, np.inf), np.full(3, -np.inf)])


@dataclass(frozen=True, eq=False)
class _Solid:
    """What tells whether a body is inside another, in the body's own frame [m].

    Attributes:
        surface: Triangles (t, 3, 3) of a closed mesh that is judged as a surface; None for all others.
        box: Lower and upper corner about them, shape (2, 3).
        points: A point of each connected piece, shape (n, 3); of a half-space none, because nothing encloses it.
    """

    surface: np.ndarray | None
    box: np.ndarray
    points: np.ndarray


@dataclass(frozen=True, eq=False)
class _Enclosable:
    """Points of bodies that could be inside others, a row for each.

    Attributes:
        joints: Joints of the model that they are on, shape (j,).
        joint_of, placements: Of each body that is meant, which of `joints`, shape (b,), and where on it, (b, 4, 4) [m].
        pairs: Of each row, which of the world's pairs it is about, shape (n,).
        outer, inner: Which body could be around which, shape (n,).
        points: A point of the inner one, in its frame, shape (n, 3) [m].
        boxes: Corners about the outer one, in its frame, shape (n, 2, 3) [m].
        surfaces: Its triangles, each (t, 3, 3) [m].
        about_clouds: Pairs of such a robot body and a cloud: pair, body, its solid, points (p, 3) [m, world].
    """

    joints: list[int]
    joint_of: np.ndarray
    placements: np.ndarray
    pairs: np.ndarray
    outer: np.ndarray
    inner: np.ndarray
    points: np.ndarray
    boxes: np.ndarray
    surfaces: list[np.ndarray]
    about_clouds: list[tuple[int, int, _Solid, np.ndarray]]


@kept_with
def _enclosable(world: World) -> _Enclosable:
    solids = _solids(world)
    surfaced = np.array([solid.surface is not None for solid in solids])
    could = np.flatnonzero(surfaced[world.pairs].any(axis=1))
    rows = [
        (pair, outer, inner, point)
        for pair, (first, second) in zip(could.tolist(), world.pairs[could].tolist(), strict=True)
        for outer, inner in ((first, second), (second, first))
        if solids[outer].surface is not None
        for point in solids[inner].points
    ]
    clouds = [None] * world.group.geometry.ngeoms + [obstacle.cloud for obstacle in world.scene.obstacles]
    about_clouds = [
        (pair, first, solids[first], cloud.points)
        for pair, (first, second) in zip(could.tolist(), world.pairs[could].tolist(), strict=True)
        if (cloud := clouds[second]) is not None
    ]
    ends = np.array([row[1:3] for row in rows], int).reshape(-1, 2)
    bodies, places = np.unique(ends, return_inverse=True)
    outer, inner = places.reshape(-1, 2).T
    on_joints = [_on_joint(world, body) for body in bodies.tolist()]
    joints, joint_of = np.unique([joint for joint, _ in on_joints], return_inverse=True)
    return _Enclosable(
        joints=joints.astype(int).tolist(),
        joint_of=joint_of,
        placements=np.array([placement.homogeneous for _, placement in on_joints]).reshape(-1, 4, 4),
        pairs=np.array([row[0] for row in rows], int),
        outer=outer,
        inner=inner,
        points=np.array([row[3] for row in rows]).reshape(-1, 3),
        boxes=np.array([solids[row[1]].box for row in rows]).reshape(-1, 2, 3),
        surfaces=[surface for row in rows if (surface := solids[row[1]].surface) is not None],
        about_clouds=about_clouds,
    )


def _on_joint(world: World, body: int) -> tuple[int, Any]:
    """The joint of the model that a body is on, 0 for the world, and its placement there (pinocchio.SE3)."""
    links = world.group.geometry.geometryObjects
    if body < len(links):
        return links[body].parentJoint, links[body].placement
    return 0, world.scene.obstacles[body - len(links)].placement


def _solids(world: World) -> Sequence[_Solid]:
    """Of each body of a world."""
    group, of_links = world.group, _of_links(world.group.robot)
    index_of = {shape.name: index for index, shape in enumerate(group.robot.geometry.geometryObjects)}
    return [
        *(of_links[index_of[shape.name]] for shape in group.geometry.geometryObjects),
        *_of_obstacles(world.scene),
    ]


@kept_with
def _of_links(robot: RobotModel) -> tuple[_Solid, ...]:
    return tuple(_solid(shape.geometry) for shape in robot.geometry.geometryObjects)


@kept_with
def _of_obstacles(scene: Scene) -> tuple[_Solid, ...]:
    return tuple(_NOTHING if obstacle.cloud is not None else _solid(obstacle.shape) for obstacle in scene.obstacles)


_NOTHING = _Solid(None, _NOWHERE, np.empty((0, 3)))


def _solid(shape: Any) -> _Solid:
    if isinstance(shape, coal.Halfspace):
        return _NOTHING
    if isinstance(shape, coal.Convex):
        return _Solid(None, _NOWHERE, np.mean(shape.points(), axis=0, keepdims=True))
    if not isinstance(shape, coal.BVHModelBase):
        return _Solid(None, _NOWHERE, np.zeros((1, 3)))
    mesh = mesh_surface(*triangulation(shape))
    if mesh is None:
        return _NOTHING
    first_of_each = np.unique(connected_pieces(len(mesh.vertices), mesh.triangles))
    if not mesh.solid:
        return _Solid(None, _NOWHERE, mesh.vertices[first_of_each])
    corners = mesh.vertices[mesh.triangles]
    return _Solid(corners, np.array([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))]), mesh.vertices[first_of_each])
