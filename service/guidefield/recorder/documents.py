"""The documents of a recording: summary, request and reply, readable and packed, and properties that identify the run.

`stored.py` reads packed messages and `made_with` back, in files of all versions: entities and components stay.
"""

from __future__ import annotations

import hashlib
import json
import textwrap
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import msgspec
import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.errors import Status
from guidefield.messages import codec
from guidefield.messages.certify_reply import describe_certificate, describe_place
from guidefield.messages.execution import describe_deviation, describe_execution
from guidefield.messages.replies import CertifyReply, LimitUse, MotionReply, PlanReply, StepFigures, to_plain_data
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest
from guidefield.messages.scene import Scene as SceneMessage
from guidefield.recorder.chunks import still

if TYPE_CHECKING:
    from guidefield.planner.quality import ClearanceProfile
    from guidefield.robot.group.group import PlanningGroup
    from guidefield.scene.anchor import Anchor
    from guidefield.scene.scene import Scene


MESSAGE_COMPONENT = "message"  # the component of a document's entity that holds the message itself
COMPRESSION_LEVEL = 1  # of zlib: higher ones take three times as long and save nothing on numbers
LARGEST_MESSAGE = 1 << 28  # larger ones are written, but not read back: no less than `message` of docs/wire.md [bytes]

_M = TypeVar("_M", bound=msgspec.Struct)


SCENE = "/documents/scene"  # the entity that holds the message of a large scene; the request's is without it then
LARGE_BYTES = 32 * 1024
"""Size from which a scene has an entity, and in stores a file, of its own [bytes of MessagePack]."""


def encode(message: msgspec.Struct) -> bytes:
    """Return a message as MessagePack."""
    return codec.encode(message, codec.Encoding.MSGPACK)


def pack(message: msgspec.Struct) -> np.ndarray:
    """Return a message as compressed MessagePack, bytes of shape (n,), uint8."""
    return np.frombuffer(zlib.compress(encode(message), COMPRESSION_LEVEL), np.uint8)


def large_scene(request: MotionRequest) -> SceneMessage | None:
    """Return the scene that a request holds, if it is large."""
    scene = request.scene
    return scene if isinstance(scene, SceneMessage) and len(encode(scene)) >= LARGE_BYTES else None


def unpack(content: bytes, kind: type[_M]) -> _M:
    """Unpack a message; raises ValueError if it is none of that kind."""
    inflate = zlib.decompressobj()
    try:
        return msgspec.msgpack.decode(inflate.decompress(content, LARGEST_MESSAGE), type=kind)
    except (zlib.error, msgspec.DecodeError) as error:
        raise ValueError(f"what should be a {kind.__name__} is none: {error}") from error


REQUEST, REPLY, SUMMARY = "/documents/request", "/documents/reply", "/documents/summary"
PROPERTIES, MADE_WITH = "/__properties/plan", "made_with"
"""Entities of the documents and of the run's properties; the property that names packages and their versions."""
SHORTENED = "*Rounded and shortened to be read; the message itself, exact, is in this entity's component `message`.*"
LONGEST_LIST = 12
"""Entries of a list that are shown; of a longer one the first and the last, and how many there are between."""
LONGEST_TEXT = 300  # characters of a text that are shown
MAX_COLUMN_WIDTH = 76  # characters of a line in a table's last column, not more: the viewer cuts what is wider
MAX_LINE_WIDTH = 110  # characters of a list of plain values on one line

_to_json = json.JSONEncoder(ensure_ascii=False).encode


_Request_co = TypeVar("_Request_co", bound=MotionRequest, covariant=True)
_Reply_co = TypeVar("_Reply_co", bound=MotionReply, covariant=True)


@dataclass(frozen=True, eq=False)
class RecordedRun(Generic[_Request_co, _Reply_co]):
    """A run as its recording shows it."""

    group: PlanningGroup  # the joints that move, with the limits that hold for this request
    scene: Scene  # the scene that they move in; of a sequence, with carried objects as moving obstacles
    request: _Request_co
    reply: _Reply_co
    measured: ClearanceProfile | None  # the clearance along the motion, if there is one
    made_with: str  # the packages that it was made with, as `versions.describe_versions`
    anchor: Anchor | None = None  # what group, scene and measures are relative to, and all is drawn; None: the world

    def as_drawn(self) -> tuple[_Request_co, _Reply_co]:
        """Return request and reply relative to the anchor."""
        if self.anchor is None:
            return self.request, self.reply
        return self.anchor.inward(self.request), self.anchor.inward(self.reply)


Run = RecordedRun[MotionRequest, MotionReply]
PlanRun = RecordedRun[PlanRequest, PlanReply]
JudgedRun = RecordedRun[CertifyRequest, CertifyReply]


def _document_run(run: Run, figures: Mapping[str, Any], parts: Sequence[str], request_hash: str) -> Iterator[Chunk]:
    request, reply = run.request, run.reply
    known: dict[str, Any] = {
        "run_id": reply.run_id,
        "status": reply.status.name,
        "code": reply.status.code,
        "robot": run.group.robot.name,
        "scene": run.scene.name,
        "request_sha256": request_hash,
        **figures,
    }
    if reply.clearance is not None and reply.clearance.minimum is not None:
        known["clearance"] = reply.clearance.minimum
    known[MADE_WITH] = run.made_with
    if run.anchor is not None:
        known["drawn_from"] = run.anchor.place
        x, y, z = run.anchor.place
        parts = [f"Drawn as seen from the point ({x:.0f}, {y:.0f}, {z:.0f}) m of the world.", "", *parts]
    yield Chunk.from_property(PROPERTIES.rpartition("/")[2], rr.AnyValues(**known))
    summary = "\n".join([*_headline(reply), *parts])
    yield still(SUMMARY, rr.TextDocument(summary, media_type=rr.MediaType.MARKDOWN))
    if large_scene(request) is None:
        yield _message_document(REQUEST, request, request)
    else:  # its scene is in an entity of its own
        yield _message_document(
            REQUEST, msgspec.structs.replace(request, scene=run.scene.name), request, scene_apart=[True]
        )
    yield _message_document(REPLY, reply, reply)


def fingerprint(request: MotionRequest) -> str:
    """Return the SHA-256 of a request, in hexadecimal digits."""
    return hashlib.sha256(codec.encode(request)).hexdigest()


def distances(reply: MotionReply) -> list[tuple[str, str]]:
    """Return the distances from obstacles and between links, as rows of a table."""
    rows: list[tuple[str, str]] = []
    if (clear := reply.clearance) is not None:
        when = f" at {clear.time:.2f} s" if clear.time is not None else ""
        rows.append(("clearance", f"**{millimetres(clear.minimum)}**{pair(clear.pair)}{when}"))
        others = (clear.mean, clear.inner, clear.ends)
        rows.append(("… mean / inner / ends", " / ".join(millimetres(distance) for distance in others)))
    if (own := reply.self_clearance) is not None:
        rows.append(("to itself", f"{millimetres(own.minimum)}{pair(own.pair)}"))
    return rows


def _message_document(path: str, kept: msgspec.Struct, shown: msgspec.Struct, **flags: list[bool]) -> Chunk:
    """Document a message: readable, and exact for programs in the component `message`."""
    text = f"{SHORTENED}\n\n```json\n{readable(shown)}\n```"
    values = rr.AnyValues(**{MESSAGE_COMPONENT: pack(kept)}, **flags)
    return still(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), values)


def with_warning(chunks: Sequence[Chunk], text: str) -> list[Chunk]:
    """Return a recording's chunks with a warning at the begin of its summary."""
    kept = [chunk for chunk in chunks if chunk.entity_path != SUMMARY]
    for chunk in chunks:
        if chunk.entity_path == SUMMARY:
            (summary,) = chunk.to_record_batch().column("TextDocument:text").to_pylist()[0]
            warned = "\n".join([*remarks_of([text]), summary])
            kept.append(still(SUMMARY, rr.TextDocument(warned, media_type=rr.MediaType.MARKDOWN)))
    return kept


def readable(value: Any, indent: int = 0) -> str:
    """Write a message or plain data as JSON for a person: six digits, short lists on one line, long ones cut."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, bytes):
        value = msgspec.to_builtins(value)
    if isinstance(value, str):
        if len(value) > LONGEST_TEXT:
            return f"{json.dumps(value[:LONGEST_TEXT])} … {len(value) - LONGEST_TEXT} more characters"
        return _to_json(value)
    inner = " " * (indent + 2)
    if isinstance(value, msgspec.Struct):  # field by field: of a long list only what is shown becomes plain
        value = _fields(value)
    if isinstance(value, dict) and value:
        rows = [f"{inner}{json.dumps(key)}: {readable(one, indent + 2)}" for key, one in value.items()]
        return "{\n" + ",\n".join(rows) + "\n" + " " * indent + "}"
    if isinstance(value, list | tuple) and value:
        return _readable_list(list(value), indent)
    return _to_json(msgspec.to_builtins(value))


def _fields(message: msgspec.Struct) -> dict[str, Any]:
    config, fields = message.__struct_config__, msgspec.structs.asdict(message)
    return fields if config.tag is None else {config.tag_field or "type": config.tag, **fields}


NESTED = (dict, list, tuple, msgspec.Struct)  # types of values that are shown on lines of their own


def _readable_list(values: list[Any], indent: int) -> str:
    inner = " " * (indent + 2)
    if len(values) <= 2 or not any(isinstance(one, NESTED) for one in values):
        line = "[" + ", ".join(readable(one, indent + 2) for one in values) + "]"
        if len(line) <= MAX_LINE_WIDTH and "\n" not in line:
            return line
    if len(values) > LONGEST_LIST:
        first = LONGEST_LIST // 2
        left_out = f"… {len(values) - first - 1} more …"
        rows = [*(readable(one, indent + 2) for one in values[:first]), left_out, readable(values[-1], indent + 2)]
    else:
        rows = [readable(one, indent + 2) for one in values]
    return "[\n" + ",\n".join(inner + row for row in rows) + "\n" + " " * indent + "]"


def _headline(reply: MotionReply) -> list[str]:
    lines = [f"## {reply.status.name}", "", reply.status.message, ""]
    if reply.status.code != Status.SUCCESS and reply.status.details:
        lines += ["```json", readable(reply.status.details), "```", ""]
    return lines


def remarks_of(remarks: Sequence[str]) -> list[str]:
    """Return warnings as lines of Markdown."""
    return ["**Warnings**", "", *(f"- {remark}" for remark in remarks), ""] if remarks else []


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Return a table in Markdown; lines of the last column are rows, because the viewer cuts what is too wide."""
    lines = [head, tuple("---" for _ in head)]
    for *first, last in rows:
        is_short = len(last) <= MAX_COLUMN_WIDTH
        begun, *more = [last] if is_short else textwrap.wrap(last, MAX_COLUMN_WIDTH, break_on_hyphens=False)
        lines += [(*first, begun), *((*("" for _ in first), line) for line in more)]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]


def pair(bodies: Sequence[str] | None) -> str:
    """Return two bodies in brackets, if there are any."""
    return f" ({bodies[0]} - {bodies[1]})" if bodies else ""


def millimetres(distance: float | None) -> str:
    """Return a distance [m] for a person."""
    return "-" if distance is None else f"{1e3 * distance:.1f} mm"


def milliseconds(seconds: float) -> str:
    """Return a time [s] for a person."""
    return f"{1e3 * seconds:.1f} ms"


SHORTEST_SHOWN_S = 5e-5  # shortest time of a stage that is listed [s]


def document_plan(run: PlanRun, remarks: Sequence[str]) -> Iterator[Chunk]:
    """Document a plan: its result in figures, its origin, its messages, and remarks beside its warnings."""
    reply, group = run.reply, run.group
    figures: dict[str, Any] = {
        "planner": reply.planner,
        "objective": reply.objective,
        "seed": reply.seed,
        "planning_seconds": reply.timing.total,
    }
    if reply.metrics is not None:
        figures["duration"] = reply.metrics.duration
    parts = [*remarks_of((*reply.warnings, *remarks)), *_plan_results(reply, group), *_steps(reply), *_stages(reply)]
    request_hash = fingerprint(run.request)
    yield from _document_run(run, figures, [*parts, *_origin(request_hash, run)], request_hash)


def _plan_results(reply: PlanReply, group: PlanningGroup) -> list[str]:
    rows = distances(reply)
    if (metrics := reply.metrics) is not None:
        rows.append(("duration", f"{metrics.duration:.2f} s"))
        unit = _unit(group)
        ways = f"{metrics.joint_path_length:.2f} {unit} / {metrics.tip_path_length:.2f} m"
        rows.append(("path of joints / tip", ways))
        rows.append(("peak jerk", f"{metrics.peak_jerk:.0f} {unit}/s³"))
    rows.append(("certificate", describe_certificate(reply)))
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
    if not reply.steps:
        return []
    rows = [
        (
            f"steps[{index}]",
            f"{one.begin:.2f} to {one.end:.2f} s",
            millimetres(None if one.clearance is None else one.clearance.minimum),
            "; ".join([*_list_handling(one), *(f"{may.object} may touch {may.obstacle}" for may in one.permissions)]),
        )
        for index, one in enumerate(reply.steps)
    ]
    return [*table(("step", "time", "clearance", "objects"), rows), ""]


def _list_handling(step: StepFigures) -> list[str]:
    words = {"holds": ", ".join(step.held), "puts down": step.detached, "picks up": step.attached}
    return [f"{verb} {names}" for verb, names in words.items() if names]


def _stages(reply: PlanReply) -> list[str]:
    """List the stages, and other parts of the time; a stage that came once has its time in its own row."""
    rows = [(f"{one.name}{_plane(one.plane, reply)}", milliseconds(one.seconds), one.outcome) for one in reply.stages]
    times = Counter(one.name for one in reply.stages)
    spent = {name: seconds for name, seconds in to_plain_data(reply.timing).items() if seconds and name != "total"}
    for name, seconds in spent.items():
        if times[name] != 1 and seconds >= SHORTEST_SHOWN_S:
            rows.append((f"all of {name}" if times[name] else name, milliseconds(seconds), ""))
    rows.append(("**total**", f"**{milliseconds(reply.timing.total)}**", ""))
    return [*table(("stage", "time", "outcome"), rows), ""]


def _origin(request_hash: str, run: PlanRun) -> list[str]:
    group, scene, reply = run.group, run.scene, run.reply
    urdf = hashlib.sha256(group.robot.source.urdf_text.encode()).hexdigest()[:12]
    rows = [
        ("run", reply.run_id),
        ("robot", f"{group.robot.name} (URDF {urdf}), {len(group.joints)} joints, tip {group.tip}"),
        ("scene", f"{scene.name}: {len(scene.obstacles)} obstacles, {len(reply.guide_planes)} guide planes"),
        ("request", request_hash[:12]),
        ("planner, objective, seed", f"{reply.planner}, {reply.objective}, {reply.seed}"),
        ("made with", run.made_with),
    ]
    return table(("about", ""), rows)


def _plane(index: int | None, reply: PlanReply) -> str:
    if index is None:
        return ""
    return f" to {reply.guide_planes[index].name if index < len(reply.guide_planes) else index}"


def _unit(group: PlanningGroup) -> str:
    kinds = {joint.kind.value for joint in group.joints}
    if kinds == {"prismatic"}:
        return "m"
    return "rad" if kinds.isdisjoint(("prismatic", "planar", "floating")) else "(rad, m)"


def document_judgement(run: JudgedRun, remarks: Sequence[str]) -> Iterator[Chunk]:
    """Document a judgement: the verdict in figures, its origin, its messages, and remarks."""
    reply, group, scene = run.reply, run.group, run.scene
    request_hash = fingerprint(run.request)
    parts = [*_judgement_results(reply), *_limits(reply), *remarks_of((*reply.warnings, *remarks))]
    rows = [
        ("run", reply.run_id),
        ("robot", f"{group.robot.name}, {len(group.joints)} joints, tip {group.tip}"),
        ("scene", f"{scene.name}: {len(scene.obstacles)} obstacles"),
        ("request", request_hash[:12]),
        ("time", f"certify {milliseconds(reply.timing.certify)}, measure {milliseconds(reply.timing.measure)}"),
        ("made with", run.made_with),
    ]
    parts += table(("about", ""), rows)
    figures = {"curve": reply.curve, "seconds": reply.timing.total}
    yield from _document_run(run, figures, parts, request_hash)


def _judgement_results(reply: CertifyReply) -> list[str]:
    certificate = reply.certificate
    verdict = "free of collision" if certificate.collision_free else f"**{certificate.reason}**"
    said = f"{verdict}{pair(certificate.pair)}: {certificate.covers}, as the curve {reply.curve}"
    rows = [("certificate", said)]
    if not certificate.collision_free:
        rows.append(("free until", describe_place(certificate.free_until.row, certificate.free_until.time)))
    if certificate.place is not None:
        rows.append(("refused", describe_place(certificate.place.row, certificate.place.time)))
    if reply.execution is not None:
        rows.append(("executed as", describe_execution(reply.execution)))
    deviation = reply.deviation if reply.execution is None else reply.execution.deviation
    if deviation is not None:
        rows.append(("off the plan", describe_deviation(deviation)))
    rows += distances(reply)
    return [*table(("result", ""), rows), "", f"Judged by: {certificate.method}", ""]


def _limits(reply: CertifyReply) -> list[str]:
    limits = reply.limits
    uses = {name: getattr(limits, name) for name in limits.__struct_fields__}
    rows = [(name, *_describe_use(use)) for name, use in uses.items() if use.joint is not None]
    return [*table(("limit of", "used at most", "by", "where"), rows), ""] if rows else []


def _describe_use(use: LimitUse) -> tuple[str, str, str]:
    share = "it jumps" if use.share is None else f"{100 * use.share:.1f} %"
    where = "" if use.row is None else describe_place(use.row, use.time)
    return share, use.joint or "", where
