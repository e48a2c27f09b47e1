"""The certificate held against two others' judgement of a motion: the referee's and HPP's."""

from __future__ import annotations

import enum
from typing import Any

import coal

from doubting import hpp
from doubting.compare import BEYOND, CLOSER, OFF, Disagreement, Kind
from doubting.limits import RATES
from doubting.loaded import Loaded
from guidefield.messages.replies import CertifyReply
from guidefield.messages.requests import CertifyRequest
from guidefield.messages.scene import Mesh, Obstacle, PointCloud
from guidefield.referee.case import Answer, Finding
from guidefield.referee.judge import Along, judge
from guidefield.referee.loading import case_of

SECONDS = 3.0
"""Time that the referee may look at a motion [s]."""
HPP_SECONDS = 20.0
"""The same of HPP, with the start of its process [s]."""
MOVING = 2.2e-3
"""A motion among obstacles that move may be refused if it has less room than this beyond what is required [m]."""
CLOSE = (Answer.CONTACT, Answer.TOO_CLOSE)


class Outcome(enum.StrEnum):
    """The relation of another judge's answer to the certificate."""

    AGREES = "agrees"
    UNDECIDED = "undecided"
    NOT_JUDGED = "not judged"
    NOT_ASKED = "not asked"
    DISAGREES = "disagrees"


SILENT = {Answer.UNDECIDED: Outcome.UNDECIDED, Answer.NOT_JUDGED: Outcome.NOT_JUDGED}
"""Answers that say nothing."""
SAID_BY_HPP = {
    "contact": Outcome.AGREES,
    "free": Outcome.AGREES,
    "grazes": Outcome.UNDECIDED,
    "not judged": Outcome.NOT_JUDGED,
}
"""The outcome of each of HPP's answers that nothing contradicts."""


def ask_referee(request: CertifyRequest, reply: CertifyReply) -> tuple[Outcome, list[Disagreement]]:
    """Ask the referee about a motion that the certificate has judged."""
    verdict = reply.certificate
    refused = not verdict.collision_free
    if " after " in verdict.covers or (refused and verdict.reason not in ("contact", "too close", "undecided")):
        return Outcome.NOT_ASKED, []
    case, extra = case_of(_told(request, reply)), 0.0
    if refused:
        extra = MOVING if any(one.trajectory for one in _obstacles(request)) else OFF
        if verdict.pair and {*verdict.pair} not in map(set, Along(case, 0.0, 0.0, SECONDS).names):
            return Outcome.NOT_JUDGED, []  # no planned joint parts them: what touches did so from the start
    found = judge(case, extra, extra, SECONDS).finding
    if found.answer in SILENT:
        return SILENT[found.answer], []
    if refused and found.answer is Answer.FREE:
        said = f"{verdict.reason} of {verdict.pair}, but the referee proves {extra:g} m more than required"
        return Outcome.DISAGREES, [Disagreement(Kind.FALSE_REFUSAL, said)]
    if refused or found.answer is Answer.FREE or not contradicts(found, request.min_clearance):
        return Outcome.AGREES, []
    said = f"the referee says {found.answer.value}: {found.about} at {found.time:.9g}, {found.distance:.9g}"
    return Outcome.DISAGREES, [Disagreement(Kind.FALSE_CERTIFICATE, said)]


def ask_hpp(loaded: Loaded, request: CertifyRequest, reply: CertifyReply) -> tuple[Outcome, list[Disagreement]]:
    """Ask HPP the same; that it finds no contact counts for primitive links against primitive obstacles."""
    verdict = reply.certificate
    free = verdict.collision_free
    if not hpp.is_installed() or " after " in verdict.covers or not (free or verdict.reason == "contact"):
        return Outcome.NOT_ASKED, []
    (heard,) = hpp.ask([hpp.case(request)], HPP_SECONDS)
    until = verdict.free_until.row if verdict.free_until.time is None else verdict.free_until.time
    if heard.answer == "contact" and (free or heard.at < until - BEYOND):
        said = f"free until {until:.9g}, but HPP finds {heard.pair} in contact at {heard.at:.9g}"
        return Outcome.DISAGREES, [Disagreement(Kind.FALSE_CERTIFICATE, said)]
    if heard.answer != "free" or free:
        return SAID_BY_HPP[heard.answer], []
    least = reply.clearance and reply.clearance.minimum
    if least is None or abs(least) < OFF or not _primitive(loaded, request, verdict.pair or []):
        return Outcome.UNDECIDED, []
    said = f"contact of {verdict.pair}, least distance {least:.6g} m, but HPP finds none"
    return Outcome.DISAGREES, [Disagreement(Kind.FALSE_REFUSAL, said)]


def _primitive(loaded: Loaded, request: CertifyRequest, pair: list[str]) -> bool:
    """Return whether a pair is a link and an obstacle of primitives, which have no hull and no inside of their own."""
    obstacles = {one.name for one in _obstacles(request) if not isinstance(one, Mesh | PointCloud)}
    links, shapes = loaded.subject.links, loaded.subject.formula.geometry.geometryObjects
    meshes = {link for link, one in zip(links, shapes, strict=True) if isinstance(one.geometry, coal.BVHModelBase)}
    return bool(obstacles & set(pair)) and bool((set(links) - meshes) & set(pair))


def _obstacles(request: CertifyRequest) -> list[Obstacle]:
    return request.scene.obstacles


def _told(request: CertifyRequest, reply: CertifyReply) -> dict[str, Any]:
    """The motion as the referee's file has it, without limits of rates that the reply says are exceeded."""
    case = hpp.case(request)
    for rate in RATES:
        use = getattr(reply.limits, rate)
        if use.steps or (use.share is not None and use.share > 1.0):
            for joint in case["limits"].values():
                joint[rate] = None
    return case


def contradicts(found: Finding, min_clearance: float) -> bool:
    """Return whether what the referee finds is more than what the certificate may be off by.

    Coal tells 0 for a box that is 0.8 um from a triangle.

    Args:
        min_clearance: Distance to keep from obstacles [m].
    """
    if found.answer in CLOSE:
        # of what must be kept only the clearance from obstacles is known here; own pairs keep nothing
        return found.distance < -CLOSER if found.answer is Answer.CONTACT else found.distance < min_clearance - CLOSER
    if found.answer is Answer.CONSTRAINT_BROKEN:
        return found.distance > CLOSER
    if found.answer is Answer.BEYOND_LIMIT and "position" in found.about:
        return found.distance > 2.0 * BEYOND
    return True
