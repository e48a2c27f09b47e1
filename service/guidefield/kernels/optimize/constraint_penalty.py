"""The penalty of a motion that leaves path constraints, by the control points of its uniform cubic B-spline.

A constraint's number is v, its limit L. Each of s samples along the motion adds

    w / (2 s) · max(v / L - room, 0)²

with the share `room` of a limit that costs nothing. Unlike the clearance it is cheap: it is looked at in each of
Newton's steps, and a motion can follow a constraint that bends.

The Hessian is Gauss and Newton's, of what is beyond. Where nothing is, a step would not know of the constraint, and
would cross a narrow tolerance at once: there a number counts as if it were beyond, times min(1, (tight / L)²).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.fields import Indices, Rows, numba_type
from guidefield.kernels.jit.signatures import BLOCKS_OUT, MATRIX, MATRIX_OUT, SCALAR, Floats, compiled, inlined
from guidefield.kernels.optimize.clearance_model import add_sample
from guidefield.kernels.tree.path_constraints import KeptFrames, measure, room_to_measure


class KeptSamples(NamedTuple):
    """Where on a motion path constraints are looked at.

    Attributes:
        frames: The constraints; none: nothing is looked at.
        pieces: (s,) piece of each sample.
        basis: (s, 4) the basis there, of the piece's four control points.
        room: Share of a limit up to which a number costs nothing.
        weight: w.
        tight: Limits up to this count in Newton's steps all through [rad or m].
    """

    frames: KeptFrames
    pieces: Indices
    basis: Rows
    room: float
    weight: float
    tight: float


KEPT_SAMPLES = numba_type(KeptSamples)


@inlined
def _write_point(kept: KeptSamples, s: int, points: Floats, z_out: Floats) -> None:
    """The chart point (nv,) at a sample."""
    k, basis = kept.pieces[s], kept.basis[s]
    for j in range(z_out.shape[0]):
        z_out[j] = basis[0] * points[k, j] + basis[1] * points[k + 1, j]
        z_out[j] += basis[2] * points[k + 2, j] + basis[3] * points[k + 3, j]


@compiled(SCALAR(KEPT_SAMPLES, MATRIX))
def constraint_penalty(kept: KeptSamples, points: Floats) -> float:
    """The penalty of a motion with control points (n, nv) [rad or m]."""
    count, total = kept.frames.kinds.shape[0], 0.0
    if count == 0:
        return total
    measured, z = room_to_measure(kept.frames), np.empty(points.shape[1])
    for s in range(kept.pieces.shape[0]):
        _write_point(kept, s, points, z)
        measure(kept.frames, z, measured)
        for c in range(count):
            beyond = max(measured.values[c] / kept.frames.limits[c] - kept.room, 0.0)
            total += beyond * beyond
    weight: float = kept.weight / kept.pieces.shape[0]
    return 0.5 * weight * total


@compiled(SCALAR(KEPT_SAMPLES, MATRIX, MATRIX_OUT, BLOCKS_OUT))
def add_constraint_penalty(kept: KeptSamples, points: Floats, gradient_out: Floats, blocks_out: Floats) -> float:
    """Add the penalty's derivatives to those of an objective.

    Args:
        kept: Where constraints are looked at.
        points: Control points, shape (n, nv) [rad or m].
        gradient_out: By these, shape (n, nv).
        blocks_out: Hessian, as in `ClearanceModel`, shape (n, nv, 4 nv).

    Returns:
        The penalty.
    """
    count, nv, total = kept.frames.kinds.shape[0], points.shape[1], 0.0
    if count == 0:
        return total
    measured, z = room_to_measure(kept.frames), np.empty(nv)
    slope, hessian, scratch = np.empty(nv), np.empty((nv, nv)), np.empty(4 * nv)
    weight: float = kept.weight / kept.pieces.shape[0]
    for s in range(kept.pieces.shape[0]):
        _write_point(kept, s, points, z)
        measure(kept.frames, z, measured)
        slope[:], hessian[:, :] = 0.0, 0.0
        for c in range(count):
            over = 1.0 / kept.frames.limits[c]
            beyond, row = max(measured.values[c] * over - kept.room, 0.0), measured.rows[c]
            total += beyond * beyond
            stiffness = over * over * (1.0 if beyond > 0.0 else min((kept.tight * over) ** 2, 1.0))
            for p in range(nv):
                slope[p] += beyond * over * row[p]
                for q in range(nv):
                    hessian[p, q] += stiffness * row[p] * row[q]
        add_sample(kept.pieces[s], kept.basis[s], weight, slope, hessian, scratch, gradient_out, blocks_out)
    return 0.5 * weight * total
