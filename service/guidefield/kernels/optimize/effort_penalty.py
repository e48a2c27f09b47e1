"""A penalty of a motion's torques beyond a share of their limits, with derivatives by control points and time.

    1/2 w · mean over samples of sum_j max(0, |T_j| / L_j - s)²

At the share t of a piece of length h, z = B P, z' = B' P / h and z'' = B'' P / h², with B the basis of the piece's four
control points. The torque's derivatives by z and z' are differences; by z'' they are the mass matrix. By u = log h
velocities change by -z', accelerations by -2 z''. The Hessian is Gauss and Newton's of z and z'', without what couples
both: places on the motion, as those of the clearance, with the bases B and B'' / h².
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import BlocksOut, Floats, IndicesOut, Row, RowOut, Rows, RowsOut
from guidefield.kernels.jit.decorators import kernel, uncounted
from guidefield.kernels.kinematics.forward_kinematics import JointPlaces, joint_places
from guidefield.kernels.timing.carried_rates import CoordinateBounds, empty_bounds
from guidefield.kernels.timing.torques import MassTree, TorqueRoom, place_tree, torque_room, write_torques

DIFFERENCE = 1e-6  # of coordinates and their rates, by which torques are differentiated


@uncounted
def _write_bases(t: float, step: float, bases_out: Floats) -> None:
    """Write the basis at a share of a piece, and those of the first two derivatives by time, shape (3, 4)."""
    s = 1.0 - t
    bases_out[0, 0], bases_out[0, 3] = s * s * s / 6.0, t * t * t / 6.0
    bases_out[0, 1] = (4.0 + t * t * (3.0 * t - 6.0)) / 6.0
    bases_out[0, 2] = (4.0 + s * s * (3.0 * s - 6.0)) / 6.0
    bases_out[1, 0], bases_out[1, 1] = -0.5 * s * s / step, 0.5 * t * (3.0 * t - 4.0) / step
    bases_out[1, 2], bases_out[1, 3] = 0.5 * s * (4.0 - 3.0 * s) / step, 0.5 * t * t / step
    square = step * step
    bases_out[2, 0], bases_out[2, 1] = s / square, (3.0 * t - 2.0) / square
    bases_out[2, 2], bases_out[2, 3] = (3.0 * s - 2.0) / square, t / square


class _Derivatives(NamedTuple):
    """Of torques, by coordinates, velocities and accelerations, [order, joint, coordinate]."""

    by_points: BlocksOut  # shape (3, nv, nv)
    moved: RowOut  # scratch, shape (nv,)
    slopes: RowsOut  # scratch, shape (3, nv)


@uncounted
def _write_bent(points: Floats, piece: int, bases: Floats, state: CoordinateBounds) -> None:
    """Write point, velocity and acceleration at a place of a piece."""
    for j in range(points.shape[1]):
        state.z[j] = state.dz[j] = state.ddz[j] = 0.0
        for a in range(4):
            state.z[j] += bases[0, a] * points[piece + a, j]
            state.dz[j] += bases[1, a] * points[piece + a, j]
            state.ddz[j] += bases[2, a] * points[piece + a, j]


@uncounted
def _write_derivatives(
    tree: MassTree, state: CoordinateBounds, places: JointPlaces, room: TorqueRoom, torques: Floats, out: _Derivatives
) -> None:
    """Write the derivatives of torques (nv,) where the tree is placed; the placement is another one then."""
    nv = torques.shape[0]
    for order in range(2, -1, -1):
        of = state.z if order == 0 else (state.dz if order == 1 else state.ddz)
        by = 1.0 if order == 2 else DIFFERENCE  # they are linear in accelerations
        for p in range(nv):
            here = of[p]
            of[p] = here + by
            if order == 0:
                place_tree(tree, state, places)
            write_torques(tree, state, places, room, out.moved)
            of[p] = here
            for j in range(nv):
                out.by_points[order, j, p] = (out.moved[j] - torques[j]) / by


@uncounted
def _add_joint(
    j: int, slope: float, bend: float, state: CoordinateBounds, made: _Derivatives, near_out: Floats, far_out: Floats
) -> float:
    """Add what a joint's torque beyond its limit has as slopes and Hessians by z and z''; return what u changes it."""
    by, by_u = made.by_points, 0.0
    for p in range(made.moved.shape[0]):
        by_u -= by[1, j, p] * state.dz[p] + 2.0 * by[2, j, p] * state.ddz[p]
        for order in range(3):
            made.slopes[order, p] += slope * by[order, j, p]
        for q in range(made.moved.shape[0]):
            near_out[p, q] += bend * by[0, j, p] * by[0, j, q]
            far_out[p, q] += bend * by[2, j, p] * by[2, j, q]
    return by_u


@kernel
def effort_value(
    tree: MassTree, limits: Row, points: Rows, step: float, samples: int, weight: float, share: float
) -> float:
    """Return the penalty alone; arguments are those of `effort_penalty`."""
    nv, m, count = points.shape[1], tree.joints.sources.shape[0], points.shape[0] - 3
    n, chain = tree.joints.table.parents.shape[0], tree.chains.shape[1]
    places, state, room = joint_places(tree.joints), empty_bounds(nv, m), torque_room(n, nv, chain)
    torques, bases, total = np.empty(nv), np.empty((3, 4)), 0.0
    for piece in range(count):
        for sample in range(samples):
            _write_bases((sample + 0.5) / samples, step, bases)
            _write_bent(points, piece, bases, state)
            place_tree(tree, state, places)
            write_torques(tree, state, places, room, torques)
            for j in range(nv):
                beyond = max(0.0, abs(torques[j]) / limits[j] - share)
                total += 0.5 * weight / (samples * count) * beyond * beyond
    return total


@kernel
def effort_penalty(
    tree: MassTree,
    limits: Row,
    points: Rows,
    step: float,
    samples: int,
    weight: float,
    share: float,
    first: int,
    gradient_out: RowsOut,
    pieces_out: IndicesOut,
    basis_out: RowsOut,
    hessians_out: BlocksOut,
    border_out: BlocksOut,
    by_times_out: RowOut,
    corner_out: RowsOut,
) -> tuple[float, int]:
    """Add the penalty to a `ClearanceModel`, as places from `first` on; return its value, and where places end.

    Args:
        tree: The bodies.
        limits: L of each coordinate, shape (nv,), infinite where there is none [N m or N].
        points: Control points, shape (n, nv).
        step: h [s].
        samples: On each piece.
        weight: w.
        share: s.
        first: How many places the model has.
        gradient_out: By the control points, shape (n, nv), added to.
        pieces_out, basis_out, hessians_out: Of places, shapes (s,), (s, 4) and (s, nv, nv): two for each sample.
        border_out: By control points and times, shape (2, n, nv), added to.
        by_times_out: Gradient by times, shape (2,), added to.
        corner_out: Hessian by times, shape (2, 2), added to.
    """
    nv, m, count = points.shape[1], tree.joints.sources.shape[0], points.shape[0] - 3
    n, chain = tree.joints.table.parents.shape[0], tree.chains.shape[1]
    places, state, room = joint_places(tree.joints), empty_bounds(nv, m), torque_room(n, nv, chain)
    torques, bases = np.empty(nv), np.empty((3, 4))
    made = _Derivatives(np.empty((3, nv, nv)), np.empty(nv), np.empty((3, nv)))
    total, place, each = 0.0, first, weight / (samples * count)
    for piece in range(count):
        for sample in range(samples):
            _write_bases((sample + 0.5) / samples, step, bases)
            _write_bent(points, piece, bases, state)
            place_tree(tree, state, places)
            write_torques(tree, state, places, room, torques)
            is_beyond = False
            for j in range(nv):
                beyond = abs(torques[j]) / limits[j] - share
                if beyond > 0.0:
                    is_beyond = True
                    total += 0.5 * each * beyond * beyond
            if not is_beyond:
                continue
            _write_derivatives(tree, state, places, room, torques, made)
            made.slopes[:, :] = 0.0
            near, far = hessians_out[place], hessians_out[place + 1]
            near[:, :] = 0.0
            far[:, :] = 0.0
            for j in range(nv):
                beyond = abs(torques[j]) / limits[j] - share
                if beyond <= 0.0:
                    continue
                slope, bend = each * beyond / limits[j], each / (limits[j] * limits[j])
                slope = slope if torques[j] > 0.0 else -slope
                by_u = _add_joint(j, slope, bend, state, made, near, far)
                by_times_out[0] += slope * by_u
                corner_out[0, 0] += bend * by_u * by_u
                for a in range(4):
                    for p in range(nv):
                        border_out[0, piece + a, p] += bend * by_u * bases[2, a] * made.by_points[2, j, p]
            for a in range(4):
                for p in range(nv):
                    for order in range(3):
                        gradient_out[piece + a, p] += bases[order, a] * made.slopes[order, p]
                basis_out[place, a], basis_out[place + 1, a] = bases[0, a], bases[2, a]
            pieces_out[place] = pieces_out[place + 1] = piece
            place += 2
    return total, place
