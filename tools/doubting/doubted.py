"""One request answered and doubted: the reply, what was sampled, and what contradicts what."""

from __future__ import annotations

from dataclasses import dataclass

from doubting.compare import (
    Disagreement,
    Kind,
    about_certify,
    about_plan,
    asked_curve,
    covered_from,
    judge_of,
    names_of,
    unmeasured,
)
from doubting.curve import Curve
from doubting.judge import Judge, Sampled
from doubting.loaded import Loaded
from guidefield.errors import GuidefieldError, InternalFailure, WorkerCrashed
from guidefield.messages.replies import CertifyReply, PlanReply
from guidefield.messages.requests import CertifyRequest, PlanRequest

BUGS = (InternalFailure, WorkerCrashed)
"""Errors that are nobody's fault but ours."""


@dataclass(frozen=True, eq=False)
class Doubted:
    """The outcome of a request.

    Attributes:
        reply: The reply; None where it was refused as ill-posed, or failed.
        found: What contradicts it.
        refused: The kind of error, where it was refused as ill-posed.
        judge: Who sampled.
        curve: The motion that was sampled.
        sampled: What was found along it; None without one.
    """

    reply: PlanReply | CertifyReply | None
    found: tuple[Disagreement, ...]
    refused: str | None = None
    judge: Judge | None = None
    curve: Curve | None = None
    sampled: Sampled | None = None

    @property
    def untold(self) -> bool:
        """Return whether time ended the judgement or the figures."""
        if self.reply is None:
            return False
        return self.reply.status.name in ("TIMED_OUT", "PREEMPTED") or unmeasured(self.reply.warnings)


def doubt_answer(loaded: Loaded, request: PlanRequest | CertifyRequest) -> Doubted:
    """Answer a request, and hold the reply against samples."""
    try:
        reply = loaded.engine.answer(request)
    except BUGS as error:
        return Doubted(None, (Disagreement(Kind.CRASH, str(error)[:500]),))
    except GuidefieldError as error:
        return Doubted(None, (), type(error).__name__)
    if isinstance(reply, PlanReply):
        judge = judge_of(loaded, request, names_of(reply.position_names))
        found, sampled = about_plan(loaded, request, reply, judge)
        return Doubted(reply, tuple(found), None, judge, None, sampled)
    judge, curve = judge_of(loaded, request, names_of(reply.position_names)), asked_curve(loaded, request)
    sampled = judge.along_all(curve, covered_from(reply.certificate.covers, curve))
    return Doubted(
        reply, tuple(about_certify(loaded, request, reply, judge, curve, sampled)), None, judge, curve, sampled
    )
