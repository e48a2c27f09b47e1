"""Balls about the robot's bodies, boxes about obstacles: their distance at least, and which joints move what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from guidefield.robot.chart import TRANSLATION
from guidefield.robot.group import PlanningGroup
from guidefield.scene.obstacle import Obstacle


def joint_placements(data: Any) -> np.ndarray:
    """Placements (njoints, 4, 4) of all joints in the world, at the configuration that Pinocchio's data stands at."""
    return np.array([placement.homogeneous for placement in data.oMi])


@dataclass(frozen=True, eq=False)
class Bodies:
    """What is known about bodies before any configuration is.

    Robot bodies come first, in the order of the group's geometry, then obstacles. Columns j are those of the velocity
    of the group's `model`, followers included.

    Attributes:
        joints: Joint that carries each robot body, shape (r,); 0 is the world.
        centres: Centres of the balls about robot bodies, in the frame of that joint, shape (r, 3) [m].
        radii: Their radii, shape (r,) [m].
        moved_by: Whether joint j moves a robot body, shape (r, nv).
        turns: Whether joint j turns (revolute, continuous) rather than slides, shape (nv,).
        box_axes: Axes of the boxes about obstacles in the world, shape (3, 3 o), three columns each.
        box_centres: Their centres along those axes, shape (3 o,) [m].
        box_halves: Their half extents along those axes, shape (3 o,) [m]; infinite for a half-space.
    """

    joints: np.ndarray
    centres: np.ndarray
    radii: np.ndarray
    moved_by: np.ndarray
    turns: np.ndarray
    box_axes: np.ndarray
    box_centres: np.ndarray
    box_halves: np.ndarray

    def centres_in_world(self, joint_placements: np.ndarray) -> np.ndarray:
        """Centres of the balls in the world.

        Args:
            joint_placements: ``T_world_joint`` of every joint of the model, shape (..., njoints, 4, 4) [m].

        Returns:
            Shape (..., r, 3) [m, world].
        """
        carriers = joint_placements[..., self.joints, :3, :]
        centres: np.ndarray = (carriers[..., :3] @ self.centres[:, :, None])[..., 0] + carriers[..., 3]
        return centres

    def separations(self, centres: np.ndarray, pairs: np.ndarray, self_pairs: int) -> np.ndarray:
        """Lower bounds (n,) of the signed distances of pairs of bodies [m].

        A ball that overlaps another, or a box from outside, bounds the depth too; a centre inside a box bounds nothing:
        minus infinity.

        Args:
            centres: Centres of the balls, shape (r, 3) [m, world].
            pairs: Pairs of bodies, shape (n, 2): the robot's own first, then robot body and obstacle.
            self_pairs: How many are the robot's own.
        """
        first, second = pairs.T
        a, b = first[:self_pairs], second[:self_pairs]
        own = np.linalg.norm(centres[a] - centres[b], axis=1) - self.radii[a] - self.radii[b]
        outside = np.maximum(np.abs(centres @ self.box_axes - self.box_centres) - self.box_halves, 0.0)
        outside = outside.reshape(len(centres), -1, 3)
        gaps = np.sqrt(np.einsum("boi,boi->bo", outside, outside))
        bounds = np.where(gaps > 0.0, gaps - self.radii[:, None], -np.inf)
        return np.concatenate([own, bounds[first[self_pairs:], second[self_pairs:] - len(centres)]])


def bodies(group: PlanningGroup, obstacles: tuple[Obstacle, ...]) -> Bodies:
    """Measure the bodies of a robot and of obstacles, once."""
    model, shapes = group.model, list(group.geometry.geometryObjects)
    balls = [bounding_ball(shape.geometry) for shape in shapes]
    boxes = [_box(obstacle) for obstacle in obstacles]
    joints = np.array([shape.parentJoint for shape in shapes], int)
    moved_by = np.zeros((len(shapes), model.nv), bool)
    turns = np.zeros(model.nv, bool)
    for index in range(1, model.njoints):
        columns = slice(model.joints[index].idx_v, model.joints[index].idx_v + model.joints[index].nv)
        joint = group.robot.joint(model.names[index])
        assert joint is not None, "a group's joints are the robot's"
        turns[columns] = True
        if joint.kind in TRANSLATION:
            turns[columns][TRANSLATION[joint.kind]] = False
        moved_by[:, columns] = np.array([index in model.supports[carrier] for carrier in joints.tolist()])[:, None]
    arrays = {
        "joints": joints,
        "centres": np.array([shape.placement.act(ball[0]) for shape, ball in zip(shapes, balls, strict=True)]),
        "radii": np.array([radius for _, radius in balls]),
        "moved_by": moved_by,
        "turns": turns,
        "box_axes": np.hstack([np.empty((3, 0)), *(axes for axes, _, _ in boxes)]),
        "box_centres": np.concatenate([np.empty(0), *(centre @ axes for axes, centre, _ in boxes)]),
        "box_halves": np.concatenate([np.empty(0), *(halves for _, _, halves in boxes)]),
    }
    for array in arrays.values():
        array.setflags(write=False)
    return Bodies(**arrays)


BALLS: dict[type, Callable[[Any], float]] = {
    coal.Sphere: lambda shape: shape.radius,
    coal.Capsule: lambda shape: shape.halfLength + shape.radius,
    coal.Cylinder: lambda shape: float(np.hypot(shape.halfLength, shape.radius)),
    coal.Box: lambda shape: float(np.linalg.norm(shape.halfSide)),
    coal.Ellipsoid: lambda shape: float(max(shape.radii)),
}
"""Radius of the smallest ball about a primitive's own centre."""


def bounding_ball(shape: Any) -> tuple[np.ndarray, float]:
    """A ball that contains a bounded Coal shape: centre (3,) in the shape's frame, and radius [m]."""
    inflation = shape.getSweptSphereRadius() if hasattr(shape, "getSweptSphereRadius") else 0.0
    if type(shape) in BALLS:
        return np.zeros(3), BALLS[type(shape)](shape) + inflation
    shape.computeLocalAABB()
    centre = np.array(shape.aabb_center)
    if isinstance(shape, coal.BVHModelBase):
        return centre, float(np.linalg.norm(np.array(shape.vertices()) - centre, axis=1).max()) + inflation
    if isinstance(shape, coal.Convex):
        return centre, float(np.linalg.norm(np.array(shape.points()) - centre, axis=1).max()) + inflation
    return centre, float(shape.aabb_radius) + inflation


def _box(obstacle: Obstacle) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The box about an obstacle along its own axes: axes as columns, centre [m, world], half extents [m]."""
    axes = np.array(obstacle.placement.rotation)
    if isinstance(obstacle.shape, coal.Halfspace):
        return axes, np.zeros(3), np.full(3, np.inf)
    obstacle.shape.computeLocalAABB()
    low, high = obstacle.shape.aabb_local.min_, obstacle.shape.aabb_local.max_
    return axes, obstacle.placement.act(0.5 * (low + high)), 0.5 * (high - low) + obstacle.rounding
