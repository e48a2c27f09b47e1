"""The reply to a plan request whose time was up before anybody could begin with it."""

from __future__ import annotations

from guidefield.errors import Status
from guidefield.messages.keys import PlanHead
from guidefield.messages.replies import CertificateFigures, Counters, Outcome, PlanReply, Timing


def timed_out_waiting(run_id: str, head: PlanHead) -> PlanReply:
    """TIMED_OUT with nothing to show for it.

    Args:
        run_id: Name of the run that did not begin.
        head: What the request says about it.
    """
    return PlanReply(
        run_id=run_id,
        status=Outcome(
            code=int(Status.TIMED_OUT),
            name=Status.TIMED_OUT.name,
            message=f"all workers were busy for the {head.allowed:g} s that were allowed; ask again, or allow more",
            details={"stage": "queue", "allowed_planning_time": head.allowed},
        ),
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
        timing=Timing(queue=head.allowed, total=head.allowed),
        counters=Counters(),
        seed=head.seed,
        planner=head.planner,
        recording=None,
    )
