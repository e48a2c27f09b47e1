"""Bounding spheres of the robot's bodies, in the frames of their joints, and which joints move which body.

The motion bound and every filter of pairs rely on them: balls may be larger than needed, never smaller.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal
import numpy as np
from numpy.lib.stride_tricks import as_strided

from guidefield.kernels.collide.near_pairs import BodyBalls
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.chart import TRANSLATION

PARTS = 8
"""The box about a robot body is halved into so many boxes: balls about them follow a long body closer than one ball."""


def joint_placements(data: Any, *, writeable: bool = False) -> np.ndarray:
    """Return a view of the placements of all joints in the world in Pinocchio's data, shape (njoints, 3, 4).

    A view, because copying them one by one takes longer than to compute them: it changes as Pinocchio places joints,
    and is valid as long as the data live. Raises RuntimeError if placements don't lie one behind the other in memory,
    as they do in Pinocchio 3 and 4.
    """
    return _one_behind_the_other(data.oMi, writeable=writeable)


def body_placements(data: Any) -> np.ndarray:
    """Return a writeable view of the placements of all bodies in Pinocchio's geometry data, shape (r, 3, 4) [m]."""
    return _one_behind_the_other(data.oMg, writeable=True)


def _one_behind_the_other(placements: Any, *, writeable: bool = False) -> np.ndarray:
    if not len(placements):
        return np.empty((0, 3, 4))
    size, count, first = np.dtype(float).itemsize, len(placements), placements[0].rotation
    begin = _address(first)
    ends = (placements[0].translation, placements[count - 1].rotation)
    # in a C++ vector all are as far apart as the first and the last say
    expected = [begin + 9 * size, begin + 12 * size * (count - 1)]
    if first.strides != (size, 3 * size) or list(map(_address, ends)) != expected:
        raise RuntimeError("Pinocchio's placements don't lie one behind the other")
    return as_strided(first, (count, 3, 4), (12 * size, size, 3 * size), writeable=writeable)


def _address(array: np.ndarray) -> int:
    return int(array.__array_interface__["data"][0])


@dataclass(frozen=True, eq=False)
class Bodies:
    """Facts about the robot's bodies that no configuration changes, in the order of the group's geometry.

    Columns j are those of the velocity of the group's `model`, mimic joints included.
    """

    joints: np.ndarray  # joint that carries each robot body, shape (r,); 0 is the world
    centres: np.ndarray  # balls about robot bodies, in the frame of that joint, shapes (r, 3) and (r,) [m]
    radii: np.ndarray
    part_centres: np.ndarray  # balls that together hold each, shapes (r, `PARTS`, 3) and (r,), in the same frame [m]
    part_radii: np.ndarray
    moved_by: np.ndarray  # whether joint j moves a robot body, shape (r, nv)
    turns: np.ndarray  # whether joint j turns (revolute, continuous) rather than slides, shape (nv,)

    @cached_property
    def balls(self) -> BodyBalls:
        """The balls as kernels read them."""
        return BodyBalls(self.joints, self.centres, self.radii, self.part_centres, self.part_radii)

    def centres_in_world(self, joint_placements: np.ndarray) -> np.ndarray:
        """Return the balls' centres (..., r, 3) [m, world], where all joints are placed by (..., njoints, 3, 4)."""
        carriers = joint_placements[..., self.joints, :, :]
        centres: np.ndarray = (carriers[..., :3] @ self.centres[:, :, None])[..., 0] + carriers[..., 3]
        return centres


@memoized_for_alike
def bodies(group: PlanningGroup) -> Bodies:
    """Measure the bodies of a robot, once."""
    model, shapes = group.model, list(group.geometry.geometryObjects)
    balls = [bounding_ball(shape.geometry) for shape in shapes]
    parts = [parts_of(shape.geometry) for shape in shapes]
    joints = np.array([shape.parentJoint for shape in shapes], np.int64)
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
        "centres": np.array(
            [shape.placement.act(ball[0]) for shape, ball in zip(shapes, balls, strict=True)], float
        ).reshape(-1, 3),
        "radii": np.array([radius for _, radius in balls], float),
        "part_centres": np.array(
            [
                part[0] @ shape.placement.rotation.T + shape.placement.translation
                for shape, part in zip(shapes, parts, strict=True)
            ]
        ).reshape(-1, PARTS, 3),
        "part_radii": np.array([radius for _, radius in parts], float),
        "moved_by": moved_by,
        "turns": turns,
    }
    read_only(*arrays.values())
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
    """Return a ball that contains a bounded Coal shape: centre (3,) in the shape's frame, and radius [m]."""
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
    """Return balls that together contain a Coal shape: their centres (`PARTS`, 3) in its frame, and one radius [m]."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    counts = np.ones(3, int)
    while counts.prod() < PARTS:
        counts[np.argmax((high - low) / counts)] *= 2
    cell = (high - low) / counts
    places = np.indices(tuple(counts.tolist())).reshape(3, -1).T
    return low + (places + 0.5) * cell, 0.5 * float(np.linalg.norm(cell))
