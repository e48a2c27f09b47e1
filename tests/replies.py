"""Replies made by hand, for tests of what carries them."""

from guidefield.errors import Status
from guidefield.messages.replies import CertificateFigures, Counters, Outcome, PlanReply, Timing


def plan_reply(run_id: str, status: Status = Status.SUCCESS) -> PlanReply:
    """A plan's reply with nothing but its status."""
    return PlanReply(
        run_id=run_id,
        status=Outcome(code=int(status), name=status.name, message="a plan made by hand"),
        position_names=["a"],
        velocity_names=["a"],
        path=[[0.0], [1.0]],
        trajectory=None,
        guide_planes=[],
        stages=[],
        clearance=None,
        self_clearance=None,
        certificate=CertificateFigures(collision_free=False, method="none", covers="nothing", evaluations=0),
        metrics=None,
        timing=Timing(),
        counters=Counters(),
        seed=0,
        planner="auto",
        recording=None,
    )
