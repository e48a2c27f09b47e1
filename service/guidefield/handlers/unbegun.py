"""The replies to requests that nobody began with: their time was up, or they were cancelled, while they waited."""

from __future__ import annotations

from typing import Any

from guidefield.deadline import DeadlineExpired
from guidefield.errors import GuidefieldError, Preempted, Status, TimedOut
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.keys import CertifyHead, PlanHead, RunHead
from guidefield.messages.replies import (
    Along,
    CertificateFigures,
    CertifyReply,
    Counters,
    LimitShares,
    LimitUse,
    MotionCertificate,
    MotionReply,
    Outcome,
    PlanReply,
    Timing,
    error_reply,
)
from guidefield.messages.requests import CertifyRequest, MotionRequest


def timed_out_waiting(run_id: str, head: RunHead) -> MotionReply:
    """TIMED_OUT with nothing to show for it.

    Args:
        run_id: Name of the run that did not begin.
        head: What the request says about it.
    """
    message = f"all workers were busy for the {head.allowed:g} s that were allowed; ask again, or allow more"
    waited = Timing(queue=head.allowed, total=head.allowed)
    return _unbegun(run_id, head, Status.TIMED_OUT, message, {_field(head): head.allowed}, waited)


def head_of(request: MotionRequest) -> RunHead:
    """What a request says about its run."""
    if isinstance(request, CertifyRequest):
        return CertifyHead(request.run_id, request.allowed_time)
    return PlanHead(
        run_id=request.run_id,
        allowed_planning_time=request.allowed_planning_time,
        planner=request.planner,
        objective=request.objective,
        seed=request.seed,
    )


def timed_out_loading(run_id: str, head: RunHead) -> MotionReply:
    """TIMED_OUT while a worker still loads and prepares what the run needs.

    Args:
        run_id: Name of the run.
        head: What the request says about it.
    """
    message = (
        f"the {head.allowed:g} s that were allowed were up while the robot or the scene was loaded and prepared for "
        "its first use; what is prepared is kept: ask again, or allow more time for the first one"
    )
    details = {_field(head): head.allowed, "stage": "load"}
    return _unbegun(run_id, head, Status.TIMED_OUT, message, details, Timing(load=head.allowed, total=head.allowed))


def time_up_waiting(allowed: float) -> TimedOut:
    """What is told of a request that makes no run, whose time [s] was up before anybody began with it."""
    message = f"all workers were busy for the {allowed:g} s that were allowed; ask again, or allow more"
    return TimedOut(message, allowed_time=allowed, stage="queue")


def time_up_loading(allowed: float) -> TimedOut:
    """The same where a worker still loads and prepares what it needs."""
    message = f"the {allowed:g} s that were allowed were up while things were loaded; they are kept: ask again"
    return TimedOut(message, allowed_time=allowed, stage="load")


def cancelled_before() -> Preempted:
    """The same where it was cancelled before anybody began with it."""
    return Preempted("the request was cancelled before it began", stage="queue")


def error_answer(encoding: Encoding, error: GuidefieldError) -> tuple[bool, bytes]:
    """An error as it is sent."""
    return False, codec.encode(error_reply(error), encoding)


def cancelled_waiting(run_id: str, head: RunHead, waited: float) -> MotionReply:
    """PREEMPTED with nothing to show for it.

    Args:
        run_id: Name of the run that did not begin.
        head: What the request says about it.
        waited: How long it waited [s].
    """
    timing = Timing(queue=waited, total=waited)
    return _unbegun(run_id, head, Status.PREEMPTED, "the run was cancelled before it began", {}, timing)


def stopped_loading(run_id: str, request: MotionRequest, late: DeadlineExpired, waited: float) -> MotionReply:
    """TIMED_OUT or PREEMPTED if a run ended while what it needs was loaded.

    Args:
        run_id: Name of the run.
        request: What was asked.
        late: How it ended.
        waited: How long it took [s].
    """
    head = head_of(request)
    if late.status is Status.PREEMPTED:
        message = f"the run was cancelled before {late.step}; what is loaded is kept"
    else:
        message = (
            f"the {head.allowed:g} s that were allowed were up before {late.step}; what is loaded is kept: ask again, "
            "or allow more time for the first one"
        )
    details = {_field(head): head.allowed, "stage": "load", "preparing": late.step}
    return _unbegun(run_id, head, late.status, message, details, Timing(load=waited, total=waited))


def stopped_work(late: DeadlineExpired, allowed: float) -> GuidefieldError:
    """Return the error of a request that makes no run, whose time [s] was up, or that was cancelled.

    The details of what stopped it say how much was done, unless things were still loaded for it.
    """
    if late.status is Status.PREEMPTED:
        if not late.details:
            return Preempted("the request was cancelled while things were loaded", stage="load")
        return Preempted(f"the request was cancelled after {late.step}", **late.details)
    if not late.details:
        return time_up_loading(allowed)
    message = f"the {allowed:g} s that `allowed_time` allows were up after {late.step}; allow more, or ask for fewer"
    return TimedOut(f"{message} at once", allowed_time=allowed, **late.details)


def _field(head: RunHead) -> str:
    """What a request calls the time that it may take."""
    return "allowed_planning_time" if isinstance(head, PlanHead) else "allowed_time"


def _unbegun(
    run_id: str, head: RunHead, status: Status, message: str, details: dict[str, Any], timing: Timing
) -> MotionReply:
    ended = Outcome(code=int(status), name=status.name, message=message, details={"stage": "queue", **details})
    if isinstance(head, PlanHead):
        return _without_plan(run_id, head, ended, timing)
    return _without_judgement(run_id, ended, timing)


def _without_plan(run_id: str, head: PlanHead, ended: Outcome, timing: Timing) -> PlanReply:
    return PlanReply(
        run_id=run_id,
        status=ended,
        position_names=[],
        velocity_names=[],
        path=[],
        trajectory=None,
        guide_planes=[],
        stages=[],
        clearance=None,
        self_clearance=None,
        certificate=CertificateFigures(collision_free=False, method="none", covers="nothing", evaluations=0),
        metrics=None,
        timing=timing,
        counters=Counters(),
        seed=head.seed,
        planner=head.planner,
        objective=head.objective,
        recording=None,
    )


def _without_judgement(run_id: str, ended: Outcome, timing: Timing) -> CertifyReply:
    return CertifyReply(
        run_id=run_id,
        status=ended,
        curve="none",
        position_names=[],
        velocity_names=[],
        certificate=MotionCertificate(
            collision_free=False,
            method="none",
            covers="nothing",
            evaluations=0,
            reason="stopped",
            free_until=Along(row=0.0, time=None),
        ),
        clearance=None,
        self_clearance=None,
        limits=LimitShares(position=LimitUse(), velocity=LimitUse(), acceleration=LimitUse(), jerk=LimitUse()),
        timing=timing,
        counters=Counters(),
        recording=None,
    )
