"""The words of the recording of a motion that was judged: a summary to read first, and what identifies the run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rerun.chunk import Chunk

from guidefield.messages.certificate_in_words import place_in_words
from guidefield.messages.replies import CertifyReply, LimitUse
from guidefield.messages.requests import CertifyRequest
from guidefield.recorder import documents
from guidefield.recorder.documents import distances, fingerprint, milliseconds, pair, remarks_of, table
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import Scene


def documents_of(
    request: CertifyRequest,
    reply: CertifyReply,
    group: PlanningGroup,
    scene: Scene,
    remarks: Sequence[str],
    made_with: str,
) -> Iterator[Chunk]:
    """The verdict, in figures; what it was about; what it was made with; the messages."""
    request_hash = fingerprint(request)
    parts = [*_figures(reply), *_limits(reply), *remarks_of((*reply.warnings, *remarks))]
    rows = [
        ("run", reply.run_id),
        ("robot", f"{group.robot.name}, {len(group.joints)} joints, tip {group.tip}"),
        ("scene", f"{scene.name}: {len(scene.obstacles)} obstacles"),
        ("request", request_hash[:12]),
        ("time", f"certify {milliseconds(reply.timing.certify)}, measure {milliseconds(reply.timing.measure)}"),
        ("made with", made_with),
    ]
    parts += table(("about", ""), rows)
    figures = {"curve": reply.curve, "seconds": reply.timing.total}
    yield from documents.documents_of(request, reply, group, scene, figures, parts, request_hash, made_with)


def _figures(reply: CertifyReply) -> list[str]:
    certificate = reply.certificate
    judged = "free of collision" if certificate.collision_free else f"**{certificate.reason}**"
    said = f"{judged}{pair(certificate.pair)}: {certificate.covers}, as the curve {reply.curve}"
    rows = [("certificate", said)]
    if not certificate.collision_free:
        rows.append(("free until", place_in_words(certificate.free_until.row, certificate.free_until.time)))
    if certificate.place is not None:
        rows.append(("refused", place_in_words(certificate.place.row, certificate.place.time)))
    rows += distances(reply)
    return [*table(("result", ""), rows), "", f"Judged by: {certificate.method}", ""]


def _limits(reply: CertifyReply) -> list[str]:
    limits = reply.limits
    uses = {name: getattr(limits, name) for name in limits.__struct_fields__}
    rows = [(name, *_used(use)) for name, use in uses.items() if use.joint is not None]
    return [*table(("limit of", "used at most", "by", "where"), rows), ""] if rows else []


def _used(use: LimitUse) -> tuple[str, str, str]:
    share = "it jumps" if use.share is None else f"{100 * use.share:.1f} %"
    where = "" if use.row is None else place_in_words(use.row, use.time)
    return share, use.joint or "", where
