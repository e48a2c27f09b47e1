"""Build the reply to a plan request from the plan; the parts that replies to sequences and certify requests share.

Fields are those of messages/plan_reply.py, the wire; the sentence `CERTIFICATE` may be changed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from guidefield.errors import Status
from guidefield.messages import replies
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.messages.scene import GuidePlane
from guidefield.planner.motion.drawn_motion import Deviations, DrawnMotion, deviations
from guidefield.planner.motion.submitted_motion import StraightMotion, SubmittedMotion
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion_certificate import efforts_along, speeds_along
from guidefield.planner.plan import Plan
from guidefield.planner.quality import Clearance, SmallestDistance, measure_figures
from guidefield.planner.task.effort import Efforts, measure_efforts
from guidefield.planner.task.motion_limits import CartesianLimit, CartesianUse
from guidefield.planner.task.problem import Conditions, ControllerModel, Problem
from guidefield.robot.group.group import LONGEST_TURN, PlanningGroup
from guidefield.robot.group.kinematics import Kinematics, tangent_accelerations, tangents
from guidefield.scene import guide_plane

CERTIFICATE = (
    "the URDF's collision geometry; rigorous motion bounds and separating directions on segments of Bezier curves,"
    " halved per pair; confirmed by Coal where it is closest or refused; position limits on the same curves"
)
"""The `method` of each certificate in replies."""
STAGES = ("ends", "connect", "guide", "relax", "parameterize", "certify")
"""Stages of the planner by their fields in `Timing`."""


def reply_to(
    request: PlanRequest,
    problem: Problem,
    made: Plan,
    drawn: DrawnMotion | None,
    measured: Clearance | None,
    run_id: str,
    received: float,
    seconds: Mapping[str, float],
    warnings: Sequence[str],
) -> PlanReply:
    """Build the reply.

    Args:
        drawn: The motion as a controller draws it; None if that isn't requested.
        measured: Distances along that, or else along the trajectory; None without one.
        received: As in `answer_plan`.
        seconds: Times of waiting and loading [s]; all time after the planner's stages counts as measuring.
    """
    group, whole = problem.group, made.verdict.free and made.judged_from == 0.0
    kept = problem.min_clearance if whole else -np.inf
    metrics, moved = (
        motion_metrics(made.trajectory, problem.kinematics),
        made.trajectory if drawn is None else drawn.motion,
    )
    path, trajectory = group.wire_path(made.path), wire_trajectory(made.trajectory, request.sample_rate, group)
    spent = {stage: made.seconds.get(stage, 0.0) for stage in STAGES} | dict(seconds)
    total = time.monotonic() - received
    return PlanReply(
        run_id=run_id,
        status=outcome(made.status, made.message, made.details),
        warnings=[*warnings, *made.warnings, *warn_of_bounds(measured)],
        position_names=group.position_names,
        velocity_names=group.velocity_names,
        path=path,
        trajectory=trajectory,
        guide_planes=wire_planes(problem.guide_planes),
        stages=[
            replies.Stage(name=stage.name, outcome=stage.outcome, seconds=stage.seconds, plane=stage.plane)
            for stage in made.stages
        ],
        clearance=None if measured is None else clearance_figures(measured, kept),
        self_clearance=None if measured is None else self_figures(measured, 0.0 if whole else -np.inf),
        certificate=replies.CertificateFigures(
            collision_free=made.verdict.free,
            method=CERTIFICATE,
            covers=describe_covered(made.trajectory, drawn, made.judged_from),
            evaluations=made.verdict.evaluations,
        ),
        metrics=metrics,
        counters=replies.Counters(
            iterations=problem.counters.iterations,
            potential_evaluations=problem.robot_field.evaluations,
            collision_checks=problem.counters.collision_checks,
        ),
        seed=request.seed,
        planner=request.planner,
        objective=request.objective,
        recording=None,
        execution=wire_execution(group, made.trajectory, drawn if made.verdict.free else None, problem.execution),
        cartesian=[] if moved is None else cartesian_uses(problem.cartesian_limits, moved),
        effort=None if moved is None else effort_figures(problem, moved),
        timing=replies.Timing(total=total, measure=max(0.0, total - sum(spent.values())), **spent),
    )


def outcome(status: Status, message: str, details: dict[str, Any]) -> replies.Outcome:
    """Return a status in the wire's words."""
    return replies.Outcome(code=int(status), name=status.name, message=message, details=details)


def wire_planes(planes: Iterable[guide_plane.GuidePlane]) -> list[GuidePlane]:
    """Return guide planes in the wire's words."""
    return [GuidePlane(name=one.name, vertices=[tuple(v) for v in one.vertices.tolist()]) for one in planes]


def wire_execution(
    group: PlanningGroup, planned: Trajectory | None, drawn: DrawnMotion | None, execution: ControllerModel | None
) -> replies.ExecutionFigures | None:
    """Build the rows of a certified motion that a controller is sent; None if none are requested."""
    if drawn is None or planned is None or execution is None:
        return None
    return execution_figures(execution, planned, drawn, group)


def describe_covered(trajectory: Trajectory | None, drawn: DrawnMotion | None, since: float = 0.0) -> str:
    """Name the subject of the certificate, which may begin at a time [s]."""
    if trajectory is None:
        return "path"
    return f"trajectory{'' if drawn is None else ' as executed'}{f' after {since:.6f} s' if since else ''}"


def wire_trajectory(
    trajectory: Trajectory | None, sample_rate: float | None, group: PlanningGroup
) -> replies.Trajectory | None:
    """The knots of the certified curve, or samples of it; rates in the tangent space.

    Readers take the shorter way from one orientation to the next: a piece that turns by `LONGEST_TURN` or more gets
    further knots.
    """
    if trajectory is None:
        return None
    states = _add_turning_knots(trajectory, group) if sample_rate is None else trajectory.resample(sample_rate)
    along = states.positions, states.velocities
    return replies.Trajectory(
        times=states.times.tolist(),
        positions=group.wire_rows(states.positions),
        velocities=tangents(group, *along).tolist(),
        accelerations=tangent_accelerations(group, *along, states.accelerations).tolist(),
    )


def execution_figures(
    execution: ControllerModel, planned: Trajectory | StraightMotion, drawn: DrawnMotion, group: PlanningGroup
) -> replies.ExecutionFigures:
    """The rows that a controller is sent, and the deviation of the curve that it draws from the planned motion."""
    velocities, accelerations = drawn.velocities, drawn.accelerations
    return replies.ExecutionFigures(
        interpolation=execution.interpolation.value,
        rate=execution.rate,
        tolerance=execution.tolerance.tolist(),
        deviation=wire_deviation(deviations(planned, drawn.motion), group),
        times=drawn.times.tolist(),
        positions=group.wire_rows(drawn.positions),
        velocities=None if velocities is None else velocities.tolist(),
        accelerations=None if accelerations is None else accelerations.tolist(),
        end=float(drawn.motion.scheduled.piece_times()[-1]),
    )


def wire_deviation(found: Deviations, group: PlanningGroup) -> replies.MotionDeviation:
    """The deviation of a motion of joints of one coordinate from another, in the wire's words."""
    worst = int(np.argmax(found.values))
    return replies.MotionDeviation(
        largest=float(found.values[worst]),
        joint=group.position_names[worst],
        time=float(found.times[worst]),
        joints=dict(zip(group.position_names, found.values.tolist(), strict=True)),
    )


def _add_turning_knots(trajectory: Trajectory, group: PlanningGroup) -> Trajectory:
    made = trajectory
    while (far := group.turns(made.positions) >= LONGEST_TURN).any():
        times = np.sort(np.concatenate([made.times, 0.5 * (made.times[:-1] + made.times[1:])[far]]))
        made = Trajectory(times, *trajectory.evaluate(times)[:2])
    return made


def clearance_figures(measured: Clearance, certified: float) -> replies.ClearanceFigures:
    """Distances from obstacles as the reply has them; `certified` is kept all along, by the certificate [m].

    `inner` leaves out the path near start and goal, `ends` is the smaller distance at these two.
    """
    closest = measured.obstacle
    if closest.pair is None:
        return replies.ClearanceFigures(minimum=None, mean=None, inner=None, ends=None, pair=None, time=None)
    return replies.ClearanceFigures(
        minimum=state_distance(closest, certified),
        mean=measured.mean,
        inner=None if measured.inner is None else state_distance(measured.inner, certified),
        ends=measured.ends,
        pair=list(closest.pair),
        time=closest.time,
    )


def self_figures(measured: Clearance, certified: float) -> replies.SelfClearance:
    """The distance of the robot from itself as the reply has it; arguments as of `clearance_figures`."""
    if measured.own.pair is None:
        return replies.SelfClearance(minimum=None, pair=None)
    return replies.SelfClearance(minimum=state_distance(measured.own, certified), pair=list(measured.own.pair))


def state_distance(closest: SmallestDistance, certified: float) -> float | None:
    """Return the smallest distance [m]; a lower bound if there was no time to find it, None if none is known."""
    if closest.exact:
        return closest.distance
    kept = max(closest.bound, certified)
    return kept if np.isfinite(kept) else None


def warn_of_bounds(measured: Clearance | None) -> list[str]:
    """Warn about each smallest distance that there was no time to find: its field is a lower bound."""
    if measured is None:
        return []
    stated = [
        ("clearance.minimum", measured.obstacle),
        ("clearance.inner", measured.inner),
        ("self_clearance.minimum", measured.own),
    ]
    return [
        f"time was up while distances were measured: `{name}` is not the smallest distance but a lower bound of it;"
        f" the smallest that was found is {1000 * closest.distance:.1f} mm"
        for name, closest in stated
        if closest is not None and not closest.exact
    ]


def cartesian_uses(
    limits: tuple[CartesianLimit, ...], motion: Trajectory | SubmittedMotion
) -> list[replies.CartesianUse]:
    """The largest speeds and accelerations of what is limited in space."""
    if not limits:
        return []
    jumps = isinstance(motion, SubmittedMotion) and motion.velocities is None
    return [wire_cartesian_use(use, jumps=jumps) for use in speeds_along(motion, limits)]


def effort_figures(conditions: Conditions, motion: Trajectory | SubmittedMotion) -> replies.EffortFigures | None:
    """The torques along a motion; None of what has no accelerations."""
    if isinstance(motion, SubmittedMotion) and motion.velocities is None:
        return None
    group, limit = conditions.group, conditions.effort_limit
    known = measure_efforts(group, None, motion.polynomials) if limit is None else efforts_along(motion, group, limit)
    return wire_efforts(known)


def wire_efforts(efforts: Efforts) -> replies.EffortFigures:
    """Torques in the wire's words."""
    if efforts.reason is not None:
        return replies.EffortFigures(reason=efforts.reason)
    uses = []
    for use in efforts.uses:
        limit = use.limit if math.isfinite(use.limit) else None
        share = None if limit is None else use.reached.bound / limit
        uses.append(
            replies.EffortUse(joint=use.name, effort=use.reached.found, time=use.reached.time, limit=limit, share=share)
        )
    return replies.EffortFigures(joints=uses, energy=efforts.energy)


def wire_cartesian_use(use: CartesianUse, *, jumps: bool = False) -> replies.CartesianUse:
    """A use of a limit in the wire's words; `jumps`: velocities jump, so that there is no acceleration."""
    limit, is_limited = use.limit, math.isfinite(use.limit.acceleration)
    return replies.CartesianUse(
        frame=None if limit.is_link else limit.name,
        link=limit.name if limit.is_link else None,
        speed=use.speed.found,
        speed_limit=limit.speed,
        speed_time=use.speed.time,
        acceleration=use.acceleration.found if is_limited and not jumps else None,
        acceleration_limit=limit.acceleration if is_limited else None,
        acceleration_time=use.acceleration.time if is_limited and not jumps else None,
    )


def motion_metrics(trajectory: Trajectory | None, kinematics: Kinematics) -> replies.Metrics | None:
    """Figures of a trajectory, if there is one."""
    if trajectory is None:
        return None
    found = measure_figures(trajectory, kinematics)
    return replies.Metrics(
        joint_path_length=found.joint_path_length,
        tip_path_length=found.tip_path_length,
        duration=found.duration,
        peak_jerk=found.peak_jerk,
        smoothness=found.smoothness,
    )
