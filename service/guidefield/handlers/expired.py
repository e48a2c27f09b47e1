"""Replies and errors to requests whose time is up, or that are cancelled, before they have any result.

Codes and names of `details` are the wire; sentences may be changed.
"""

from __future__ import annotations

from typing import Any, Literal

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
    make_error_reply,
)
from guidefield.messages.requests import CertifyRequest, MotionRequest

Stage = Literal["queue", "load"]  # waiting for a worker; loading and preparing robot and scene. On the wire.

_BUSY = "all workers were busy for the {:g} s that were allowed; ask again, or allow more"


def expired_run(run_id: str, head: RunHead, stage: Stage) -> MotionReply:
    """Return the TIMED_OUT reply of a run, named by its id, without any result."""
    message = _BUSY.format(head.allowed)
    if stage == "load":
        message = (
            f"the {head.allowed:g} s that were allowed were up while the robot or the scene was loaded and prepared "
            "for its first use; what is prepared is kept: ask again, or allow more time for the first one"
        )
    return _empty(run_id, head, Status.TIMED_OUT, message, head.allowed, {_field(head): head.allowed, "stage": stage})


def cancelled_run(run_id: str, head: RunHead, waited: float) -> MotionReply:
    """Return the PREEMPTED reply of a run that waited for some time [s]."""
    message = "the run was cancelled before it began"
    return _empty(run_id, head, Status.PREEMPTED, message, waited, {"stage": "queue"})


def ended_run(run_id: str, request: MotionRequest, expired: DeadlineExpired, taken: float) -> MotionReply:
    """Return the reply of a run that took some time [s] and ended while what it needs was loaded."""
    head: RunHead = (
        CertifyHead(request.run_id, request.allowed_time)
        if isinstance(request, CertifyRequest)
        else (PlanHead(request.run_id, request.allowed_planning_time, request.planner, request.objective, request.seed))
    )
    message = f"the run was cancelled before {expired.step}; what is loaded is kept"
    if expired.status is Status.TIMED_OUT:
        message = (
            f"the {head.allowed:g} s that were allowed were up before {expired.step}; what is loaded is kept: ask "
            "again, or allow more time for the first one"
        )
    details = {_field(head): head.allowed, "stage": "load", "preparing": expired.step}
    return _empty(run_id, head, expired.status, message, taken, details)


def expired_work(allowed: float, stage: Stage) -> TimedOut:
    """Return the error of a request that makes no run, whose time [s] is up without any result."""
    message = f"the {allowed:g} s that were allowed were up while things were loaded; they are kept: ask again"
    return TimedOut(message if stage == "load" else _BUSY.format(allowed), allowed_time=allowed, stage=stage)


def cancelled_work() -> Preempted:
    """Return the error of a request that makes no run and was cancelled while it waited."""
    return Preempted("the request was cancelled before it began", stage="queue")


def ended_work(expired: DeadlineExpired, allowed: float) -> GuidefieldError:
    """Return the error of a request that makes no run, whose time [s] was up, or that was cancelled.

    The details of its end say how much was done, unless things were still loaded for it.
    """
    if expired.status is Status.PREEMPTED:
        if not expired.details:
            return Preempted("the request was cancelled while things were loaded", stage="load")
        return Preempted(f"the request was cancelled after {expired.step}", **expired.details)
    if not expired.details:
        return expired_work(allowed, "load")
    message = f"the {allowed:g} s that `allowed_time` allows were up after {expired.step}; allow more, or ask for fewer"
    return TimedOut(f"{message} at once", allowed_time=allowed, **expired.details)


def error_answer(encoding: Encoding, error: GuidefieldError) -> tuple[bool, bytes]:
    """Return an error as workers send answers: False for no reply, and its bytes."""
    return False, codec.encode(make_error_reply(error), encoding)


def _field(head: RunHead) -> str:
    return "allowed_planning_time" if isinstance(head, PlanHead) else "allowed_time"


def _empty(
    run_id: str, head: RunHead, status: Status, message: str, taken: float, details: dict[str, Any]
) -> MotionReply:
    shared: dict[str, Any] = {
        "run_id": run_id,
        "status": Outcome(code=int(status), name=status.name, message=message, details=details),
        "timing": Timing(total=taken, **{details["stage"]: taken}),
        "counters": Counters(),
        **dict.fromkeys(("clearance", "self_clearance", "recording")),
        **{name: [] for name in ("position_names", "velocity_names")},
    }
    certificate: dict[str, Any] = {
        "collision_free": False, "method": "none", "covers": "nothing", "evaluations": 0,
    }  # fmt: skip
    if isinstance(head, PlanHead):
        return PlanReply(
            path=[],
            trajectory=None,
            guide_planes=[],
            stages=[],
            certificate=CertificateFigures(**certificate),
            metrics=None,
            seed=head.seed,
            planner=head.planner,
            objective=head.objective,
            **shared,
        )
    unused = {name: LimitUse() for name in ("position", "velocity", "acceleration", "jerk")}
    nowhere = Along(row=0.0, time=None)
    return CertifyReply(
        curve="none",
        certificate=MotionCertificate(**certificate, reason="stopped", free_until=nowhere),
        limits=LimitShares(**unused),
        **shared,
    )
