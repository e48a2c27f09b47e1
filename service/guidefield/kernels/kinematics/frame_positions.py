"""Where a frame is at chart points, and how it moves with them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import void

from guidefield.kernels.jit.fields import Row, Rows, numba_type
from guidefield.kernels.jit.no_refcount import counted, uncounted
from guidefield.kernels.jit.signatures import MATRIX, MATRIX_OUT, VECTOR, Floats, Vector3, compiled
from guidefield.kernels.kinematics.chart import place_by_chart, subspaces_by_chart
from guidefield.kernels.kinematics.forward_kinematics import JointTable, place_subspaces
from guidefield.kernels.kinematics.poses import moved_by


class CarriedPoint(NamedTuple):
    """A point that a joint carries, and the chart that moves it.

    Attributes:
        joints: Joints of the model, followers included; those that don't lead to the carrier may be left out.
        expand, offset: Coordinates of the model's chart by those of the group, shapes (n, nv) and (n,) [rad or m].
        origin: Configuration of the model from which rotation vectors start, shape (nq,).
        carrier: The joint, by its row.
        point: In its frame, shape (3,) [m].
    """

    joints: JointTable
    expand: Rows
    offset: Row
    origin: Row
    carrier: int
    point: Row


CARRIED_POINT = numba_type(CarriedPoint)


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
def point_scratch(of: CarriedPoint) -> PointScratch:
    """Scratch for a point."""
    values, q, poses = np.empty(of.offset.shape[0]), np.empty(of.origin.shape[0]), (of.joints.parents.shape[0], 3, 4)
    return PointScratch(values, q, np.empty(poses), np.empty((3, 3)), np.empty(3))


@uncounted
def place_point(of: CarriedPoint, z: Floats, scratch: PointScratch) -> Vector3:
    """Position of a point at a chart point of the group, shape (nv,) [m]; the scratch has where the joints are."""
    values = scratch.values
    for i in range(values.shape[0]):
        values[i] = of.offset[i]
        for j in range(z.shape[0]):
            values[i] += of.expand[i, j] * z[j]
    place_by_chart(of.joints, values, of.origin, scratch.q, scratch.rotation, scratch.translation, scratch.poses)
    return moved_by(scratch.poses[of.carrier], of.point[0], of.point[1], of.point[2])


@compiled(void(CARRIED_POINT, MATRIX, MATRIX_OUT))
def frame_positions(of: CarriedPoint, zs: Floats, positions_out: Floats) -> None:
    """Positions of a point that a joint carries.

    Args:
        of: The point.
        zs: Chart points of the group, shape (k, nv) [rad or m].
        positions_out: Shape (k, 3) [m, world].
    """
    scratch = point_scratch(of)
    for k in range(zs.shape[0]):
        x, y, z = place_point(of, zs[k], scratch)
        positions_out[k, 0], positions_out[k, 1], positions_out[k, 2] = x, y, z


@compiled(void(CARRIED_POINT, VECTOR, MATRIX_OUT))
def frame_slopes(of: CarriedPoint, z: Floats, slopes_out: Floats) -> None:
    """Derivative by the chart of the position of a point that a joint carries.

    A twist (v, w) at the world's origin moves the point p by v + w x p.

    Args:
        of: The point.
        z: Chart point of the group, shape (nv,) [rad or m].
        slopes_out: Shape (3, nv) [m per rad or m, world].
    """
    joints, scratch, subspaces = of.joints, point_scratch(of), np.empty((of.offset.shape[0], 6))
    px, py, pz = place_point(of, z, scratch)
    place_subspaces(joints.kinds, joints.axes, joints.idx_v, joints.nv, scratch.poses, subspaces)
    subspaces_by_chart(joints, scratch.values, scratch.q, subspaces)
    slopes_out[:, :] = 0.0
    joint = of.carrier
    while joint > 0:
        for row in range(joints.idx_v[joint], joints.idx_v[joint] + joints.nv[joint]):
            twist = subspaces[row]
            vx, vy, vz, wx, wy, wz = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
            dx, dy, dz = vx + wy * pz - wz * py, vy + wz * px - wx * pz, vz + wx * py - wy * px
            for j in range(z.shape[0]):
                slopes_out[0, j] += of.expand[row, j] * dx
                slopes_out[1, j] += of.expand[row, j] * dy
                slopes_out[2, j] += of.expand[row, j] * dz
        joint = joints.parents[joint]
