"""Replies held against the findings of the sampling judge: each contradiction is a disagreement."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from doubting.curve import COORDINATES, Curve, split_columns
from doubting.judge import Judge, Nearest, Sampled
from doubting.limits import RATES, Standing, standing
from doubting.loaded import Loaded, as_values
from doubting.shapes import se3
from guidefield.messages.replies import CertifyReply, PlanReply
from guidefield.messages.requests import (
    CertifyRequest,
    GuidePlaneGoal,
    JointsGoal,
    OrientationCone,
    PathConstraint,
    PlaneConstraint,
    PlanRequest,
    PoseGoal,
)
from guidefield.messages.values import Placement
from guidefield.robot.model.joints import JointKind

CLOSER = 2e-6
"""A pair that is closer than required by more than this is no free pair [m]."""
OFF = 1e-4
"""A figure may be off by this, times the robot's size [m]."""
BEYOND = 1e-9
"""A joint may be beyond its limit by this [rad or m], a share of a limit off by it."""
FLOOR = 3e-5
"""Pairs that can't be told apart are that close at least [m]."""
LEFT = 1.1e-3
"""A contact at the start has been left from this distance on [m]."""
REACHED = 1e-6
"""The tip may be beyond its goal's tolerance by this [m or rad]."""
END = 0.31
"""At each end so much of the way is left out of the inner clearance, and a little more [rad, or m at size 1]."""
KEPT = 1e-6
"""A share of a rate's limit is kept up to this above 1."""


class Kind(enum.StrEnum):
    """The kinds of disagreement."""

    FALSE_CERTIFICATE = "certified, but not free"
    FALSE_REFUSAL = "refused, but free"
    FIGURE = "a figure is off"
    LIMIT = "a limit is exceeded, or is told wrongly"
    ENDS = "it doesn't begin or end where it should"
    MEASURE = "Coal and another algorithm measure different distances"
    CRASH = "the request failed with a bug"
    PROOF = "a proof doesn't hold, or one holds that is false"


@dataclass(frozen=True)
class Disagreement:
    """A contradiction, as a sentence."""

    kind: Kind
    said: str


def judge_of(loaded: Loaded, request: PlanRequest | CertifyRequest, planned: frozenset[str]) -> Judge:
    """The judge of what a request is about."""
    return loaded.judge(
        planned,
        placement=request.robot_placement,
        obstacles=request.scene.obstacles,
        attached=request.attached_objects,
        allowed=frozenset(frozenset(pair) for pair in request.allowed_collisions),
        min_clearance=request.min_clearance,
        still=as_values(request.start),
    )


def continuous(loaded: Loaded) -> list[str]:
    """Joints that go the shorter way between rows."""
    return [joint.name for joint in loaded.model.joints if joint.kind is JointKind.CONTINUOUS]


def names_of(names: list[str]) -> frozenset[str]:
    """The joints that columns are of."""
    return frozenset(joint for joint, _ in split_columns(names))


def planned_curve(reply: PlanReply) -> Curve | None:
    """The curve of a plan's trajectory; of its partial path if it failed; None if it has neither."""
    if reply.trajectory is not None:
        one = reply.trajectory
        return Curve.of(reply.position_names, one.positions, one.times, one.velocities)
    if reply.path:
        return Curve.of(reply.position_names, reply.path)
    return None


def asked_curve(loaded: Loaded, request: CertifyRequest) -> Curve:
    """The curve that a certify request is about."""
    turning = continuous(loaded)
    names, order = ordered(loaded, request.position_names)
    if request.trajectory is None:
        return Curve.of(names, [[row[k] for k in order] for row in request.path], continuous=turning)
    given = request.trajectory
    positions, velocities = [[row[k] for k in order] for row in given.positions], None
    if given.velocities is not None:
        rates = ordered(loaded, request.velocity_names)[1]
        velocities = [[row[k] for k in rates] for row in given.velocities]
    step = request.time_step or 0.0
    times = [k * step for k in range(len(given.positions))] if given.times is None else given.times
    spline = given.velocities is None and request.interpolation == "spline"
    return Curve.of(names, positions, times, velocities, continuous=turning, spline=spline)


def ordered(loaded: Loaded, names: list[str]) -> tuple[list[str], list[int]]:
    """Columns in the order of the robot's joints and their coordinates: the names, and where they stood."""
    joints = {joint.name: k for k, joint in enumerate(loaded.model.joints)}
    parts = split_columns(names)
    order = sorted(range(len(names)), key=lambda k: (joints[parts[k][0]], COORDINATES.index(parts[k][1])))
    return [names[k] for k in order], order


def covered_from(covers: str, curve: Curve) -> float:
    """Since when a certificate holds, as it says: the beginning, or "after 0.5 s"."""
    _, _, after = covers.partition(" after ")
    if not after:
        return float(curve.times[0])
    if after.startswith("row "):
        return time_of(curve, float(after.removeprefix("row ")))
    return float(after.removesuffix(" s"))


def about_plan(
    loaded: Loaded, request: PlanRequest, reply: PlanReply, judge: Judge
) -> tuple[list[Disagreement], Sampled | None]:
    """Return what contradicts a plan's reply, and what was sampled along its motion."""
    found: list[Disagreement] = []
    curve = planned_curve(reply)
    found += _about_ends(request, reply, judge)
    if curve is None or request.sample_rate is not None:
        return found, None
    free = reply.certificate.collision_free
    if reply.trajectory is None:
        curve_free = free and reply.certificate.covers == "path"
        if not curve_free or judge.moves:
            return found, None
        sampled = judge.along_all(curve)
        return found + _certified(judge, curve, sampled), None
    sampled = judge.along_all(curve, covered_from(reply.certificate.covers, curve))
    at = standing(loaded, request, curve)
    if free:
        found += _certified(judge, curve, sampled) + _constraints(judge, curve, request.path_constraints)
        if at.excess > BEYOND:
            found.append(Disagreement(Kind.LIMIT, f"certified, but {at.joint} is {at.excess:.3g} beyond its limit"))
    if reply.status.name == "SUCCESS":
        for rate, share in at.shares.items():
            if share > 1.0 + BEYOND + at.noise[rate]:
                found.append(Disagreement(Kind.LIMIT, f"a {rate} is {share:.12g} of its limit"))
        found += _reached(request, reply) + _metrics(reply, curve) + _at_goal(judge, request, curve)
    if " after " not in reply.certificate.covers and not unmeasured(reply.warnings):
        found += _clearances(judge, curve, sampled, reply)
    return found, sampled


def about_certify(
    loaded: Loaded, request: CertifyRequest, reply: CertifyReply, judge: Judge, curve: Curve, sampled: Sampled
) -> list[Disagreement]:
    """Return what contradicts the reply to a certify request."""
    found: list[Disagreement] = []
    verdict, at = reply.certificate, standing(loaded, request, curve)
    if verdict.collision_free:
        found += _certified(judge, curve, sampled) + _constraints(judge, curve, request.path_constraints)
        if at.excess > BEYOND:
            found.append(Disagreement(Kind.LIMIT, f"certified, but {at.joint} is {at.excess:.3g} beyond its limit"))
    elif verdict.reason == "beyond limits" and at.excess <= 0.0:
        found.append(Disagreement(Kind.LIMIT, f"refused as beyond limits, but within by {-at.excess:.3g}"))
    else:
        found += _refused(judge, curve, sampled, reply, request)
    found += _shares(reply, at) + measured_otherwise(judge, curve, sampled)
    if not unmeasured(reply.warnings) and " after " not in verdict.covers:
        found += _clearances(judge, curve, sampled, reply)
    return found


def measured_otherwise(judge: Judge, curve: Curve, sampled: Sampled) -> list[Disagreement]:
    """Nearest pairs of which Coal says another distance than Wolfe's algorithm, beyond what it may be off by."""
    found = []
    for nearest in (sampled.obstacle, sampled.own):
        other = judge.otherwise(curve, nearest)
        if other is not None and abs(other - nearest.distance) > CLOSER * max(judge.subject.size, nearest.distance):
            said = f"{_told(nearest)}, by another algorithm {other:.9g}"
            found.append(Disagreement(Kind.MEASURE, said))
    return found


def unmeasured(warnings: list[str]) -> bool:
    """Return whether a reply says that there was no time to find its figures."""
    return any("while distances were measured" in one for one in warnings)


def _certified(judge: Judge, curve: Curve, sampled: Sampled) -> list[Disagreement]:
    """Return what contradicts that a motion is free and keeps what is asked for."""
    found = []
    for nearest, required in ((sampled.obstacle, judge.setting.min_clearance), (sampled.own, 0.0)):
        if nearest.distance < required - CLOSER * judge.subject.size:
            said = f"{_told(nearest)}, {required - nearest.distance:.4g} m closer than required"
            found.append(Disagreement(Kind.FALSE_CERTIFICATE, said))
    enclosed = judge.enclosed(curve, float(sampled.times[0])) if not found else None
    if enclosed is not None:
        found.append(Disagreement(Kind.FALSE_CERTIFICATE, f"{enclosed} are one inside the other"))
    return found


def _told(nearest: Nearest) -> str:
    return f"{nearest.pair} are {nearest.distance:.9g} m apart at {nearest.time:.9g}"


def _constraints(judge: Judge, curve: Curve, constraints: list[PathConstraint]) -> list[Disagreement]:
    """Path constraints that a certified motion violates."""
    found = []
    for one in constraints:
        worst, when = farthest(judge, curve, one)
        allowed = one.half_angle if isinstance(one, OrientationCone) else one.tolerance
        if worst > allowed + CLOSER * judge.subject.size:
            said = f"a constraint of {allowed:.9g} is violated: {worst:.9g} at {when:.9g}"
            found.append(Disagreement(Kind.FALSE_CERTIFICATE, said))
    return found


def farthest(judge: Judge, curve: Curve, one: PathConstraint) -> tuple[float, float]:
    """The farthest that a frame is from what it has to keep [rad or m], and when."""
    times = judge.places(curve, float(curve.times[0]))
    for _ in range(4):
        values = _violations(judge, curve, one, times)
        k = int(np.argmax(values))
        best = float(values[k]), float(times[k])
        times = np.linspace(times[max(k - 1, 0)], times[min(k + 1, len(times) - 1)], 9)
    return best


def _violations(judge: Judge, curve: Curve, one: PathConstraint, times: np.ndarray) -> np.ndarray:
    placements = judge.frame_placements(curve, times, one.frame)
    if isinstance(one, OrientationCone):
        axis, target = (np.array(v) / np.linalg.norm(v) for v in (one.axis, one.target_axis))
        turned = np.array([T.rotation @ axis for T in placements])
        return np.arctan2(np.linalg.norm(np.cross(turned, target), axis=1), turned @ target)
    apart = np.array([T.translation for T in placements]) - np.array(one.point)
    if isinstance(one, PlaneConstraint):
        return np.abs(apart @ np.array(one.normal)) / np.linalg.norm(one.normal)
    return np.linalg.norm(np.cross(apart, np.array(one.direction)), axis=1) / np.linalg.norm(one.direction)


def _refused(
    judge: Judge, curve: Curve, sampled: Sampled, reply: CertifyReply, request: CertifyRequest
) -> list[Disagreement]:
    """Return what contradicts that a motion touches or is too close where the verdict says so, and is free before."""
    verdict, found = reply.certificate, []
    if (
        verdict.reason in ("contact", "too close", "undecided")
        and verdict.pair is not None
        and verdict.place is not None
    ):
        when = time_of(curve, verdict.place.row)
        mine = judge.between(verdict.pair)
        if not len(mine):  # a held object and a link that can't move against it touch wherever the robot is
            return []
        distances = judge.along(curve, np.full(len(mine), when), mine)
        required = 0.0 if verdict.reason == "contact" else judge.required[mine].max(initial=0.0)
        room = float((distances - required - judge.slacks[mine]).min(initial=np.inf))
        rough = verdict.reason == "undecided" or judge.of_points(verdict.pair)
        allowed = judge.subject.size * (FLOOR if rough else CLOSER * (1.0 + 2.0 * abs(room + required)))
        if request.leave_start_contact:  # what touched at the start must not come closer until it is that far away
            allowed = max(allowed, LEFT)
        within = judge.enclosed(curve, when) is not None if verdict.reason == "contact" and room > allowed else False
        if room > allowed and not within:
            said = f"{verdict.reason} of {verdict.pair} at {when:.9g}, where they have {room:.6g} m more"
            found.append(Disagreement(Kind.FALSE_REFUSAL, said))
    if verdict.reason not in ("stopped",) and " after " not in verdict.covers and not request.leave_start_contact:
        until = time_of(curve, verdict.free_until.row)
        closer = judge.first_closer(curve, sampled, judge.required - CLOSER * judge.subject.size, until)
        if closer is not None:
            said = f"free until {until:.9g}, but {judge.pair_names(closer[1])} are too close at {closer[0]:.9g}"
            found.append(Disagreement(Kind.FALSE_CERTIFICATE, said))
    return found


def time_of(curve: Curve, row: float) -> float:
    """The time of a row's number and a share of the way to the next."""
    k = int(np.clip(np.floor(row), 0, max(len(curve.times) - 2, 0)))
    if len(curve.times) == 1:
        return float(curve.times[0])
    return float(curve.times[k] + (row - k) * (curve.times[k + 1] - curve.times[k]))


def _shares(reply: CertifyReply, at: Standing) -> list[Disagreement]:
    """Shares of limits that are told wrongly, and a status that they contradict."""
    found: list[Disagreement] = []
    told = {rate: getattr(reply.limits, rate) for rate in RATES}
    if not at.shares:
        return found
    for rate in RATES:
        mine, noise = at.shares[rate], BEYOND * max(1.0, at.shares[rate]) + at.noise[rate]
        share = told[rate].share
        if share is None:
            if rate != "jerk" and not told[rate].steps and reply.status.name != "TIMED_OUT":
                found.append(Disagreement(Kind.LIMIT, f"the share of the {rate} is not told, it is {mine:.12g}"))
            continue
        if abs(share - mine) > noise:
            found.append(Disagreement(Kind.LIMIT, f"the share of the {rate} is told as {share!r}, it is {mine!r}"))
    if reply.status.name == "SUCCESS":
        over = [rate for rate in RATES if at.shares[rate] > 1.0 + KEPT + BEYOND + at.noise[rate]]
        if over and not (over == ["jerk"] and told["jerk"].steps):
            found.append(Disagreement(Kind.LIMIT, f"SUCCESS, but {', '.join(over)} beyond limits: {at.shares}"))
    elif (
        reply.certificate.collision_free
        and reply.status.name == "INVALID_MOTION_PLAN"
        and all(at.shares[rate] <= 1.0 for rate in RATES)
        and not any(told[rate].steps for rate in RATES)
    ):
        found.append(Disagreement(Kind.LIMIT, f"refused for a limit, but within all: {at.shares}"))
    return found


def _clearances(judge: Judge, curve: Curve, sampled: Sampled, reply: Any) -> list[Disagreement]:
    """Figures of the distances that are off."""
    found = []
    told = reply.clearance
    said = None if told is None else told.minimum
    nearest = sampled.obstacle
    if (said is None) != (nearest.pair is None) and told is not None:
        found.append(Disagreement(Kind.FIGURE, f"clearance.minimum is {said}, sampled {_told(nearest)}"))
    elif said is not None and nearest.pair is not None:
        found += _minimum(judge, "clearance.minimum", said, nearest)
        found += _attained(judge, curve, told)
        ends = [judge.least_at(curve, float(curve.times[k])) for k in (0, -1)]
        inside = told.ends <= 0.0 and any(judge.enclosed(curve, float(curve.times[k])) for k in (0, -1))
        if not _near(judge, told.ends, min(ends), nearest.slack or judge.slacks[~judge.own].max()) and not inside:
            found.append(Disagreement(Kind.FIGURE, f"clearance.ends is {told.ends:.9g}, it is {min(ends):.9g}"))
        if told.inner is not None:
            found += _inner(judge, curve, sampled, told.inner)
    own = reply.self_clearance
    if own is not None and own.minimum is not None and sampled.own.pair is not None:
        found += _minimum(judge, "self_clearance.minimum", own.minimum, sampled.own)
        off = OFF * judge.subject.size
        if own.minimum < sampled.own.distance - off - judge.slacks[judge.own].max(initial=0.0):
            closer = judge.least_of(curve, frozenset(own.pair))
            at_an_end = (judge.enclosed(curve, float(curve.times[k])) for k in (0, -1))
            inside = own.minimum == 0.0 and any(set(pair or ()) == set(own.pair) for pair in at_an_end)
            if own.minimum < closer - off and not (own.minimum <= 0.0 and closer <= 0.0) and not inside:
                said = f"self_clearance.minimum is {own.minimum:.9g} of {own.pair}, who keep {closer:.9g}"
                found.append(Disagreement(Kind.FIGURE, said))
    return found


def _inner(judge: Judge, curve: Curve, sampled: Sampled, said: float) -> list[Disagreement]:
    """That a distance is smaller than the smallest without the ends of the way, some more than those left out."""
    fine = np.linspace(curve.times[0], curve.times[-1], 1000)
    steps = np.diff(curve.local_at(fine), axis=0) / _lengths(judge, curve)
    travelled = np.r_[0.0, np.cumsum(np.linalg.norm(steps, axis=1))]
    since, until = np.interp([END, travelled[-1] - END], travelled, fine)
    inside = ((sampled.times > since) & (sampled.times < until))[:, None] & sampled.exact & ~judge.own
    least = float(sampled.distances[inside].min(initial=np.inf))
    if least < said - OFF * judge.subject.size and not (said <= 0.0 and least <= 0.0):
        return [Disagreement(Kind.FIGURE, f"clearance.inner is {said:.9g}, but there are {least:.9g} m inside")]
    return []


def _lengths(judge: Judge, curve: Curve) -> np.ndarray:
    """The change of each coordinate that counts as much as 1 rad, shape (nv,) [rad or m].

    Small robots drive and fly as far as others; their joints slide less.
    """
    model, lengths = judge.subject.formula.model, np.ones(curve.points.shape[1])
    for part in curve.parts:
        if part.width == 1 and model.joints[model.getJointId(part.name)].shortname().startswith("JointModelP"):
            lengths[part.at.start] = judge.subject.length
        base = {3: 2, 7: 3}.get(part.width, 0)
        lengths[part.at.start : part.at.start + base] = max(judge.subject.length, 1.0)
    return lengths


def _minimum(judge: Judge, what: str, said: float, nearest: Nearest) -> list[Disagreement]:
    """That a distance is smaller than the smallest that is told; in contact depths aren't compared."""
    if nearest.distance < said - OFF * judge.subject.size and not (said <= 0.0 and nearest.distance <= 0.0):
        return [Disagreement(Kind.FIGURE, f"{what} is {said:.9g}, but {_told(nearest)}")]
    return []


def _attained(judge: Judge, curve: Curve, told: Any) -> list[Disagreement]:
    """That the smallest distance is not what is there, at the time and of the pair that are told."""
    when = told.time if getattr(told, "row", None) is None else time_of(curve, told.row)
    mine = judge.between(told.pair)
    there = float(judge.along(curve, np.full(len(mine), when), mine).min(initial=np.inf))
    slack = float(judge.slacks[mine].max(initial=0.0))
    inside = told.minimum <= 0.0 < there and judge.enclosed(curve, when) is not None
    if not _near(judge, told.minimum, there, slack) and not inside:
        return [
            Disagreement(
                Kind.FIGURE, f"clearance is told as {told.minimum:.9g} of {told.pair} at {when:.9g}, it is {there:.9g}"
            )
        ]
    return []


def _near(judge: Judge, said: float, there: float, slack: float) -> bool:
    """Return whether a distance is told rightly; in contact depths aren't compared."""
    off = OFF * judge.subject.size
    return (said <= 0.0 and there <= slack) or there - slack - off <= said <= there + off


def _reached(request: PlanRequest, reply: PlanReply) -> list[Disagreement]:
    """That a motion doesn't begin at the start or end at a goal of joints, to 1e-6."""
    found, rows = [], reply.trajectory.positions
    ends = [("start", request.start, rows[0])]
    if isinstance(request.goal, JointsGoal):
        ends.append(("goal", request.goal.positions, rows[-1]))
    for what, asked, row in ends:
        by_joint: dict[str, list[float]] = {}
        for (joint, _), value in zip(split_columns(reply.position_names), row, strict=True):
            by_joint.setdefault(joint, []).append(value)
        for joint, values in by_joint.items():
            if joint in asked and not _same(np.atleast_1d(asked[joint]).astype(float), np.array(values)):
                found.append(Disagreement(Kind.ENDS, f"{joint} is at {values}, the {what} has {asked[joint]}"))
    return found


def _at_goal(judge: Judge, request: PlanRequest, curve: Curve) -> list[Disagreement]:
    """That the tip doesn't end at the pose that was the goal, or within 0.1 mm of the plane, more for a large robot."""
    goal, frame = request.goal, request.tip or judge.subject.tip
    if not isinstance(goal, PoseGoal | GuidePlaneGoal):
        return []
    (tip,) = judge.frame_placements(curve, curve.times[-1:], frame)
    if isinstance(goal, PoseGoal):
        apart = se3(Placement(goal.position, goal.quaternion_xyzw)).actInv(tip)
        off = [*np.abs(apart.translation), *np.abs(pin.log3(apart.rotation))]
        allowed = [*goal.position_tolerance, *goal.orientation_tolerance]
        beyond = [o - a for o, a in zip(off, allowed, strict=True) if a is not None]
    else:
        corners = np.array(request.guide_planes[-1].vertices)
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[1])
        normal /= np.linalg.norm(normal)
        inward = np.cross(normal, np.roll(corners, -1, axis=0) - corners)
        inward /= np.linalg.norm(inward, axis=1, keepdims=True)
        off = tip.translation - corners
        off_allowed = OFF * max(judge.subject.size, 1.0)
        beyond = [abs(float(normal @ off[0])) - off_allowed, *(-(off * inward).sum(axis=1) - off_allowed)]
    if max(beyond, default=0.0) > REACHED:
        return [Disagreement(Kind.ENDS, f"the tip is {max(beyond):.3g} beyond what the goal allows")]
    return []


def _metrics(reply: PlanReply, curve: Curve) -> list[Disagreement]:
    """Length and duration that are off, by a share of 1e-3."""
    fine = curve.local_at(np.linspace(curve.times[0], curve.times[-1], 4000))
    length = float(np.linalg.norm(np.diff(fine, axis=0), axis=1).sum())
    told = {"joint_path_length": (reply.metrics.joint_path_length, length)}
    told["duration"] = reply.metrics.duration, float(curve.times[-1] - curve.times[0])
    return [
        Disagreement(Kind.FIGURE, f"{name} is told as {said:.9g}, it is {there:.9g}")
        for name, (said, there) in told.items()
        if abs(said - there) > 1e-3 * there + 1e-9
    ]


def _same(asked: np.ndarray, values: np.ndarray) -> bool:
    """Return whether values of a joint mean the same place, up to whole turns and the sign of a quaternion."""
    if len(asked) >= 4:
        turned = min(np.abs(asked[-4:] - s * values[-4:]).max() for s in (1.0, -1.0))
        return bool(turned < 1e-5 and np.abs(asked[:-4] - values[:-4]).max(initial=0.0) < 1e-5)
    apart = np.abs(asked - values)
    apart[-1] = min(apart[-1], abs((asked[-1] - values[-1] + np.pi) % (2.0 * np.pi) - np.pi))
    return bool(apart.max() < 1.1e-5)


def _about_ends(request: PlanRequest, reply: PlanReply, judge: Judge) -> list[Disagreement]:
    """That an end is refused as in collision which is free with room; a goal, once all obstacles have come to rest."""
    ends = {"START_STATE_IN_COLLISION": request.start}
    if isinstance(request.goal, JointsGoal):
        ends["GOAL_IN_COLLISION"] = {**request.start, **request.goal.positions}
    if reply.status.name not in ends:
        return []
    named = reply.status.details.get("pair")
    if named is not None and not len(judge.between(named)):
        return []  # a held object and a link that can't move against it touch wherever the robot is
    values = as_values(ends[reply.status.name])
    time = judge.ends if reply.status.name == "GOAL_IN_COLLISION" else 0.0
    room = float((judge.distances_at(values, time) - judge.required - judge.slacks).min(initial=np.inf))
    if room > FLOOR and judge.enclosed_at(values, time) is None:
        return [Disagreement(Kind.FALSE_REFUSAL, f"{reply.status.name}, but everything keeps {room:.6g} m more")]
    return []
