"""The replies to plan requests that nobody began with: their time was up, or they were cancelled, while they waited."""

from __future__ import annotations

from typing import Any

from guidefield.errors import Status
from guidefield.messages.keys import PlanHead
from guidefield.messages.replies import CertificateFigures, Counters, Outcome, PlanReply, Timing


def timed_out_waiting(run_id: str, head: PlanHead) -> PlanReply:
    """TIMED_OUT with nothing to show for it.

    Args:
        run_id: Name of the run that did not begin.
        head: What the request says about it.
    """
    message = f"all workers were busy for the {head.allowed:g} s that were allowed; ask again, or allow more"
    details = {"allowed_planning_time": head.allowed}
    return _unbegun(run_id, head, Status.TIMED_OUT, message, details, head.allowed)


def cancelled_waiting(run_id: str, head: PlanHead, waited: float) -> PlanReply:
    """PREEMPTED with nothing to show for it.

    Args:
        run_id: Name of the run that did not begin.
        head: What the request says about it.
        waited: How long it waited [s].
    """
    return _unbegun(run_id, head, Status.PREEMPTED, "the run was cancelled before it began", {}, waited)


def _unbegun(
    run_id: str, head: PlanHead, status: Status, message: str, details: dict[str, Any], waited: float
) -> PlanReply:
    return PlanReply(
        run_id=run_id,
        status=Outcome(code=int(status), name=status.name, message=message, details={"stage": "queue", **details}),
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
        timing=Timing(queue=waited, total=waited),
        counters=Counters(),
        seed=head.seed,
        planner=head.planner,
        recording=None,
    )
