"""The words of the recording of a motion that was judged: a summary to read first, and what identifies the run."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import Any

import rerun as rr
from rerun.chunk import Chunk

from guidefield.messages import codec
from guidefield.messages.replies import Along, CertifyReply, LimitUse
from guidefield.messages.requests import CertifyRequest
from guidefield.recorder.chunks import still
from guidefield.recorder.documents import (
    MADE_WITH,
    PROPERTIES,
    SUMMARY,
    headline,
    made_with,
    millimetres,
    milliseconds,
    remarks_of,
    table,
)
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import Scene


def summary_of_judgement(
    request: CertifyRequest, reply: CertifyReply, group: PlanningGroup, scene: Scene, remarks: Sequence[str]
) -> Chunk:
    """The verdict, in figures; what it was about; what it was made with."""
    parts = [*headline(reply), *_figures(reply), *_limits(reply), *remarks_of((*reply.warnings, *remarks))]
    rows = [
        ("run", reply.run_id),
        ("robot", f"{group.robot.name}, {len(group.joints)} joints, tip {group.tip}"),
        ("scene", f"{scene.name}: {len(scene.obstacles)} obstacles"),
        ("request", _fingerprint(request)[:12]),
        ("time", f"certify {milliseconds(reply.timing.certify)}, measure {milliseconds(reply.timing.measure)}"),
        ("made with", made_with()),
    ]
    parts += table(("about", ""), rows)
    return still(SUMMARY, rr.TextDocument("\n".join(parts), media_type=rr.MediaType.MARKDOWN))


def properties_of_judgement(
    request: CertifyRequest, reply: CertifyReply, group: PlanningGroup, scene: Scene
) -> Iterator[Chunk]:
    """What identifies a run, to be queried across many recordings."""
    figures: dict[str, Any] = {
        "run_id": reply.run_id,
        "status": reply.status.name,
        "code": reply.status.code,
        "robot": group.robot.name,
        "scene": scene.name,
        "curve": reply.curve,
        "request_sha256": _fingerprint(request),
        "seconds": reply.timing.total,
    }
    if reply.clearance is not None and reply.clearance.minimum is not None:
        figures["clearance"] = reply.clearance.minimum
    figures[MADE_WITH] = made_with()
    yield Chunk.from_property(PROPERTIES.rpartition("/")[2], rr.AnyValues(**figures))


def _fingerprint(request: CertifyRequest) -> str:
    return hashlib.sha256(codec.encode(request)).hexdigest()


def _figures(reply: CertifyReply) -> list[str]:
    certificate, rows = reply.certificate, []
    judged = "free of collision" if certificate.collision_free else f"**{certificate.reason}**"
    pair = f" ({certificate.pair[0]} - {certificate.pair[1]})" if certificate.pair else ""
    rows.append(("certificate", f"{judged}{pair}: {certificate.covers}, as the curve {reply.curve}"))
    if not certificate.collision_free:
        rows.append(("free until", _where(certificate.free_until)))
    if certificate.place is not None:
        rows.append(("refused", _where(certificate.place)))
    if (clear := reply.clearance) is not None:
        where = f" ({clear.pair[0]} - {clear.pair[1]})" if clear.pair else ""
        rows.append(("clearance", f"**{millimetres(clear.minimum)}**{where}"))
        others = (clear.mean, clear.inner, clear.ends)
        rows.append(("… mean / inner / ends", " / ".join(millimetres(distance) for distance in others)))
    if (own := reply.self_clearance) is not None:
        where = f" ({own.pair[0]} - {own.pair[1]})" if own.pair else ""
        rows.append(("to itself", f"{millimetres(own.minimum)}{where}"))
    return [*table(("result", ""), rows), "", f"Judged by: {certificate.method}", ""]


def _limits(reply: CertifyReply) -> list[str]:
    limits = reply.limits
    uses = {name: getattr(limits, name) for name in limits.__struct_fields__}
    rows = [(name, *_used(use)) for name, use in uses.items() if use.joint is not None]
    return [*table(("limit of", "used at most", "by", "where"), rows), ""] if rows else []


def _used(use: LimitUse) -> tuple[str, str, str]:
    share = "it jumps" if use.share is None else f"{100 * use.share:.1f} %"
    where = "" if use.row is None else _where(Along(row=use.row, time=use.time))
    return share, use.joint or "", where


def _where(place: Along) -> str:
    return f"row {place.row:.3f}" if place.time is None else f"{place.time:.3f} s (row {place.row:.3f})"
