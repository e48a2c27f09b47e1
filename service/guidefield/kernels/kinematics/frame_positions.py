"""Where a frame is at chart points, and how it moves with them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types, void

from guidefield.kernels.jit.no_refcount import counted, uncounted
from guidefield.kernels.jit.signatures import MATRIX, MATRIX_OUT, VECTOR, Floats, Vector3, compiled
from guidefield.kernels.kinematics.chart import configuration, subspaces_by_chart
from guidefield.kernels.kinematics.forward_kinematics import JOINTS, JointTable, place_joints, place_subspaces
from guidefield.kernels.kinematics.poses import moved_by


class PointScratch(NamedTuple):
    """Scratch of `place_point`.

    Attributes:
        values: Coordinates of the model's chart, shape (n,).
        q: Configuration of the model, shape (nq,).
        poses: Of its joints, shape (joints, 3, 4).
        rotation, translation: Of a joint, shapes (3, 3) and (3,).
    """

    values: Floats
    q: Floats
    poses: Floats
    rotation: Floats
    translation: Floats


@counted
def point_scratch(joints: JointTable, offset: Floats, origin: Floats) -> PointScratch:
    """Scratch for some joints; `offset` and `origin` are as in `frame_positions`."""
    poses = np.empty((joints.parents.shape[0], 3, 4))
    return PointScratch(np.empty(offset.shape[0]), np.empty(origin.shape[0]), poses, np.empty((3, 3)), np.empty(3))


@uncounted
def place_point(
    joints: JointTable,
    expand: Floats,
    offset: Floats,
    origin: Floats,
    z: Floats,
    carrier: int,
    point: Floats,
    scratch: PointScratch,
) -> Vector3:
    """Position of a point that a joint carries at a chart point, shape (nv,) [m]; the rest is as in `frame_positions`.

    Where the joints are is left in the scratch.
    """
    values, q = scratch.values, scratch.q
    for i in range(values.shape[0]):
        values[i] = offset[i]
        for j in range(z.shape[0]):
            values[i] += expand[i, j] * z[j]
    configuration(joints, values, origin, q)
    place_joints(
        joints.parents,
        joints.kinds,
        joints.axes,
        joints.placements,
        joints.idx_q,
        q,
        scratch.rotation,
        scratch.translation,
        scratch.poses,
    )
    return moved_by(scratch.poses[carrier], point[0], point[1], point[2])


@compiled(void(JOINTS, MATRIX, VECTOR, VECTOR, MATRIX, types.int64, VECTOR, MATRIX_OUT))
def frame_positions(
    joints: JointTable,
    expand: Floats,
    offset: Floats,
    origin: Floats,
    zs: Floats,
    carrier: int,
    point: Floats,
    positions_out: Floats,
) -> None:
    """Positions of a point that a joint carries.

    Args:
        joints: Joints of the model, followers included.
        expand: Coordinates of the model's chart by those of the group, shape (n, nv); with `offset`.
        offset: Shape (n,) [rad or m].
        origin: Configuration of the model from which rotation vectors start, shape (nq,).
        zs: Chart points of the group, shape (k, nv) [rad or m].
        carrier: The joint.
        point: In its frame, shape (3,) [m].
        positions_out: Shape (k, 3) [m, world].
    """
    scratch = point_scratch(joints, offset, origin)
    for k in range(zs.shape[0]):
        x, y, z = place_point(joints, expand, offset, origin, zs[k], carrier, point, scratch)
        positions_out[k, 0], positions_out[k, 1], positions_out[k, 2] = x, y, z


@compiled(void(JOINTS, MATRIX, VECTOR, VECTOR, VECTOR, types.int64, VECTOR, MATRIX_OUT))
def frame_slopes(
    joints: JointTable,
    expand: Floats,
    offset: Floats,
    origin: Floats,
    z: Floats,
    carrier: int,
    point: Floats,
    slopes_out: Floats,
) -> None:
    """Derivative by the chart of the position of a point that a joint carries.

    A twist (v, w) at the world's origin moves the point p by v + w x p.

    Args:
        joints: Joints of the model, followers included.
        expand: As in `frame_positions`.
        offset: See there.
        origin: See there.
        z: Chart point of the group, shape (nv,) [rad or m].
        carrier: The joint.
        point: In its frame, shape (3,) [m].
        slopes_out: Shape (3, nv) [m per rad or m, world].
    """
    scratch, subspaces = point_scratch(joints, offset, origin), np.empty((offset.shape[0], 6))
    px, py, pz = place_point(joints, expand, offset, origin, z, carrier, point, scratch)
    place_subspaces(joints.kinds, joints.axes, joints.idx_v, joints.nv, scratch.poses, subspaces)
    subspaces_by_chart(joints, scratch.values, scratch.q, subspaces)
    slopes_out[:, :] = 0.0
    joint = carrier
    while joint > 0:
        for row in range(joints.idx_v[joint], joints.idx_v[joint] + joints.nv[joint]):
            twist = subspaces[row]
            vx, vy, vz, wx, wy, wz = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
            dx, dy, dz = vx + wy * pz - wz * py, vy + wz * px - wx * pz, vz + wx * py - wy * px
            for j in range(z.shape[0]):
                slopes_out[0, j] += expand[row, j] * dx
                slopes_out[1, j] += expand[row, j] * dy
                slopes_out[2, j] += expand[row, j] * dz
        joint = joints.parents[joint]
