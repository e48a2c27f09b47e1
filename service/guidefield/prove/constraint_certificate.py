"""The certificate of path constraints: kept all along a motion, between its samples too.

A Bezier curve lies in the box of its control points. While joint j turns by at most e_j about the box's middle, a frame
turns by at most sum_j e_j, and its origin moves by at most sum_j 2 sin(e_j / 2) rho_j, rho_j its distance from axis j
at the middle (`MotionBound` has the proof). That joints which move together cancel is seen beside the chord: the curve
is within r of m + s d, |s| <= 1. Integrated along the straight line from m to a point of it,

    turn <= |P J_w d| + sum_i |P J_w,i| r_i + 1/2 sum_{j < i} e_i e_j + 1/2 t^2
    move <= |Q J_v d| + sum_i |Q J_v,i| r_i + 1/2 sum_{i, j} e_i e_j R_max(i, j)

because the axis of joint i turns by at most what the joints before it turn, and the derivative of J_v,i by joint j is
the axis of the earlier joint times the column of the later one, whose length R is |J_v| at m and what the origin moves
at most; 1 for a slide. P and Q take what the constraint counts of a velocity; P turns with the frame, by t at most in
all. If the smaller of both bounds can't exceed a limit, the curve keeps it; else it is halved.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.prove.curve import halved
from guidefield.prove.verdict import CONSTRAINT_RESOLUTION, Reason, Verdict
from guidefield.robot.group.path_constraints import ConstrainedFrames
from guidefield.robot.model.spaces import ChartCurves, ChartPoints


def certify_constraints(
    frames: ConstrainedFrames, turns: np.ndarray, pieces: ChartCurves, deadline: Deadline = UNLIMITED
) -> Verdict:
    """Judge whether a motion, pieces (m, k, nv), keeps path constraints; the first place where it doesn't is told."""
    widths = np.abs(frames.group.expand_velocity)
    waiting = deque((index, 0.0, 1.0, piece) for index, piece in enumerate(np.asarray(pieces, float)))
    evaluations = 0
    while waiting:
        index, start, end, control = waiting.popleft()
        if evaluations % 64 == 0 and deadline.expired():
            return Verdict(Reason.STOPPED, evaluations, index, start, (index, start), None, control[0])
        evaluations += 1
        low, high = control.min(axis=0), control.max(axis=0)
        middle, e = 0.5 * (low + high), widths @ (0.5 * (high - low))
        chord, off = _beside_chord(control - middle)
        along, beside, placed = frames.group.expand_velocity @ chord, widths @ off, frames.placements(middle)
        reached = [
            constraint.value(place)
            + constraint.change(*_most_motion(J, constraint.project_velocity(place), turns, e, along, beside))
            for place, constraint, J in zip(placed, frames.constraints, frames.jacobians(middle), strict=True)
        ]
        if (np.array(reached) <= frames.limits).all():
            continue
        first = control[0]
        if (frames.values(first) > frames.limits).any() or (high - low).max() <= CONSTRAINT_RESOLUTION:
            return Verdict(Reason.PATH_CONSTRAINT, evaluations, index, start, (index, start), None, first)
        one, other = halved(control[None])
        half = 0.5 * (start + end)
        waiting.appendleft((index, half, end, other))
        waiting.appendleft((index, start, half, one))
    return Verdict(Reason.FREE, evaluations)


def _beside_chord(offsets: ChartPoints) -> tuple[np.ndarray, np.ndarray]:
    """Half the chord d of a curve, and how far its points are from some s d, |s| <= 1, at most."""
    chord = 0.5 * (offsets[-1] - offsets[0])
    square = float(chord @ chord)
    along = np.clip(offsets @ chord / square, -1.0, 1.0) if square > 0.0 else np.zeros(len(offsets))
    return chord, np.abs(offsets - along[:, None] * chord).max(axis=0)


def _most_motion(
    jacobian: np.ndarray,
    counted: tuple[np.ndarray, np.ndarray],
    turns: np.ndarray,
    e: np.ndarray,
    chord: np.ndarray,
    off: np.ndarray,
) -> tuple[float, float]:
    """How far a frame's origin moves, and how far the frame turns, at most along a curve from its box's middle."""
    linear, angular = np.linalg.norm(jacobian[:3], axis=0), np.linalg.norm(jacobian[3:], axis=0)
    sweep = np.where(turns, 2.0 * np.sin(0.5 * np.minimum(e, np.pi)), e)
    move, turn = float(sweep @ linear), float(e @ angular)
    own = np.where(linear + angular > 0.0, e, 0.0)
    radii, order = np.where(turns, linear + move, 1.0), np.arange(len(e))
    bent = 0.5 * float(own @ radii[np.maximum.outer(order, order)] @ own)
    twisted = 0.25 * float(turn * turn - (e * angular) @ (e * angular)) + 0.5 * turn * turn
    moved, turned = counted[0] @ jacobian[:3], counted[1] @ jacobian[3:]
    beside = float(np.linalg.norm(moved @ chord) + off @ np.linalg.norm(moved, axis=0)) + bent
    around = float(np.linalg.norm(turned @ chord) + off @ np.linalg.norm(turned, axis=0)) + twisted
    return min(move, beside), min(turn, around)
