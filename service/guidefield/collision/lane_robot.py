"""A planning group as tables for the lane kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.collision.convex_parts import PartsTable
from guidefield.kernels.lane_kinematics import JOINT, SLIDING, TURNING, LaneJoints
from guidefield.kernels.lane_tables import LaneBodies
from guidefield.kernels.separation import Parts
from guidefield.kernels.tree_kinematics import PRISMATIC
from guidefield.robot.coverage import ShapeCoverage
from guidefield.robot.group import PlanningGroup
from guidefield.robot.tables import joint_table


@dataclass(frozen=True, eq=False)
class LaneRobot:
    """A robot for lanes: joints whose axes are z, bodies in those joints' frames.

    Attributes:
        joints: Its joints.
        bodies: Its collision shapes, as the group's geometry has them, each with its cover and inner balls.
        parts: The shapes themselves.
    """

    joints: LaneJoints
    bodies: LaneBodies
    parts: Parts


def lane_robot(group: PlanningGroup, balls: Sequence[ShapeCoverage], pairs: np.ndarray) -> LaneRobot:
    """Build the tables of a group all of whose joints have one degree of freedom.

    Args:
        group: The robot's planned joints.
        balls: For each collision shape, those that contain it and those inside it, in its own frame.
        pairs: Indices of the shapes that must not touch each other, shape (p, 2).

    Raises:
        UnservedError: if a shape is of a kind that the kernels don't know.
    """
    turns = _turns(group.model)
    table, roots = PartsTable(), []
    moved_covers, moved_inners, bounds = [], [], []
    shapes = list(group.geometry.geometryObjects)
    for shape, own in zip(shapes, balls, strict=True):
        placement = pin.SE3(turns[shape.parentJoint].T, np.zeros(3)) * shape.placement
        roots.append(table.add_shape(shape.geometry, placement))
        moved_covers.append(_moved(placement, own.cover.spheres))
        moved_inners.append(_moved(placement, own.inner))
        bounds.append(_moved(placement, own.cover.bound[None]))
    carriers = np.array([shape.parentJoint for shape in shapes], np.int64)
    moving = np.flatnonzero(carriers)
    bodies = LaneBodies(
        size=len(shapes),
        moving=len(moving),
        n_pairs=len(pairs),
        joints=carriers,
        covers=_offsets(moved_covers),
        inners=_offsets(moved_inners),
        roots=np.array(roots, np.int64),
        order=moving[np.argsort(-carriers[moving], kind="stable")],
        pairs=np.array(pairs, np.int64).reshape(-1),
        bounds=_balls(bounds),
        cover=_balls(moved_covers),
        inner=_balls(moved_inners),
    )
    for array in bodies[3:]:
        array.setflags(write=False)
    return LaneRobot(_joints(group, turns), bodies, table.tables())


def _turns(model: Any) -> list[np.ndarray]:
    """For each joint the rotation that takes z to its axis."""
    turns = []
    for axis in joint_table(model).axes:
        z = np.array([0.0, 0.0, 1.0])
        turns.append(pin.Quaternion.FromTwoVectors(z, axis).matrix() if np.any(axis) else np.eye(3))
    return turns


def _joints(group: PlanningGroup, turns: list[np.ndarray]) -> LaneJoints:
    table = joint_table(group.model)
    n = len(table.parents)
    numbers = np.zeros((n, JOINT))
    drivers = np.zeros(n, np.int64)
    for i in range(1, n):
        placement = np.c_[turns[table.parents[i]].T @ table.placements[i][:, :3] @ turns[i], np.zeros(3)]
        placement[:, 3] = turns[table.parents[i]].T @ table.placements[i][:, 3]
        row = group.expand_velocity[table.idx_v[i]]
        drivers[i] = int(np.argmax(np.abs(row)))
        assert np.count_nonzero(row) <= 1, "a joint follows at most one coordinate"
        numbers[i] = *placement.ravel(), row[drivers[i]], group.expand_offset[table.idx_v[i]]
    kinds = np.where(table.kinds == PRISMATIC, SLIDING, TURNING)
    joints = LaneJoints(n, np.array(table.parents), kinds, drivers, numbers.ravel().astype(np.float32))
    for array in joints[1:]:
        array.setflags(write=False)
    return joints


def _moved(placement: Any, balls: np.ndarray) -> np.ndarray:
    return np.column_stack([balls[:, :3] @ placement.rotation.T + placement.translation, balls[:, 3]])


def _offsets(groups: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum([len(rows) for rows in groups])]).astype(np.int64)


def _balls(groups: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.empty((0, 4)), *groups]).ravel().astype(np.float32)
