"""Balls about the robot's bodies, boxes about obstacles: their distance at least, and which joints move what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
from numpy.lib.stride_tricks import as_strided

from guidefield.read_only import read_only
from guidefield.robot.group.alike import kept_with_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.chart import TRANSLATION
from guidefield.scene.obstacle import Obstacle

PARTS = 8
"""Into so many boxes the box about a robot body is cut: balls about them follow a long body closer than one ball."""


def joint_placements(data: Any) -> np.ndarray:
    """Placements of all joints in the world, in Pinocchio's data: what is read is where they stand now.

    Copying them one by one takes longer than to compute them.

    Args:
        data: Pinocchio's data; what is returned is for no longer than they live.

    Returns:
        Rotation and translation, shape (njoints, 3, 4), read-only [m].

    Raises:
        RuntimeError: if they don't lie one behind the other, as they do in Pinocchio 3 and 4.
    """
    size = np.dtype(float).itemsize
    rotations = [placement.rotation for placement in data.oMi]
    translations = [placement.translation for placement in data.oMi]
    addresses = np.array([part.__array_interface__["data"][0] for part in (*rotations, *translations)])
    count, first = len(rotations), rotations[0]
    expected = addresses[0] + 12 * size * np.arange(count)
    if first.strides != (size, 3 * size) or not np.array_equal(addresses, np.r_[expected, expected + 9 * size]):
        raise RuntimeError("Pinocchio's placements of joints don't lie one behind the other")
    return as_strided(first, (count, 3, 4), (12 * size, size, 3 * size), writeable=False)


@dataclass(frozen=True, eq=False)
class Bodies:
    """What is known about bodies before any configuration is.

    Robot bodies come first, in the order of the group's geometry, then obstacles. Columns j are those of the velocity
    of the group's `model`, followers included.

    Attributes:
        joints: Joint that carries each robot body, shape (r,); 0 is the world.
        centres: Centres of the balls about robot bodies, in the frame of that joint, shape (r, 3) [m].
        radii: Their radii, shape (r,) [m].
        part_centres: Centres of balls that together hold a robot body, shape (r, `PARTS`, 3), in the same frame [m].
        part_radii: Their radii, shape (r,) [m].
        moved_by: Whether joint j moves a robot body, shape (r, nv).
        turns: Whether joint j turns (revolute, continuous) rather than slides, shape (nv,).
        box_axes: Axes of the boxes about obstacles in the world, shape (3, 3 o), three columns each.
        box_centres: Their centres along those axes, shape (3 o,) [m].
        box_halves: Their half extents along those axes, shape (3 o,) [m]; infinite for a half-space.
    """

    joints: np.ndarray
    centres: np.ndarray
    radii: np.ndarray
    part_centres: np.ndarray
    part_radii: np.ndarray
    moved_by: np.ndarray
    turns: np.ndarray
    box_axes: np.ndarray
    box_centres: np.ndarray
    box_halves: np.ndarray

    def centres_in_world(self, joint_placements: np.ndarray) -> np.ndarray:
        """Centres of the balls in the world.

        Args:
            joint_placements: ``T_world_joint`` of every joint of the model, shape (..., njoints, 3, 4) [m].

        Returns:
            Shape (..., r, 3) [m, world].
        """
        carriers = joint_placements[..., self.joints, :, :]
        centres: np.ndarray = (carriers[..., :3] @ self.centres[:, :, None])[..., 0] + carriers[..., 3]
        return centres

    def separations(self, centres: np.ndarray, pairs: np.ndarray, self_pairs: int) -> np.ndarray:
        """Lower bounds (..., n) of the signed distances of pairs of bodies [m].

        A ball that overlaps another, or a box from outside, bounds the depth too; a centre inside a box bounds nothing:
        minus infinity.

        Args:
            centres: Centres of the balls, shape (..., r, 3) [m, world].
            pairs: Pairs of bodies, shape (n, 2): the robot's own first, then robot body and obstacle.
            self_pairs: How many are the robot's own.
        """
        first, second = pairs.T
        a, b = first[:self_pairs], second[:self_pairs]
        between = centres[..., a, :] - centres[..., b, :]
        own = np.sqrt(np.einsum("...i,...i->...", between, between)) - self.radii[a] - self.radii[b]
        outside = np.maximum(np.abs(centres @ self.box_axes - self.box_centres) - self.box_halves, 0.0)
        outside = outside.reshape(*centres.shape[:-1], -1, 3)
        gaps = np.sqrt(np.einsum("...i,...i->...", outside, outside))
        bounds = np.where(gaps > 0.0, gaps - self.radii[:, None], -np.inf)
        return np.concatenate([own, bounds[..., first[self_pairs:], second[self_pairs:] - len(self.radii)]], axis=-1)

    def closer_separations(
        self, placements: np.ndarray, which: np.ndarray, pairs: np.ndarray, against_obstacles: np.ndarray
    ) -> np.ndarray:
        """The same (m,) [m] by the balls about parts of bodies: closer to the distances, for chosen pairs.

        Where balls overlap they bound no depth, because bodies can overlap in several parts: minus infinity.

        Args:
            placements: As in `centres_in_world`, of s configurations, shape (s, njoints, 3, 4) [m].
            which: Configuration of each pair that is asked for, shape (m,).
            pairs: The pairs, shape (m, 2).
            against_obstacles: Whether the second of a pair is an obstacle, shape (m,).
        """
        bounds = np.empty(len(which))
        first, second = pairs.T
        centres = self._part_centres(placements, which, first)
        own = ~against_obstacles
        if own.any():
            others = self._part_centres(placements, which[own], second[own])
            between = centres[own][:, :, None] - others[:, None]
            nearest = np.sqrt(np.einsum("mabi,mabi->mab", between, between).min(axis=(1, 2)))
            bounds[own] = nearest - self.part_radii[first[own]] - self.part_radii[second[own]]
        boxes = second[against_obstacles] - len(self.radii)
        axes = self.box_axes.reshape(3, -1, 3)[:, boxes].swapaxes(0, 1)
        along = centres[against_obstacles] @ axes - self.box_centres.reshape(-1, 3)[boxes, None]
        outside = np.maximum(np.abs(along) - self.box_halves.reshape(-1, 3)[boxes, None], 0.0)
        gaps = np.sqrt(np.einsum("mai,mai->ma", outside, outside).min(axis=1))
        bounds[against_obstacles] = gaps - self.part_radii[first[against_obstacles]]
        return np.where(bounds > 0.0, bounds, -np.inf)

    def _part_centres(self, placements: np.ndarray, which: np.ndarray, of: np.ndarray) -> np.ndarray:
        """Centres of the balls about parts of robot bodies (m,) in the world, shape (m, `PARTS`, 3)."""
        carriers = placements[which, self.joints[of]]
        centres: np.ndarray = self.part_centres[of] @ carriers[..., :3].swapaxes(1, 2) + carriers[:, None, :, 3]
        return centres


def bodies(group: PlanningGroup, obstacles: tuple[Obstacle, ...]) -> Bodies:
    """Measure the bodies of a robot and of obstacles, once."""
    boxes = [_box(obstacle) for obstacle in obstacles]
    arrays = {
        "box_axes": np.hstack([np.empty((3, 0)), *(axes for axes, _, _ in boxes)]),
        "box_centres": np.concatenate([np.empty(0), *(centre @ axes for axes, centre, _ in boxes)]),
        "box_halves": np.concatenate([np.empty(0), *(halves for _, _, halves in boxes)]),
    }
    read_only(*arrays.values())
    return Bodies(**_of_robot(group), **arrays)


@kept_with_alike
def _of_robot(group: PlanningGroup) -> dict[str, np.ndarray]:
    """What is known about the robot's bodies, by the name of the attribute."""
    model, shapes = group.model, list(group.geometry.geometryObjects)
    balls = [bounding_ball(shape.geometry) for shape in shapes]
    parts = [parts_of(shape.geometry) for shape in shapes]
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
        "part_centres": np.array(
            [
                part[0] @ shape.placement.rotation.T + shape.placement.translation
                for shape, part in zip(shapes, parts, strict=True)
            ]
        ).reshape(-1, PARTS, 3),
        "part_radii": np.array([radius for _, radius in parts]),
        "moved_by": moved_by,
        "turns": turns,
    }
    read_only(*arrays.values())
    return arrays


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


def parts_of(shape: Any) -> tuple[np.ndarray, float]:
    """Balls that together hold a Coal shape: their centres (`PARTS`, 3) in its frame, and the radius of all [m]."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    counts = np.ones(3, int)
    while counts.prod() < PARTS:
        counts[np.argmax((high - low) / counts)] *= 2
    cell = (high - low) / counts
    places = np.indices(tuple(counts.tolist())).reshape(3, -1).T
    return low + (places + 0.5) * cell, 0.5 * float(np.linalg.norm(cell))


def _box(obstacle: Obstacle) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The box about an obstacle along its own axes: axes as columns, centre [m, world], half extents [m]."""
    axes = np.array(obstacle.placement.rotation)
    if isinstance(obstacle.shape, coal.Halfspace):
        return axes, np.zeros(3), np.full(3, np.inf)
    obstacle.shape.computeLocalAABB()
    low, high = obstacle.shape.aabb_local.min_, obstacle.shape.aabb_local.max_
    return axes, obstacle.placement.act(0.5 * (low + high)), 0.5 * (high - low) + obstacle.rounding
