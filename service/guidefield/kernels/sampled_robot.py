"""A robot as points on its surface, and where they are at a configuration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.chart import configuration, subspaces_by_chart
from guidefield.kernels.distance import INDEX_MATRIX, INDICES_OUT, DistanceTables
from guidefield.kernels.signatures import MATRIX, MATRIX_OUT, VECTOR, VECTOR_OUT, Floats, Vector3, inlined
from guidefield.kernels.tree_kinematics import (
    BLOCKS,
    BLOCKS_OUT,
    INDICES,
    JointTable,
    joint_placements,
    motion_subspaces,
)

FLAGS = types.Array(types.boolean, 2, "C", readonly=True)
JOINTS = types.NamedTuple((INDICES, INDICES, MATRIX, BLOCKS, INDICES, INDICES, INDICES), JointTable)


class SampledRobot(NamedTuple):
    """A robot as points on its surface and capsules about its links.

    Attributes:
        joints: Joints of the robot's model, followers included.
        drivers, multipliers, offsets: (model nv,) chart coordinate i of the model, followers included, is
            multipliers[i] z[drivers[i]] + offsets[i].
        origin: (model nq,) configuration from which the chart's rotation vectors start.
        points: (3, p) on moving links, in the frame of their joint [m]; those of a group stand together.
        weights: (p,) how much each counts.
        groups: (g, 3) joint, first point, one past the last point.
        balls: (g, 4) centre and radius of a ball about a group's points, in the frame of the joint [m].
        ignored: (g, obstacles) whether a group's distance to an obstacle doesn't count.
        capsules: (c, 7) ends and radius in the frame of their joint [m].
        capsule_joints: (c,) joint of each capsule.
        pairs: (k, 2) group and capsule of links that are kept apart.
        slacks: (k,) added to the distance of each pair [m].
    """

    joints: JointTable
    drivers: np.ndarray
    multipliers: Floats
    offsets: Floats
    origin: Floats
    points: Floats
    weights: Floats
    groups: np.ndarray
    balls: Floats
    ignored: np.ndarray
    capsules: Floats
    capsule_joints: np.ndarray
    pairs: np.ndarray
    slacks: Floats


ROBOT = types.NamedTuple(
    (
        *(JOINTS, INDICES, VECTOR, VECTOR, VECTOR, MATRIX, VECTOR, INDEX_MATRIX, MATRIX, FLAGS),
        *(MATRIX, INDICES, INDEX_MATRIX, VECTOR),
    ),
    SampledRobot,
)


class Workspace(NamedTuple):
    """Scratch of `barrier_at`, overwritten by every call.

    Attributes:
        q: Configuration of the model.
        values: Chart coordinates of the model.
        row: Gradient of one distance by them.
        gradient, hessian: Sums by them.
        world: Placements of the joints.
        subspaces: What chart velocities cause, as twists at the world's origin, (nv, 6).
        forces, inertias: What has gathered at each joint, (n, 6) and (n, 6, 6) of which the upper triangle is used.
        candidates: Bodies near a group.
        gaps: Square of the distance from a group's points to the nearest box about a body.
    """

    q: Floats
    values: Floats
    row: Floats
    gradient: Floats
    hessian: Floats
    world: Floats
    subspaces: Floats
    forces: Floats
    inertias: Floats
    candidates: np.ndarray
    gaps: Floats


WORKSPACE = types.NamedTuple(
    (
        VECTOR_OUT,
        VECTOR_OUT,
        VECTOR_OUT,
        VECTOR_OUT,
        MATRIX_OUT,
        BLOCKS_OUT,
        MATRIX_OUT,
        MATRIX_OUT,
        BLOCKS_OUT,
        INDICES_OUT,
        VECTOR_OUT,
    ),
    Workspace,
)


@inlined
def workspace(robot: SampledRobot, tables: DistanceTables) -> Workspace:
    """Scratch for a robot among some bodies."""
    n, nv = robot.joints.parents.shape[0], robot.offsets.shape[0]
    return Workspace(
        np.empty(robot.origin.shape[0]),
        np.empty(nv),
        np.empty(nv),
        np.empty(nv),
        np.empty((nv, nv)),
        np.empty((n, 3, 4)),
        np.empty((nv, 6)),
        np.empty((n, 6)),
        np.empty((n, 6, 6)),
        np.empty(tables.kinds.shape[0], np.int64),
        np.empty(robot.points.shape[1]),
    )


@inlined
def moved(T: Floats, x: float, y: float, z: float) -> Vector3:
    """A point of a placed frame in the world."""
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )


@inlined
def place(robot: SampledRobot, z: Floats, work: Workspace) -> None:
    """Placements of the joints at chart coordinates z, and motion subspaces by the chart of the model's joints."""
    joints = robot.joints
    for i in range(robot.offsets.shape[0]):
        work.values[i] = robot.multipliers[i] * z[robot.drivers[i]] + robot.offsets[i]
    configuration(joints, work.values, robot.origin, work.q)
    joint_placements(joints.parents, joints.kinds, joints.axes, joints.placements, joints.idx_q, work.q, work.world)
    motion_subspaces(joints.kinds, joints.axes, joints.idx_v, joints.nv, work.world, work.subspaces)
    subspaces_by_chart(joints, work.values, work.q, work.subspaces)
