"""The angles of a chain of ball or universal joints whose joints stand at given places."""

from __future__ import annotations

import math

import numpy as np
from numba import types

from guidefield.kernels.jit.signatures import BLOCKS, BLOCKS_OUT, MATRIX, VECTOR, VECTOR_OUT, Floats, compiled, inlined
from guidefield.kernels.kinematics.forward_kinematics import axis_rotation, quaternion_of
from guidefield.kernels.kinematics.link_chain import CHAIN, FREE, UNIVERSAL, LinkChain, rotated


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
    """The smallest rotation that turns the direction of a into that of b."""
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
    """The same angle within half a turn of another [rad]."""
    return angle + 2.0 * math.pi * math.floor((old - angle) / (2.0 * math.pi) + 0.5)


@inlined
def _bend(chain: LinkChain, k: int, wanted: Floats, old: Floats, scratch: Floats, angles_out: Floats) -> bool:
    """Angles of universal joint k that point its link along `wanted` (3,), in the joint's frame; near the old ones.

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


@compiled(types.boolean(CHAIN, MATRIX, VECTOR, BLOCKS, VECTOR_OUT, BLOCKS_OUT))
def chain_configuration(
    chain: LinkChain, joints: Floats, q: Floats, rotations: Floats, q_out: Floats, rotations_out: Floats
) -> bool:
    """The configuration near q whose joints stand at given places; links turn the least, spin is carried along.

    Args:
        chain: The chain.
        joints: Places of joints, a link's length apart, shape (n + 1, 3) [m, world].
        q: Configuration to be near to, shape (nq,).
        rotations: Of the links in the world, at q, shape (n, 3, 3).
        q_out: Shape (nq,).
        rotations_out: Of the links in the world, at q_out, shape (n, 3, 3).

    Returns:
        Whether there is one: a universal joint can't point everywhere if its axes aren't square to its link.
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
