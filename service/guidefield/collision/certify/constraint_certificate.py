"""The certificate of path constraints: kept all along a motion, between its samples too.

A Bezier curve lies in the box of its control points. While joint j turns by at most e_j about the box's middle, a frame
turns by at most sum_j e_j, and its origin moves by at most sum_j 2 sin(e_j / 2) rho_j, rho_j its distance from axis j
at the middle (`MotionBound` has the proof). Where that can't exceed a limit the curve keeps it; else it is halved.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from guidefield.collision.certify.curve_segments import halved
from guidefield.collision.certify.settings import CERTIFICATE
from guidefield.collision.certify.verdict import Reason, Verdict
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.robot.group.path_constraints import ConstrainedFrames
from guidefield.robot.model.spaces import ChartCurves


def certify_constraints(
    frames: ConstrainedFrames, turns: np.ndarray, pieces: ChartCurves, deadline: Deadline = UNLIMITED
) -> Verdict:
    """Judge whether a motion keeps path constraints; the first place where it doesn't, along the motion, is told.

    Args:
        frames: The constraints.
        turns: Whether a joint turns rather than slides, shape (nv of the model,).
        pieces: Bezier control points in the group's chart, shape (m, k, nv) [rad or m]; joints of one coordinate.
        deadline: Ends the judgement.
    """
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
        sweep = np.where(turns, 2.0 * np.sin(0.5 * np.minimum(e, np.pi)), e)
        values = frames.values(middle)
        jacobians = frames.jacobians(middle)
        reached = [
            value
            + constraint.change(float(sweep @ np.linalg.norm(J[:3], axis=0)), float(e @ np.linalg.norm(J[3:], axis=0)))
            for value, constraint, J in zip(values, frames.constraints, jacobians, strict=True)
        ]
        if (np.array(reached) <= frames.limits).all():
            continue
        first = control[0]
        if (frames.values(first) > frames.limits).any() or (high - low).max() <= CERTIFICATE.constraint_floor:
            return Verdict(Reason.PATH_CONSTRAINT, evaluations, index, start, (index, start), None, first)
        one, other = halved(control[None])
        half = 0.5 * (start + end)
        waiting.appendleft((index, half, end, other))
        waiting.appendleft((index, start, half, one))
    return Verdict(Reason.FREE, evaluations)
