"""The referee's judgement of a motion held against the certificate's."""

from __future__ import annotations

import enum
import json
import time

from doubting.compare import BEYOND, CLOSER, OFF, Disagreement, Kind
from doubting.limits import RATES
from doubting.loaded import Loaded
from guidefield import case_file
from guidefield.deadline import Deadline
from guidefield.handlers.certify_problem import certify_problem
from guidefield.messages.replies import CertifyReply
from guidefield.messages.requests import CertifyRequest
from guidefield.messages.scene import Obstacle
from guidefield.referee.judge import judge
from guidefield.referee.loading import case_of
from guidefield.referee.verdict import Answer, Finding
from guidefield.scene.scene import build

SECONDS = 3.0
"""How long the referee may look at a motion [s]."""
MOVING = 2.2e-3
"""A motion among obstacles that move may be refused if it has less room than this beyond what is required [m]."""
CLOSE = (Answer.CONTACT, Answer.TOO_CLOSE)


class Outcome(enum.StrEnum):
    """How the referee stands to the certificate."""

    AGREES = "agrees"
    UNDECIDED = "undecided"
    NOT_JUDGED = "not judged"
    NOT_ASKED = "not asked"
    DISAGREES = "disagrees"


SILENT = {Answer.UNDECIDED: Outcome.UNDECIDED, Answer.NOT_JUDGED: Outcome.NOT_JUDGED}
"""Answers that say nothing."""


def refereed(loaded: Loaded, request: CertifyRequest, reply: CertifyReply) -> tuple[Outcome, list[Disagreement]]:
    """Ask the referee about a motion that the certificate has judged."""
    verdict = reply.certificate
    refused = not verdict.collision_free
    if " after " in verdict.covers or (refused and verdict.reason not in ("contact", "too close", "undecided")):
        return Outcome.NOT_ASKED, []
    told, extra = _told(loaded, request, reply), 0.0
    if refused:
        extra = MOVING if any(one.trajectory for one in _obstacles(request)) else OFF
    found = judge(case_of(told), extra, extra, SECONDS).finding
    if found.answer in SILENT:
        return SILENT[found.answer], []
    if refused and found.answer is Answer.FREE:
        said = f"{verdict.reason} of {verdict.pair}, but the referee proves {extra:g} m more than required"
        return Outcome.DISAGREES, [Disagreement(Kind.FALSE_REFUSAL, said)]
    if refused or found.answer is Answer.FREE or not _counts(found, request):
        return Outcome.AGREES, []
    said = f"the referee says {found.answer.value}: {found.about} at {found.time:.9g}, {found.distance:.9g}"
    return Outcome.DISAGREES, [Disagreement(Kind.FALSE_CERTIFICATE, said)]


def _obstacles(request: CertifyRequest) -> list[Obstacle]:
    assert not isinstance(request.scene, str), "scenes are sent"
    return request.scene.obstacles


def _told(loaded: Loaded, request: CertifyRequest, reply: CertifyReply) -> dict[str, object]:
    """The motion as the referee's file has it, without limits of rates that the reply says are exceeded."""
    assert not isinstance(request.scene, str), "scenes are sent"
    problem, _ = certify_problem(request, loaded.model, build(request.scene), Deadline(time.monotonic() + 60.0))
    motion = case_file.Motion(
        world=problem.world,
        placement=request.robot_placement,
        held=request.attached_objects,
        times=problem.motion.times,
        positions=problem.motion.positions,
        velocities=problem.motion.velocities,
        jerk_limits=problem.jerk_limits,
        min_clearance=request.min_clearance,
        path_constraints=request.path_constraints,
    )
    (told,) = json.loads(json.dumps(case_file.cases(motion)))
    for rate in RATES:
        use = getattr(reply.limits, rate)
        if use.steps or (use.share is not None and use.share > 1.0):
            for joint in told["limits"].values():
                joint[rate] = None
    plain: dict[str, object] = told
    return plain


def _counts(found: Finding, request: CertifyRequest) -> bool:
    """Whether what the referee finds is more than what the certificate may be off by."""
    if found.answer in CLOSE:
        # of what must be kept only the clearance from obstacles is known here; own pairs keep nothing
        return found.distance < -CLOSER if found.answer is Answer.CONTACT else _too_close(found, request)
    if found.answer is Answer.CONSTRAINT_BROKEN:
        return found.distance > CLOSER
    if found.answer is Answer.BEYOND_LIMIT and "position" in found.about:
        return found.distance > 2.0 * BEYOND
    return True


def _too_close(found: Finding, request: CertifyRequest) -> bool:
    return found.distance < request.min_clearance - CLOSER
