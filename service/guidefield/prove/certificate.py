"""Certificates of motions: nothing touches or comes too close, path constraints are kept; smallest distances.

Pairs of bodies are searched by `search.py`, path constraints bounded here, as docs/certificate.md says. The distances,
confirmed by Coal, are those of replies (`planner/quality.py`), which `handlers/agreement.py` checks by the same search.

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

So every term has to stay an upper bound; `DEPTHS`, from 2 on, changes time, and in contact depths, pairs and means.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.kernels.collide.gjk import ACCURACY, SLACK
from guidefield.kernels.prove.tables import IN_MOTION, NEARLY
from guidefield.prove.closest import ClosestPairs, put_obstacle
from guidefield.prove.curve import Curve, excesses, halve_curves, point_on
from guidefield.prove.search import (
    RESOLUTION_FLOOR,
    ContradictionError,
    SearchQuery,
    SearchResult,
    Smallest,
    search,
    without_distances,
)
from guidefield.prove.tables import arithmetic_error
from guidefield.prove.verdict import CONSTRAINT_RESOLUTION, LIMIT_TOLERANCE, Reason, Verdict, with_coal_error
from guidefield.robot.group.path_constraints import ConstrainedFrames
from guidefield.robot.model.configuration import LimitFault
from guidefield.robot.model.joints import LocalCurves, LocalPoint, LocalPoints


def certify_constraints(
    frames: ConstrainedFrames,
    turns: np.ndarray,
    pieces: LocalCurves,
    deadline: Deadline = UNLIMITED,
    tube: np.ndarray | None = None,
) -> Verdict:
    """Check that a motion, pieces (m, k, nv), keeps path constraints within the tube (m, nv) about it.

    The verdict tells the first place where it doesn't.
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
        beyond = 0.0 if tube is None else tube[index]
        middle, e = 0.5 * (low + high), widths @ (0.5 * (high - low) + beyond)
        chord, off = _beside_chord(control - middle)
        along, beside, placed = frames.group.expand_velocity @ chord, widths @ (off + beyond), frames.placements(middle)
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
        one, other = halve_curves(control[None])
        half = 0.5 * (start + end)
        waiting.appendleft((index, half, end, other))
        waiting.appendleft((index, start, half, one))
    return Verdict(Reason.FREE, evaluations)


def _beside_chord(offsets: LocalPoints) -> tuple[np.ndarray, np.ndarray]:
    """Return half the chord d of a curve, and a bound on how far its points are from some s d, |s| <= 1."""
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
    """Bound how far a frame's origin moves, and how far the frame turns, along a curve from its box's middle."""
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


def certify(
    world: World,
    pieces: LocalCurves,
    min_clearance: float = 0.0,
    resolution: float = RESOLUTION_FLOOR,
    deadline: Deadline = UNLIMITED,
    times: np.ndarray | None = None,
    tube: np.ndarray | None = None,
) -> Verdict:
    """Certify a motion among obstacles where they are at first, or as they move.

    Everything before a refusal is certified. Whether the robot is wholly inside a closed mesh at the start has to be
    tested besides, by `collision.clearance.find_enclosed_pair`. A piece on which a joint leaves its limits by more than
    `LIMIT_TOLERANCE` is refused from its beginning.

    Args:
        pieces: Bezier control points of each piece in the group's local coordinates, shape (m, k, nv) [rad or m].
        min_clearance: What robot and obstacles must keep apart [m]; the robot and itself must only not touch.
        resolution: See `RESOLUTION_FLOOR` [m].
        times: Begin of each piece, and the end of the last one, shape (m + 1,) [s]; None: obstacles rest where they are
            at first.
        tube: Half widths about each piece in which the robot is, shape (m, nv) [rad or m]; None: it is on the curve.
            Limits of joints are tested for the curve alone.

    Raises:
        ValueError: if a control point is not finite.
    """
    pieces = np.asarray(pieces, float)
    if not len(pieces):
        return Verdict(Reason.FREE, 0)
    knots = np.arange(len(pieces) + 1.0) if times is None else np.asarray(times, float)
    goal = SearchQuery(min_clearance, resolution, in_time=times is not None)
    return certify_curve(world, Curve(pieces, knots, tube), goal, deadline).verdict


def motion_free(world: World, z0: LocalPoint, z1: LocalPoint, min_clearance: float = 0.0) -> Verdict:
    """Certify the straight motion between two points (nv,) in local coordinates; see `certify`."""
    return certify(world, np.array([[z0, z1]]), min_clearance)


def certify_moving(
    world: World,
    pieces: LocalCurves,
    times: np.ndarray,
    min_clearance: float = 0.0,
    resolution: float = RESOLUTION_FLOOR,
    deadline: Deadline = UNLIMITED,
) -> Verdict:
    """Certify a motion (m, k, nv) among moving obstacles only: see `certify`; without pieces it is free."""
    pieces = np.asarray(pieces, float)
    if not len(pieces) or not world.scene.moves:
        return Verdict(Reason.FREE, 0)
    curve, goal = Curve(pieces, np.asarray(times, float)), SearchQuery(min_clearance, resolution, IN_MOTION)
    return search(world, curve, goal, deadline).verdict


def certify_curve(world: World, curve: Curve, goal: SearchQuery, deadline: Deadline = UNLIMITED) -> SearchResult:
    """Certify a motion, and search what else a query asks for; see `certify`.

    Where a joint leaves its limits, or a held object touches another body of the robot, there is a verdict alone.

    Raises:
        ValueError: if a control point is not finite.
    """
    pieces = curve.pieces
    if not np.isfinite(pieces).all():
        raise ValueError("control points have to be finite")
    if world.held_contacts:
        begin: LocalPoint = pieces[0, 0]
        return without_distances(Verdict(Reason.CONTACT, 1, 0, 0.0, (0, 0.0), world.held_contacts[0].pair, begin))
    beyond = judge_limits(world, pieces)
    if beyond is None:
        return search(world, curve, goal, deadline)
    count, verdict = beyond.piece or 0, Verdict(Reason.FREE, 0)
    if count:
        verdict = search(world, curve.up_to(count), goal._replace(spans=(), samples=np.empty(0)), deadline).verdict
    return without_distances(replace(beyond, evaluations=verdict.evaluations) if verdict.free else verdict)


def judge_limits(world: World, pieces: LocalCurves) -> Verdict | None:
    """Return the refusal of the first piece on which a joint leaves its limits, where it is farthest beyond, or None.

    Args:
        pieces: Shape (m, k, nv) [rad or m].
    """
    group = world.group
    found, places = excesses(pieces, group.lower, group.upper)
    refused = np.flatnonzero((found > LIMIT_TOLERANCE).any(axis=1))
    if not len(refused):
        return None
    piece = int(refused[0])
    at = int(np.argmax(found[piece]))
    parameter = float(places[piece, at])
    z = point_on(pieces[piece], parameter)
    joint = next(joint for joint in group.joints if joint.idx_v <= at < joint.idx_v + joint.nv)
    fault = LimitFault(joint.name, float(z[at]), float(group.lower[at]), float(group.upper[at]))
    return Verdict(Reason.BEYOND_LIMITS, 0, piece, parameter, (piece, 0.0), None, z, fault)


DEPTHS = 4  # most samples in contact at which the depth is measured: with more it may be found larger, and takes longer


def smallest_along(
    world: World,
    curve: Curve,
    samples: np.ndarray,
    spans: Sequence[tuple[float, float]],
    min_clearance: float | None = None,
    deadline: Deadline = UNLIMITED,
) -> SearchResult:
    """Find the smallest distances along a motion among obstacles in time.

    They are at most `search.TOLERANCE` too large; Coal confirms each where it is. In contact it is the signed distance
    at the worst of where contact was found and `DEPTHS` samples in contact with obstacles, first and last included.

    Args:
        samples: In order, the ends of the motion among them, shape (k,) [s].
        spans: Begin and end of each span in which the smallest distance is searched, the whole motion first [s].
        min_clearance: Clearance of a verdict, see `SearchQuery` [m]; None: no verdict is needed.

    Raises:
        ContradictionError: if Coal measures another distance where one is smallest.
    """
    found = search(world, curve, SearchQuery(min_clearance, spans=spans, samples=samples), deadline)
    return confirm(world, curve, samples, spans, found)


def confirm(
    world: World, curve: Curve, samples: np.ndarray, spans: Sequence[tuple[float, float]], found: SearchResult
) -> SearchResult:
    """Have Coal confirm what a search found, and measure depths in contact; see `smallest_along`."""
    _confirm(world, curve, {(one.time, one.pair): one for one in (*found.obstacle, found.own)})
    if min((one.distance for one in (*found.obstacle, found.own)), default=np.inf) > NEARLY:
        return found
    return _with_depths(world, curve, samples, spans, found)


def _confirm(world: World, curve: Curve, answers: Mapping[tuple[float, int], Smallest]) -> None:
    """Have Coal measure the pair of each answer without contact where it is smallest; keys are time and pair."""
    error = arithmetic_error(world) + SLACK + ACCURACY
    apart = [one for one in answers.values() if one.pair >= 0 and one.distance > NEARLY]
    for one, z in zip(apart, curve.at(np.array([one.time for one in apart])), strict=True):
        world.place(world.group.expand_from_local(z))
        put_obstacle(world, one.pair, one.time)
        off = error + with_coal_error(one.distance) - one.distance
        measured, _ = world.distance(one.pair, one.distance + 2.0 * off)  # whatever is farther contradicts it
        if abs(measured - one.distance) > off:
            measured, _ = world.distance(one.pair)
        if abs(measured - one.distance) > off:
            first, second = world.pair_names(one.pair)
            raise ContradictionError(
                f"the search has {first} and {second} {1000 * one.distance:.6g} mm apart at {one.time:.6g} s, Coal has"
                f" {1000 * measured:.6g} mm",
                (world, curve, 0.0),
            )


def _with_depths(
    world: World, curve: Curve, samples: np.ndarray, spans: Sequence[tuple[float, float]], found: SearchResult
) -> SearchResult:
    """Return what was found with Coal's signed distances at places of contact and some of the samples in contact."""
    touching = np.flatnonzero(found.distances <= NEARLY)
    some = touching[np.unique(np.linspace(0, len(touching) - 1, DEPTHS).astype(int))] if len(touching) else touching
    contact_times = [one.time for one in (*found.obstacle, found.own) if one.distance <= NEARLY]
    times = np.unique(np.concatenate([samples[some], contact_times]))
    touches_itself = found.own.distance <= NEARLY
    qs = world.group.expand_each(curve.at(times))
    measured = list(ClosestPairs(world).clearances(qs, times, counts_own=touches_itself))
    obstacle_depths = [(one.obstacle_distance, one.pairs[1]) for one in measured]
    own_depths = [(one.self_distance, one.pairs[0]) for one in measured]

    def deepest(one: Smallest, span: tuple[float, float], depths: list[tuple[float, int]]) -> Smallest:
        within = [
            (distance, time, pair)
            for time, (distance, pair) in zip(times.tolist(), depths, strict=True)
            if span[0] <= time <= span[1] and pair >= 0
        ]
        if one.distance > NEARLY or not within or (worst := min(within))[0] > one.distance:
            return one
        return replace(one, distance=worst[0], bound=min(worst[0], one.bound), time=worst[1], pair=worst[2])

    obstacle = [deepest(one, span, obstacle_depths) for one, span in zip(found.obstacle, spans, strict=True)]
    distances = found.distances.copy()
    distances[some] = [obstacle_depths[row][0] for row in np.searchsorted(times, samples[some]).tolist()]
    return replace(found, obstacle=obstacle, own=deepest(found.own, spans[0], own_depths), distances=distances)
