"""The words of the recording of a plan: how it ended, in figures, its stages, and what identifies it."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from rerun.chunk import Chunk

from guidefield.messages.certificate_in_words import certified
from guidefield.messages.replies import PlanReply, StepFigures, as_plain_data
from guidefield.messages.requests import PlanRequest
from guidefield.recorder import documents
from guidefield.recorder.documents import (
    distances,
    fingerprint,
    millimetres,
    milliseconds,
    remarks_of,
    table,
)
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import Scene

LEAST_TOLD = 5e-5
"""A shorter time is left out [s]."""


def documents_of(
    request: PlanRequest, reply: PlanReply, group: PlanningGroup, scene: Scene, remarks: Sequence[str], made_with: str
) -> Iterator[Chunk]:
    """How the plan ended, in figures; what it was about; what it was made with; the messages."""
    figures: dict[str, Any] = {
        "planner": reply.planner,
        "objective": reply.objective,
        "seed": reply.seed,
        "planning_seconds": reply.timing.total,
    }
    if reply.metrics is not None:
        figures["duration"] = reply.metrics.duration
    parts = [*remarks_of((*reply.warnings, *remarks)), *_figures(reply, group), *_steps(reply), *_stages(reply)]
    request_hash = fingerprint(request)
    parts += _origin(request_hash, reply, group, scene, made_with)
    yield from documents.documents_of(request, reply, group, scene, figures, parts, request_hash, made_with)


def _figures(reply: PlanReply, group: PlanningGroup) -> list[str]:
    rows = distances(reply)
    if (metrics := reply.metrics) is not None:
        rows.append(("duration", f"{metrics.duration:.2f} s"))
        unit = _unit(group)
        ways = f"{metrics.joint_path_length:.2f} {unit} / {metrics.tip_path_length:.2f} m"
        rows.append(("way of the joints / the tip", ways))
        rows.append(("peak jerk", f"{metrics.peak_jerk:.0f} {unit}/s³"))
    rows.append(("certificate", certified(reply)))
    counters = reply.counters
    rows.append(("waypoints", f"{len(reply.path)}, {counters.iterations} iterations"))
    work = [
        f"{counters.potential_evaluations} potentials",
        f"{counters.collision_checks} collision checks",
        f"{reply.certificate.evaluations} certificate evaluations",
    ]
    rows.append(("work", ", ".join(work)))
    return [*table(("result", ""), rows), "", f"Judged by: {reply.certificate.method}", ""]


def _steps(reply: PlanReply) -> list[str]:
    """The steps of a sequence in time: what is held, and the smallest distance from obstacles."""
    if not reply.steps:
        return []
    rows = [
        (
            f"steps[{index}]",
            f"{one.begin:.2f} to {one.end:.2f} s",
            millimetres(None if one.clearance is None else one.clearance.minimum),
            "; ".join([*_handled(one), *(f"{may.object} may touch {may.obstacle}" for may in one.permissions)]),
        )
        for index, one in enumerate(reply.steps)
    ]
    return [*table(("step", "time", "clearance", "objects"), rows), ""]


def _handled(step: StepFigures) -> list[str]:
    """What is held in a step, and what is put down and picked up at its end."""
    words = {"holds": ", ".join(step.held), "puts down": step.detached, "picks up": step.attached}
    return [f"{verb} {names}" for verb, names in words.items() if names]


def _stages(reply: PlanReply) -> list[str]:
    """The stages, and what else took time; a stage that came once has its time in its own row."""
    rows = [(f"{one.name}{_plane(one.plane, reply)}", milliseconds(one.seconds), one.outcome) for one in reply.stages]
    times = Counter(one.name for one in reply.stages)
    spent = {name: seconds for name, seconds in as_plain_data(reply.timing).items() if seconds and name != "total"}
    for name, seconds in spent.items():
        if times[name] != 1 and seconds >= LEAST_TOLD:
            rows.append((f"all of {name}" if times[name] else name, milliseconds(seconds), ""))
    rows.append(("**total**", f"**{milliseconds(reply.timing.total)}**", ""))
    return [*table(("stage", "time", "outcome"), rows), ""]


def _origin(request_hash: str, reply: PlanReply, group: PlanningGroup, scene: Scene, made_with: str) -> list[str]:
    urdf = hashlib.sha256(group.robot.source.urdf_text.encode()).hexdigest()[:12]
    rows = [
        ("run", reply.run_id),
        ("robot", f"{group.robot.name} (URDF {urdf}), {len(group.joints)} joints, tip {group.tip}"),
        ("scene", f"{scene.name}: {len(scene.obstacles)} obstacles, {len(reply.guide_planes)} guide planes"),
        ("request", request_hash[:12]),
        ("planner, objective, seed", f"{reply.planner}, {reply.objective}, {reply.seed}"),
        ("made with", made_with),
    ]
    return table(("about", ""), rows)


def _plane(index: int | None, reply: PlanReply) -> str:
    if index is None:
        return ""
    return f" to {reply.guide_planes[index].name if index < len(reply.guide_planes) else index}"


def _unit(group: PlanningGroup) -> str:
    """Of the joints' coordinates together."""
    kinds = {joint.kind.value for joint in group.joints}
    if kinds == {"prismatic"}:
        return "m"
    return "rad" if kinds.isdisjoint(("prismatic", "planar", "floating")) else "(rad, m)"
