"""A chain of ball or universal joints as the places of its joints: closing it, the force on its end, its angles.

Joints stand at J_0 .. J_n, link k runs from J_{k-1} to J_k, l_k = J_k - J_{k-1}. Places don't tell a link's spin about
itself: `chain_configuration` leaves it as it is. `robot/group/link_chain.py` makes the table,
`guide/coordinate_descent.py` descends by it. `_CLOSING_ROUNDS` and `_LARGEST_TURN` change which steps a descent
finds, each of which is tested for collision as all motions are. That the tip stays on its guide plane rests on
`_CLOSED`: nothing tests it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import (
    Blocks,
    BlocksOut,
    Floats,
    IndexRows,
    Indices,
    Row,
    RowOut,
    Rows,
    RowsOut,
    numba_type,
)
from guidefield.kernels.jit.decorators import inlined, kernel
from guidefield.kernels.kinematics.forward_kinematics import axis_rotation, quaternion_of
from guidefield.kernels.linalg.small_systems import solve_three

BALL, FREE, UNIVERSAL = range(3)  # kinds of joints of a chain; FREE is the first of a chain that nothing holds
_CLOSED = 1e-7  # by how much a closed chain may miss its target [m]; far below `ON_PLANE` (guide/rounds.py), at size 1
_CLOSING_ROUNDS = 12  # of Newton's method; after them a chain counts as one that can't be closed
_LARGEST_TURN = 0.4  # no link turns more than this in a round of closing [rad]


class LinkChain(NamedTuple):
    """A chain of links."""

    kinds: Indices  # (n,) what joins link k to the one before
    at: IndexRows  # (n, 2) where the joint's values stand in a configuration; of a universal joint both angles
    frames: Blocks  # (n, 3, 3) rotation of the joint in the frame of the link before (of the first: in the world)
    origin: Row  # (3,) place of the first joint, as it stands without translation [m]
    links: Rows  # (n, 3) each link from its joint to the next, in its own frame [m]
    # first_axes, second_axes: (n, 3) of universal joints, each in the frame of its own revolute joint
    first_axes: Rows
    second_axes: Rows
    between: Blocks  # (n, 3, 3) of universal joints, rotation of the second revolute joint in the first one's frame
    circling: IndexRows  # (n, 2) 1 where such a revolute joint is continuous: cosine and sine stand for its angle


CHAIN = numba_type(LinkChain)


@inlined
def rotated(R: Floats, v: Floats, out: Floats) -> None:
    """Product of a matrix, shape (3, 3), and a vector, shape (3,), into `out`, shape (3,)."""
    for r in range(3):
        out[r] = R[r, 0] * v[0] + R[r, 1] * v[1] + R[r, 2] * v[2]


@inlined
def _ridge(N: Floats) -> float:
    """Return what is added to the diagonal of N, which is singular where all links are on one line."""
    return float(1e-12 * (N[0, 0] + N[1, 1] + N[2, 2]))


@inlined
def _turn_link(link: Floats, wx: float, wy: float, wz: float, scratch: Floats, turned: Floats) -> None:
    angle = math.sqrt(wx * wx + wy * wy + wz * wz)
    if angle > 0.0:
        axis_rotation(wx / angle, wy / angle, wz / angle, math.cos(angle), math.sin(angle), scratch)
        rotated(scratch, link, turned)
        link[0], link[1], link[2] = turned[0], turned[1], turned[2]


@inlined
def _add_closing(link: Floats, N: Floats) -> None:
    """Add |l|^2 I - l l^T."""
    square = link[0] * link[0] + link[1] * link[1] + link[2] * link[2]
    for r in range(3):
        for c in range(3):
            N[r, c] += (square if r == c else 0.0) - link[r] * link[c]


@kernel
def close_chain(joints_out: RowsOut, m: int, target: Row) -> bool:
    """Bring J_m to a place (3,) by the least sum of squared turns of links 1..m; tell whether that closes the chain.

    J_0 stays, J_{m+1}.. aren't read, `joints_out` (n + 1, 3) [m]. omega_i = l_i x lambda, lambda = N^-1 e, N =
    sum(|l_i|^2 I - l_i l_i^T), e what is missing; until it is closed.
    """
    links = np.empty((m, 3))
    N, scratch = np.empty((3, 3)), np.empty((3, 3))
    missing, multiplier, turned = np.empty(3), np.empty(3), np.empty(3)
    for i in range(m):
        for c in range(3):
            links[i, c] = joints_out[i + 1, c] - joints_out[i, c]
    for _ in range(_CLOSING_ROUNDS):
        N[:, :] = 0.0
        for c in range(3):
            missing[c] = target[c] - joints_out[0, c]
        for i in range(m):
            for c in range(3):
                missing[c] -= links[i, c]
            _add_closing(links[i], N)
        if missing[0] ** 2 + missing[1] ** 2 + missing[2] ** 2 < _CLOSED * _CLOSED:
            for i in range(m):
                for c in range(3):
                    joints_out[i + 1, c] = joints_out[i, c] + links[i, c]
            return True
        solve_three(N, _ridge(N), missing, multiplier)
        x, y, z = multiplier[0], multiplier[1], multiplier[2]
        for i in range(m):
            link = links[i]
            wx, wy, wz = link[1] * z - link[2] * y, link[2] * x - link[0] * z, link[0] * y - link[1] * x
            angle = math.sqrt(wx * wx + wy * wy + wz * wz)
            scale = min(1.0, _LARGEST_TURN / angle) if angle > 0.0 else 1.0
            _turn_link(link, scale * wx, scale * wy, scale * wz, scratch, turned)
    return False


@kernel
def end_force(joints: Rows, forces: Rows, torques: Rows, m: int, force_out: RowOut) -> None:
    """Write the force f (3,) at J_m that does the work of all on links 1..m as J_m moves and `close_chain` follows.

    Q_i = tau_i + l_i x sum_{i<j<=m} F_j, f = N^-1 sum Q_i x l_i; `joints` (n + 1, 3) [m], forces F (n, 3) on links,
    torques tau (n, 3) of forces on link k about J_{k-1}.
    """
    N, work, link = np.zeros((3, 3)), np.zeros(3), np.empty(3)
    fx, fy, fz = 0.0, 0.0, 0.0
    for i in range(m - 1, -1, -1):
        for c in range(3):
            link[c] = joints[i + 1, c] - joints[i, c]
        qx = torques[i, 0] + link[1] * fz - link[2] * fy
        qy = torques[i, 1] + link[2] * fx - link[0] * fz
        qz = torques[i, 2] + link[0] * fy - link[1] * fx
        work[0] += qy * link[2] - qz * link[1]
        work[1] += qz * link[0] - qx * link[2]
        work[2] += qx * link[1] - qy * link[0]
        fx, fy, fz = fx + forces[i, 0], fy + forces[i, 1], fz + forces[i, 2]
        _add_closing(link, N)
    solve_three(N, _ridge(N), work, force_out)


@kernel
def turn_from(joints: Rows, k: int, axis: Row, angle: float, joints_out: RowsOut) -> None:
    """Turn link k, from 1, about its joint J_{k-1} and a unit axis (3,); the links behind it are carried along.

    Places of joints before and after have the shape (n + 1, 3) [m]; those links don't turn.
    """
    link, turned, scratch = np.empty(3), np.empty(3), np.empty((3, 3))
    for c in range(3):
        link[c] = joints[k, c] - joints[k - 1, c]
    axis_rotation(axis[0], axis[1], axis[2], math.cos(angle), math.sin(angle), scratch)
    rotated(scratch, link, turned)
    for i in range(joints.shape[0]):
        for c in range(3):
            joints_out[i, c] = joints[i, c] + (turned[c] - link[c] if i >= k else 0.0)


@kernel
def turn_towards(joints: Rows, k: int, axis: Row, angle: float, joints_out: RowsOut) -> bool:
    """Turn link k, from 2, about its far end J_k; those before it are closed on its near end, those beyond stay.

    Of link 2 the near end can only circle about the line from J_0 to J_2, whatever `axis` says. Returns whether it
    closes; arguments are those of `turn_from`.
    """
    pivot = 0 if k == 2 else k
    link, turned, scratch, target = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty(3)
    x, y, z = axis[0], axis[1], axis[2]
    if k == 2:
        x, y, z = joints[2, 0] - joints[0, 0], joints[2, 1] - joints[0, 1], joints[2, 2] - joints[0, 2]
        length = math.sqrt(x * x + y * y + z * z)
        if length < 1e-9:
            return False
        x, y, z = x / length, y / length, z / length
    axis_rotation(x, y, z, math.cos(angle), math.sin(angle), scratch)
    for c in range(3):
        link[c] = joints[k - 1, c] - joints[pivot, c]
    rotated(scratch, link, turned)
    for i in range(joints.shape[0]):
        for c in range(3):
            joints_out[i, c] = joints[i, c]
    for c in range(3):
        target[c] = joints[pivot, c] + turned[c]
    if k == 2:
        for c in range(3):
            joints_out[1, c] = target[c]
        return True
    return close_chain(joints_out, k - 1, target)


@inlined
def _product(A: Floats, B: Floats, out: Floats) -> None:
    for r in range(3):
        for c in range(3):
            out[r, c] = A[r, 0] * B[0, c] + A[r, 1] * B[1, c] + A[r, 2] * B[2, c]


@inlined
def _transposed_product(A: Floats, B: Floats, out: Floats) -> None:
    for r in range(3):
        for c in range(3):
            out[r, c] = A[0, r] * B[0, c] + A[1, r] * B[1, c] + A[2, r] * B[2, c]


@inlined
def _least_turn(a: Floats, b: Floats, rotation_out: Floats) -> None:
    """The smallest rotation that turns the direction of a into that of b; the identity if they are opposite."""
    la = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    lb = math.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2])
    over = 1.0 / (la * lb)
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    s = over * math.sqrt(x * x + y * y + z * z)
    c = over * (a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
    if s > 0.0:
        scale = over / s
        axis_rotation(scale * x, scale * y, scale * z, c, s, rotation_out)
    else:
        axis_rotation(1.0, 0.0, 0.0, 1.0, 0.0, rotation_out)


@inlined
def _dot(a: Floats, b: Floats) -> float:
    value: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return value


@inlined
def _angle_about(axis: Floats, a: Floats, b: Floats) -> float:
    """Angle about an axis from a to b, both seen along it [rad]."""
    cx, cy, cz = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    across = axis[0] * cx + axis[1] * cy + axis[2] * cz
    return math.atan2(across, _dot(a, b) - _dot(axis, a) * _dot(axis, b))


@inlined
def _near(angle: float, old: float) -> float:
    return angle + 2.0 * math.pi * math.floor((old - angle) / (2.0 * math.pi) + 0.5)


@inlined
def _bend(chain: LinkChain, k: int, wanted: Floats, old: Floats, scratch: Floats, angles_out: Floats) -> bool:
    """Write the angles of universal joint k, near the old ones, that point its link along `wanted` in its frame.

    Rot(a1, alpha) B Rot(a2, beta) link = wanted: the share of both sides along a1 gives beta, then alpha follows.
    """
    a1, a2, B, link = chain.first_axes[k], chain.second_axes[k], chain.between[k], chain.links[k]
    n = np.empty(3)
    for c in range(3):
        n[c] = B[0, c] * a1[0] + B[1, c] * a1[1] + B[2, c] * a1[2]
    along = _dot(a2, link)
    # n . Rot(a2, beta) link = cosine cos(beta) + sine sin(beta) + constant
    constant = along * _dot(n, a2)
    cosine = _dot(n, link) - constant
    sine = (
        n[0] * (a2[1] * link[2] - a2[2] * link[1])
        + n[1] * (a2[2] * link[0] - a2[0] * link[2])
        + n[2] * (a2[0] * link[1] - a2[1] * link[0])
    )
    amplitude = math.sqrt(cosine * cosine + sine * sine)
    share = _dot(a1, wanted) - constant
    if amplitude < 1e-12 or abs(share) > amplitude * (1.0 + 1e-9):
        return False
    phase, spread = math.atan2(sine, cosine), math.acos(min(max(share / amplitude, -1.0), 1.0))
    best = math.inf
    turned, pointed = np.empty(3), np.empty(3)
    for sign in (1.0, -1.0):
        beta = _near(phase + sign * spread, old[1])
        axis_rotation(a2[0], a2[1], a2[2], math.cos(beta), math.sin(beta), scratch)
        rotated(scratch, link, turned)
        rotated(B, turned, pointed)
        alpha = _near(_angle_about(a1, pointed, wanted), old[0])
        change = abs(alpha - old[0]) + abs(beta - old[1])
        if change < best:
            best = change
            angles_out[0], angles_out[1] = alpha, beta
    return True


@inlined
def _set_angle(angle: float, at: int, circling: int, q_out: Floats) -> None:
    if circling == 1:
        q_out[at], q_out[at + 1] = math.cos(angle), math.sin(angle)
    else:
        q_out[at] = angle


@inlined
def _angle(q: Floats, at: int, circling: int) -> float:
    return math.atan2(q[at + 1], q[at]) if circling == 1 else q[at]


@kernel
def chain_configuration(
    chain: LinkChain, joints: Rows, q: Row, rotations: Blocks, q_out: RowOut, rotations_out: BlocksOut
) -> bool:
    """Find the configuration near q (nq,) whose joints stand at given places (n + 1, 3) [m]; links turn the least.

    Links keep their spin: `rotations` (n, 3, 3) are theirs in the world at q, `rotations_out` at `q_out`. Returns False
    if there is none: a universal joint can't point everywhere if its axes aren't square to its link.
    """
    n = chain.kinds.shape[0]
    world, relative, turn, scratch = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    before, after, wanted, old, angles = np.empty(3), np.empty(3), np.empty(3), np.empty(2), np.empty(2)
    for c in range(q.shape[0]):
        q_out[c] = q[c]
    for k in range(n):
        if k == 0:
            world[:, :] = chain.frames[0]
        else:
            _product(rotations_out[k - 1], chain.frames[k], world)
        for c in range(3):
            after[c] = joints[k + 1, c] - joints[k, c]
        at = chain.at[k, 0]
        if chain.kinds[k] == UNIVERSAL:
            for c in range(3):
                wanted[c] = world[0, c] * after[0] + world[1, c] * after[1] + world[2, c] * after[2]
            old[0], old[1] = _angle(q, at, chain.circling[k, 0]), _angle(q, chain.at[k, 1], chain.circling[k, 1])
            if not _bend(chain, k, wanted, old, scratch, angles):
                return False
            _set_angle(angles[0], at, chain.circling[k, 0], q_out)
            _set_angle(angles[1], chain.at[k, 1], chain.circling[k, 1], q_out)
            axis = chain.first_axes[k]
            axis_rotation(axis[0], axis[1], axis[2], math.cos(angles[0]), math.sin(angles[0]), scratch)
            _product(world, scratch, turn)
            _product(turn, chain.between[k], relative)
            axis = chain.second_axes[k]
            axis_rotation(axis[0], axis[1], axis[2], math.cos(angles[1]), math.sin(angles[1]), scratch)
            _product(relative, scratch, rotations_out[k])
            continue
        rotated(rotations[k], chain.links[k], before)
        _least_turn(before, after, turn)
        _product(turn, rotations[k], rotations_out[k])
        if chain.kinds[k] == FREE:
            for c in range(3):
                wanted[c] = joints[0, c] - chain.origin[c]
            for c in range(3):
                q_out[at + c] = world[0, c] * wanted[0] + world[1, c] * wanted[1] + world[2, c] * wanted[2]
            at += 3
        _transposed_product(world, rotations_out[k], relative)
        quaternion_of(relative, q_out, at)
    return True
