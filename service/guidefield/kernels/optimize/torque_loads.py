"""Torques of a motion as loads, evaluated and expanded on samples: rows of `load_penalty.LoadModel`.

Sums of squares here have to be those of `load_penalty`, which Newton's method lowers. Loads lead the optimizer alone:
limits are checked by `planner/task`, on bounds.
"""

from __future__ import annotations

from guidefield.kernels.jit.arrays import Blocks, BlocksOut, Floats, IndicesOut, Row, RowOut, Rows
from guidefield.kernels.jit.decorators import kernel, uncounted
from guidefield.kernels.kinematics.forward_kinematics import joint_places
from guidefield.kernels.timing.carried_rates import CoordinateBounds, empty_bounds
from guidefield.kernels.timing.torque_derivatives import derivative_room, write_torque_derivatives
from guidefield.kernels.timing.torques import MassTree, place_tree, torque_room, write_torques


@uncounted
def write_sample(points: Floats, piece: int, step: float, bases: Floats, state: CoordinateBounds) -> None:
    """Write point, velocity and acceleration at a sample of a piece, by the bases (3, 4) there."""
    for j in range(points.shape[1]):
        z = dz = ddz = 0.0
        for a in range(4):
            z += bases[0, a] * points[piece + a, j]
            dz += bases[1, a] * points[piece + a, j]
            ddz += bases[2, a] * points[piece + a, j]
        state.z[j], state.dz[j], state.ddz[j] = z, dz / step, ddz / (step * step)


@kernel
def largest_torque_loads(
    tree: MassTree, limits: Row, points: Rows, step: float, bases: Blocks, share: float, loads_out: RowOut
) -> float:
    """Write the largest load at each sample, shape (pieces samples,); return the sum of squares beyond a share.

    The sum has to be that in `load_penalty`, which is what is minimized; so has that in `speed_loads`.

    Args:
        tree: The bodies.
        limits: Of each coordinate, shape (nv,), infinite where there is none [N m or N].
        points: Control points, shape (n, nv).
        step: Length of pieces [s].
        bases: Of samples on a piece of length 1, shape (s, 3, 4).
        share: Of limits.
        loads_out: Of the samples of each piece, one after the other.
    """
    nv, m, pieces = points.shape[1], tree.joints.sources.shape[0], points.shape[0] - 3
    n, chain = tree.joints.table.parents.shape[0], tree.chains.shape[1]
    places, state, room = joint_places(tree.joints), empty_bounds(nv, m), torque_room(n, nv, chain)
    total = 0.0
    for at in range(pieces * bases.shape[0]):
        write_sample(points, at // bases.shape[0], step, bases[at % bases.shape[0]], state)
        place_tree(tree, state, places)
        write_torques(tree, state, places, room, room.torques)
        loads_out[at] = 0.0
        for j in range(nv):
            load = abs(room.torques[j]) / limits[j]
            loads_out[at] = max(loads_out[at], load)
            total += max(load - share, 0.0) ** 2
    return total


@kernel
def expand_torque_loads(
    tree: MassTree,
    limits: Row,
    points: Rows,
    step: float,
    bases: Blocks,
    loads: Row,
    near: float,
    pieces_out: IndicesOut,
    samples_out: IndicesOut,
    values_out: RowOut,
    slopes_out: BlocksOut,
) -> int:
    """Expand loads above a share linearly; return how many there are.

    Args:
        tree, limits, points, step, bases: As of `largest_torque_loads`.
        loads: The largest at each sample.
        near: The share.
        pieces_out, samples_out, values_out, slopes_out: As in `LoadModel`, with room for all loads.
    """
    nv, m, count = points.shape[1], tree.joints.sources.shape[0], 0
    n, chain = tree.joints.table.parents.shape[0], tree.chains.shape[1]
    places, state, room = joint_places(tree.joints), empty_bounds(nv, m), torque_room(n, nv, chain)
    made = derivative_room(n, m, nv)
    for at in range(loads.shape[0]):
        if loads[at] <= near:
            continue
        write_sample(points, at // bases.shape[0], step, bases[at % bases.shape[0]], state)
        place_tree(tree, state, places)
        write_torques(tree, state, places, room, room.torques)
        write_torque_derivatives(tree, state, places, room, made)
        for j in range(nv):
            load = room.torques[j] / limits[j]
            if abs(load) <= near:
                continue
            pieces_out[count], samples_out[count] = at // bases.shape[0], at % bases.shape[0]
            rest = load
            for p in range(nv):
                for order in range(3):
                    slopes_out[count, order, p] = made.by[order, j, p] / limits[j]
                rest -= slopes_out[count, 0, p] * state.z[p] + slopes_out[count, 1, p] * state.dz[p]
                rest -= slopes_out[count, 2, p] * state.ddz[p]
            values_out[count] = rest
            count += 1
    return count
