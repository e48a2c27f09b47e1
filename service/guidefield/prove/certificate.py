"""Certificates of motions: nothing touches or comes closer than asked, between samples too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.kernels.prove.questions import IN_MOTION
from guidefield.prove.curve import Curve, excesses, point_on
from guidefield.prove.search import RESOLUTION_FLOOR, Found, Goal, found_nothing, search
from guidefield.prove.verdict import LIMITS, Reason, Verdict
from guidefield.robot.model.configuration import LimitFault
from guidefield.robot.model.spaces import ChartCurves, ChartPoint


def certify(
    world: World,
    pieces: ChartCurves,
    min_clearance: float = 0.0,
    resolution: float = RESOLUTION_FLOOR,
    deadline: Deadline = UNLIMITED,
    times: np.ndarray | None = None,
) -> Verdict:
    """Judge a motion among obstacles where they are at first, or as they move.

    Everything before a refusal is certified. Whether the robot is wholly inside a closed mesh at the start is another
    question: `enclosed`. Of a piece on which a joint leaves its limits by more than `LIMITS.tolerance` nothing is
    certified, only what comes before it.

    Args:
        pieces: Bezier control points of each piece in the group's local coordinates, shape (m, k, nv) [rad or m].
        min_clearance: What robot and obstacles must keep apart [m]; the robot and itself must only not touch.
        resolution: See `RESOLUTION_FLOOR` [m].
        times: Begin of each piece, and the end of the last one, shape (m + 1,) [s]; None: obstacles rest where they are
            at first.

    Raises:
        ValueError: if a control point is not finite.
    """
    pieces = np.asarray(pieces, float)
    if not len(pieces):
        return Verdict(Reason.FREE, 0)
    knots = np.arange(len(pieces) + 1.0) if times is None else np.asarray(times, float)
    goal = Goal(min_clearance, resolution, in_time=times is not None)
    return certify_curve(world, Curve(pieces, knots), goal, deadline).verdict


def motion_free(world: World, z0: ChartPoint, z1: ChartPoint, min_clearance: float = 0.0) -> Verdict:
    """Judge the straight motion between two points, each of shape (nv,), of the local coordinates; see `certify`."""
    return certify(world, np.array([[z0, z1]]), min_clearance)


def certify_moving(
    world: World,
    pieces: ChartCurves,
    times: np.ndarray,
    min_clearance: float = 0.0,
    resolution: float = RESOLUTION_FLOOR,
    deadline: Deadline = UNLIMITED,
) -> Verdict:
    """Judge a motion (m, k, nv) among the obstacles that move alone: see `certify`; without pieces it is free."""
    pieces = np.asarray(pieces, float)
    if not len(pieces) or not world.scene.moves:
        return Verdict(Reason.FREE, 0)
    curve, goal = Curve(pieces, np.asarray(times, float)), Goal(min_clearance, resolution, IN_MOTION)
    return search(world, curve, goal, deadline).verdict


def certify_curve(world: World, curve: Curve, goal: Goal, deadline: Deadline = UNLIMITED) -> Found:
    """Judge a motion, and search what else a goal asks for; see `certify`.

    Where a joint leaves its limits, or a held object touches another body of the robot, there is a verdict alone.

    Raises:
        ValueError: if a control point is not finite.
    """
    pieces = curve.pieces
    if not np.isfinite(pieces).all():
        raise ValueError("control points have to be finite")
    if world.held_contacts:
        begin: ChartPoint = pieces[0, 0]
        return found_nothing(Verdict(Reason.CONTACT, 1, 0, 0.0, (0, 0.0), world.held_contacts[0].pair, begin))
    beyond = judge_limits(world, pieces)
    if beyond is None:
        return search(world, curve, goal, deadline)
    count, verdict = beyond.piece or 0, Verdict(Reason.FREE, 0)
    if count:
        before = Curve(pieces[:count], curve.times[: count + 1])
        verdict = search(world, before, goal._replace(spans=(), samples=np.empty(0)), deadline).verdict
    return found_nothing(replace(beyond, evaluations=verdict.evaluations) if verdict.free else verdict)


def judge_limits(world: World, pieces: ChartCurves) -> Verdict | None:
    """Return the refusal of the first piece on which a joint leaves its limits, where it is farthest beyond, or None.

    Args:
        pieces: Shape (m, k, nv) [rad or m].
    """
    group = world.group
    found, places = excesses(pieces, group.lower, group.upper)
    refused = np.flatnonzero((found > LIMITS.tolerance).any(axis=1))
    if not len(refused):
        return None
    piece = int(refused[0])
    at = int(np.argmax(found[piece]))
    parameter = float(places[piece, at])
    z = point_on(pieces[piece], parameter)
    joint = next(joint for joint in group.joints if joint.idx_v <= at < joint.idx_v + joint.nv)
    fault = LimitFault(joint.name, float(z[at]), float(group.lower[at]), float(group.upper[at]))
    return Verdict(Reason.BEYOND_LIMITS, 0, piece, parameter, (piece, 0.0), None, z, fault)
