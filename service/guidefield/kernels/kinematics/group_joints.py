"""Forward kinematics by a group's local coordinates: placements and twists of joints, positions of carried points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import void

from guidefield.kernels.jit.fields import Blocks, BlocksOut, Indices, Row, RowOut, RowsOut, numba_type
from guidefield.kernels.jit.no_refcount import counted, uncounted
from guidefield.kernels.jit.signatures import BLOCKS_OUT, MATRIX, MATRIX_OUT, VECTOR, Floats, Vector3, compiled
from guidefield.kernels.kinematics.chart import place_by_chart, subspaces_by_chart
from guidefield.kernels.kinematics.forward_kinematics import (
    JOINTS,
    JointTable,
    compose,
    place_joints,
    place_subspaces,
    quaternion_of,
)
from guidefield.kernels.kinematics.poses import moved_by


class GroupJoints(NamedTuple):
    """The joints of a robot's model, and the local coordinates z of a group that move them.

    Attributes:
        table: The joints, mimic joints included.
        sources, multipliers, offsets: Local coordinate i of the model is multipliers[i] z[sources[i]] + offsets[i]
            [rad or m]; each of shape (m,).
        origin: Configuration of the model from which rotation vectors start, shape (nq,).
    """

    table: JointTable
    sources: Indices
    multipliers: Row
    offsets: Row
    origin: Row


class JointPlaces(NamedTuple):
    """Placements of a group's joints and scratch to find them; n joints, m local coordinates of the model.

    Attributes:
        values: Local coordinates of the model, shape (m,) [rad or m].
        q: Configuration of the model, shape (nq,).
        rotation, translation: Of one joint by its value, shapes (3, 3) and (3,).
        poses: Placements of the joints in the world, shape (n, 3, 4) [m].
        twists: Linear velocity of the point at the world's origin, then angular velocity, by each local coordinate of
            the model, shape (m, 6).
    """

    values: RowOut
    q: RowOut
    rotation: RowsOut
    translation: RowOut
    poses: BlocksOut
    twists: RowsOut


@counted
def joint_places(joints: GroupJoints) -> JointPlaces:
    """Scratch for placements of a group's joints."""
    n, m = joints.table.parents.shape[0], joints.offsets.shape[0]
    nq = joints.origin.shape[0]
    return JointPlaces(np.empty(m), np.empty(nq), np.empty((3, 3)), np.empty(3), np.empty((n, 3, 4)), np.empty((m, 6)))


@uncounted
def place_group(joints: GroupJoints, z: Floats, places: JointPlaces) -> None:
    """Place the joints at local coordinates of the group, shape (nv,) [rad or m]."""
    for i in range(joints.offsets.shape[0]):
        places.values[i] = joints.multipliers[i] * z[joints.sources[i]] + joints.offsets[i]
    place_by_chart(
        joints.table, places.values, joints.origin, places.q, places.rotation, places.translation, places.poses
    )


@uncounted
def write_twists(joints: GroupJoints, places: JointPlaces) -> None:
    """Write how the model's local coordinates move the joints where they were placed last."""
    place_subspaces(joints.table, places.poses, places.twists)
    subspaces_by_chart(joints.table, places.values, places.q, places.twists)


@uncounted
def velocity_by(twist: Floats, x: float, y: float, z: float) -> Vector3:
    """Velocity of a point by a twist (v, w) at the world's origin, shape (6,): v + w x p.

    Its length is the distance from the axis of a joint that turns, and 1 of one that slides.
    """
    return (
        twist[0] + twist[4] * z - twist[5] * y,
        twist[1] + twist[5] * x - twist[3] * z,
        twist[2] + twist[3] * y - twist[4] * x,
    )


class CarriedPoint(NamedTuple):
    """A point that a joint carries.

    Attributes:
        joints: The joints; those that don't lead to the carrier may be left out.
        carrier: The joint, by its row.
        point: In its frame, shape (3,) [m].
    """

    joints: GroupJoints
    carrier: int
    point: Row


CARRIED_POINT = numba_type(CarriedPoint)


@uncounted
def place_point(of: CarriedPoint, z: Floats, places: JointPlaces) -> Vector3:
    """Position of a point at local coordinates of the group, shape (nv,) [m]; leaves the joints' placements."""
    place_group(of.joints, z, places)
    return moved_by(places.poses[of.carrier], of.point[0], of.point[1], of.point[2])


@compiled(void(CARRIED_POINT, MATRIX, MATRIX_OUT))
def frame_positions(of: CarriedPoint, zs: Floats, positions_out: Floats) -> None:
    """Positions of a point that a joint carries.

    Args:
        of: The point.
        zs: Local coordinates of the group, shape (k, nv) [rad or m].
        positions_out: Shape (k, 3) [m, world].
    """
    places = joint_places(of.joints)
    for k in range(zs.shape[0]):
        x, y, z = place_point(of, zs[k], places)
        positions_out[k, 0], positions_out[k, 1], positions_out[k, 2] = x, y, z


@compiled(void(CARRIED_POINT, VECTOR, MATRIX_OUT))
def frame_slopes(of: CarriedPoint, z: Floats, slopes_out: Floats) -> None:
    """Derivative by local coordinates of the position of a point that a joint carries.

    A twist (v, w) at the world's origin moves the point p by v + w x p.

    Args:
        of: The point.
        z: Local coordinates of the group, shape (nv,) [rad or m].
        slopes_out: Shape (3, nv) [m per rad or m, world].
    """
    joints, table, places = of.joints, of.joints.table, joint_places(of.joints)
    px, py, pz = place_point(of, z, places)
    write_twists(joints, places)
    slopes_out[:, :] = 0.0
    joint = of.carrier
    while joint > 0:
        for row in range(table.idx_v[joint], table.idx_v[joint] + table.nv[joint]):
            column, by = joints.sources[row], joints.multipliers[row]
            vx, vy, vz = velocity_by(places.twists[row], px, py, pz)
            slopes_out[0, column] += by * vx
            slopes_out[1, column] += by * vy
            slopes_out[2, column] += by * vz
        joint = table.parents[joint]


class FrameTable(NamedTuple):
    """Frames of a robot.

    Attributes:
        joints: The joint that carries each frame, by its row in `JointTable`, shape (k,).
        placements: Rotation and translation of each frame in that of its joint, shape (k, 3, 4) [m].
    """

    joints: Indices
    placements: Blocks


@compiled(void(JOINTS, numba_type(FrameTable), MATRIX, MATRIX, BLOCKS_OUT))
def place_frames(
    joints: JointTable, frames: FrameTable, root: Floats, configurations: Floats, placements_out: Floats
) -> None:
    """Place frames at configurations.

    Args:
        joints: All joints of the robot.
        frames: The frames.
        root: Placement of the robot's root in the world, shape (3, 4) [m].
        configurations: Shape (n, nq).
        placements_out: Position [m] and unit quaternion (x, y, z, w) of each frame in the world, shape (n, k, 7).
    """
    rotation, translation, poses = np.empty((3, 3)), np.empty(3), np.empty((joints.parents.shape[0], 3, 4))
    placed = np.empty((3, 4))
    for i in range(configurations.shape[0]):
        place_joints(joints, configurations[i], rotation, translation, poses)
        for k in range(frames.joints.shape[0]):
            frame, out = frames.placements[k], placements_out[i, k]
            compose(root, poses[frames.joints[k]], frame[:, :3], frame[:, 3], placed)
            for r in range(3):
                out[r] = placed[r, 3]
            quaternion_of(placed, out, 3)
