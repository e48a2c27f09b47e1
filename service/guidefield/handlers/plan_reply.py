"""The reply to a plan request, from the plan that was made."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from guidefield.messages import replies
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.messages.scene import GuidePlane
from guidefield.planner.plan import Plan
from guidefield.planner.problem import Problem
from guidefield.planner.quality import ClearanceProfile, figures
from guidefield.planner.trajectory import Trajectory
from guidefield.robot.group import PlanningGroup

CERTIFICATE = (
    "Coal on the URDF's collision geometry; rigorous motion bounds on Bezier pieces, bisected per pair;"
    " position limits on the same pieces"
)
STAGES = ("ends", "connect", "guide", "relax", "parameterize", "certify")


def reply_to(
    request: PlanRequest,
    problem: Problem,
    made: Plan,
    profile: ClearanceProfile | None,
    run_id: str,
    received: float,
    load_seconds: float,
    measure_seconds: float,
    warnings: Sequence[str],
) -> PlanReply:
    """Put a plan into the wire's words.

    Args:
        request: What was asked.
        problem: What was planned.
        made: What came of it.
        profile: Distances along the trajectory; None without one.
        run_id: Name of the run.
        received: As in `answer_plan`.
        load_seconds: As in `answer_plan`.
        measure_seconds: Time that the profile took [s].
        warnings: What was odd before planning.
    """
    group, begin = problem.group, time.monotonic()
    metrics = _metrics(made, problem)
    measure_seconds += time.monotonic() - begin
    return PlanReply(
        run_id=run_id,
        status=replies.Outcome(
            code=int(made.status), name=made.status.name, message=made.message, details=made.details
        ),
        warnings=[*warnings, *made.warnings],
        position_names=group.position_names,
        velocity_names=group.velocity_names,
        path=[group.wire_positions(z) for z in made.path],
        trajectory=_trajectory(made.trajectory, request.sample_rate, group),
        guide_planes=[
            GuidePlane(name=plane.name, vertices=[tuple(v) for v in plane.vertices.tolist()])
            for plane in problem.guide_planes
        ],
        stages=[
            replies.Stage(name=stage.name, outcome=stage.outcome, seconds=stage.seconds, plane=stage.plane)
            for stage in made.stages
        ],
        clearance=_clearance(profile),
        self_clearance=_self_clearance(profile),
        certificate=replies.CertificateFigures(
            collision_free=made.verdict.free,
            method=CERTIFICATE,
            covers=_covered(made),
            evaluations=made.verdict.evaluations,
        ),
        metrics=metrics,
        timing=replies.Timing(
            load=load_seconds,
            measure=measure_seconds,
            total=time.monotonic() - received,
            **{stage: made.seconds.get(stage, 0.0) for stage in STAGES},
        ),
        counters=replies.Counters(
            iterations=problem.counters.iterations,
            potential_evaluations=problem.robot_field.evaluations,
            collision_checks=problem.counters.collision_checks,
        ),
        seed=request.seed,
        planner=request.planner,
        recording=None,
    )


def _covered(made: Plan) -> str:
    """What the certificate is about."""
    if made.trajectory is None:
        return "path"
    return "trajectory" if made.judged_from == 0.0 else f"trajectory after {made.judged_from:.6f} s"


def _trajectory(
    trajectory: Trajectory | None, sample_rate: float | None, group: PlanningGroup
) -> replies.Trajectory | None:
    """The knots of the certified curve, or samples of it; rates in the tangent space, as the wire has them."""
    if trajectory is None:
        return None
    states = trajectory if sample_rate is None else trajectory.resampled(sample_rate)
    velocities, accelerations = states.velocities, states.accelerations
    if not group.is_euclidean:
        velocities, accelerations = _tangent_rates(group, states.positions, velocities, accelerations)
    return replies.Trajectory(
        times=states.times.tolist(),
        positions=[group.wire_positions(z) for z in states.positions],
        velocities=velocities.tolist(),
        accelerations=accelerations.tolist(),
    )


def _tangent_rates(
    group: PlanningGroup, positions: np.ndarray, velocities: np.ndarray, accelerations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Tangent velocities T z' and accelerations T z'' + T' z', T' by a central difference along the motion."""
    rates, second = np.empty_like(velocities), np.empty_like(velocities)
    h = 1e-6
    for i, (z, dz, ddz) in enumerate(zip(positions, velocities, accelerations, strict=True)):
        T = group.tangent_map(z)
        turning = (group.tangent_map(z + h * dz) - group.tangent_map(z - h * dz)) / (2.0 * h)
        rates[i], second[i] = T @ dz, T @ ddz + turning @ dz
    return rates, second


def _clearance(profile: ClearanceProfile | None) -> replies.ClearanceFigures | None:
    if profile is None:
        return None
    distance = profile.obstacle_distance
    worst = int(np.argmin(distance))
    pair = profile.obstacle_pair[worst]
    if not np.isfinite(distance[worst]):
        return replies.ClearanceFigures(minimum=None, mean=None, inner=None, ends=None, pair=None, time=None)
    return replies.ClearanceFigures(
        minimum=float(distance[worst]),
        mean=float(distance.mean()),
        inner=profile.inner,
        ends=float(min(distance[0], distance[-1])),
        pair=list(pair) if pair else None,
        time=float(profile.times[worst]),
    )


def _self_clearance(profile: ClearanceProfile | None) -> replies.SelfClearance | None:
    if profile is None:
        return None
    worst = int(np.argmin(profile.self_distance))
    pair = profile.self_pair[worst]
    finite = bool(np.isfinite(profile.self_distance[worst]))
    return replies.SelfClearance(
        minimum=float(profile.self_distance[worst]) if finite else None, pair=list(pair) if pair else None
    )


def _metrics(made: Plan, problem: Problem) -> replies.Metrics | None:
    if made.trajectory is None:
        return None
    found = figures(made.trajectory, problem.kinematics)
    return replies.Metrics(
        joint_path_length=found.joint_path_length,
        tip_path_length=found.tip_path_length,
        duration=found.duration,
        peak_jerk=found.peak_jerk,
        smoothness=found.smoothness,
    )
