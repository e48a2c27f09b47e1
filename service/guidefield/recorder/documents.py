"""The words of a recording: a summary to read first, the request and the reply, and what identifies the run."""

from __future__ import annotations

import hashlib
import json
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import rerun as rr
from rerun.chunk import Chunk

from guidefield.errors import Status
from guidefield.messages import codec
from guidefield.messages.replies import MotionReply
from guidefield.messages.requests import MotionRequest
from guidefield.recorder.chunks import still
from guidefield.recorder.packing import MESSAGE_COMPONENT, large_scene, packed

if TYPE_CHECKING:
    from guidefield.robot.group.group import PlanningGroup
    from guidefield.scene.scene import Scene

REQUEST, REPLY, SUMMARY = "/documents/request", "/documents/reply", "/documents/summary"
PROPERTIES, MADE_WITH = "/__properties/plan", "made_with"
"""Entities of the documents and of what identifies a run; its component that names packages and their versions."""

SHORTENED = "*Rounded and shortened to be read; the message itself, exact, is in this entity's component `message`.*"

LONGEST_LIST = 12
"""Entries of a list that are shown; of a longer one the first and the last, and how many there are between."""

LONGEST_TEXT = 300
"""Characters of a text that are shown."""

COLUMN = 76
"""Characters of a line in the last column of a table."""

WIDTH = 110
"""Characters of a line within which a list of plain values stays."""


def documents_of(
    request: MotionRequest,
    reply: MotionReply,
    group: PlanningGroup,
    scene: Scene,
    figures: Mapping[str, Any],
    parts: Sequence[str],
    request_hash: str,
    made_with: str,
) -> Iterator[Chunk]:
    """The words of a run, whatever was asked.

    Args:
        request: As it came.
        reply: The answer to it.
        group: The joints that move.
        scene: The scene that they move in.
        figures: What its kind of run is identified by beside what all are.
        parts: Lines of the summary below how the run ended.
        request_hash: The request's `fingerprint`.
        made_with: The packages that it was made with, as `versions.made_with`.
    """
    known: dict[str, Any] = {
        "run_id": reply.run_id,
        "status": reply.status.name,
        "code": reply.status.code,
        "robot": group.robot.name,
        "scene": scene.name,
        "request_sha256": request_hash,
        **figures,
    }
    if reply.clearance is not None and reply.clearance.minimum is not None:
        known["clearance"] = reply.clearance.minimum
    known[MADE_WITH] = made_with
    yield Chunk.from_property(PROPERTIES.rpartition("/")[2], rr.AnyValues(**known))
    summary = "\n".join([*_headline(reply), *parts])
    yield still(SUMMARY, rr.TextDocument(summary, media_type=rr.MediaType.MARKDOWN))
    if large_scene(request) is None:
        yield _message_document(REQUEST, request, request)
    else:  # its scene is in an entity of its own
        yield _message_document(
            REQUEST, msgspec.structs.replace(request, scene=scene.name), request, scene_apart=[True]
        )
    yield _message_document(REPLY, reply, reply)


def fingerprint(request: MotionRequest) -> str:
    """The SHA-256 of a request, in hexadecimal digits."""
    return hashlib.sha256(codec.encode(request)).hexdigest()


def distances(reply: MotionReply) -> list[tuple[str, str]]:
    """What was kept from obstacles and between links, as rows of a table."""
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
    """A message to read, and beside it, in the component `message`, to the last bit for programs (packing.py)."""
    text = f"{SHORTENED}\n\n```json\n{readable(shown)}\n```"
    values = rr.AnyValues(**{MESSAGE_COMPONENT: packed(kept)}, **flags)
    return still(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), values)


def with_warning(chunks: Sequence[Chunk], text: str) -> list[Chunk]:
    """A recording's chunks, its summary beginning with a warning."""
    kept = [chunk for chunk in chunks if chunk.entity_path != SUMMARY]
    for chunk in chunks:
        if chunk.entity_path == SUMMARY:
            (summary,) = chunk.to_record_batch().column("TextDocument:text").to_pylist()[0]
            warned = "\n".join([*remarks_of([text]), summary])
            kept.append(still(SUMMARY, rr.TextDocument(warned, media_type=rr.MediaType.MARKDOWN)))
    return kept


def readable(value: Any, indent: int = 0) -> str:
    """A message or plain data as JSON for a person: six digits, short lists on one line, long ones cut and counted."""
    if isinstance(value, float):
        return f"{value:.6g}"
    inner = " " * (indent + 2)
    if isinstance(value, msgspec.Struct):  # field by field: of a long list only what is shown becomes plain
        value = _fields(value)
    if isinstance(value, bytes):
        value = msgspec.to_builtins(value)
    if isinstance(value, dict) and value:
        rows = [f"{inner}{json.dumps(key)}: {readable(one, indent + 2)}" for key, one in value.items()]
        return "{\n" + ",\n".join(rows) + "\n" + " " * indent + "}"
    if isinstance(value, list | tuple) and value:
        return _readable_list(list(value), indent)
    if isinstance(value, str) and len(value) > LONGEST_TEXT:
        return f"{json.dumps(value[:LONGEST_TEXT])} … {len(value) - LONGEST_TEXT} more characters"
    return json.dumps(msgspec.to_builtins(value), ensure_ascii=False)


def _fields(message: msgspec.Struct) -> dict[str, Any]:
    """The fields of a message, tagged as on the wire."""
    config, fields = message.__struct_config__, msgspec.structs.asdict(message)
    return fields if config.tag is None else {config.tag_field or "type": config.tag, **fields}


def _readable_list(values: list[Any], indent: int) -> str:
    inner = " " * (indent + 2)
    if len(values) <= 2 or not any(isinstance(one, dict | list | tuple | msgspec.Struct) for one in values):
        line = "[" + ", ".join(readable(one, indent + 2) for one in values) + "]"
        if len(line) <= WIDTH and "\n" not in line:
            return line
    if len(values) > LONGEST_LIST:
        first = LONGEST_LIST // 2
        left_out = f"… {len(values) - first - 1} more …"
        rows = [*(readable(one, indent + 2) for one in values[:first]), left_out, readable(values[-1], indent + 2)]
    else:
        rows = [readable(one, indent + 2) for one in values]
    return "[\n" + ",\n".join(inner + row for row in rows) + "\n" + " " * indent + "]"


def _headline(reply: MotionReply) -> list[str]:
    """How a run ended, in a sentence, and the values that it speaks about where it is no success."""
    lines = [f"## {reply.status.name}", "", reply.status.message, ""]
    if reply.status.code != Status.SUCCESS and reply.status.details:
        lines += ["```json", readable(reply.status.details), "```", ""]
    return lines


def remarks_of(remarks: Sequence[str]) -> list[str]:
    """What was odd, as a list."""
    return ["**Warnings**", "", *(f"- {remark}" for remark in remarks), ""] if remarks else []


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    """A table whose last column is broken into lines, each a row: the viewer cuts what is too wide for it."""
    lines = [head, tuple("---" for _ in head)]
    for *first, last in rows:
        begun, *more = textwrap.wrap(last, COLUMN, break_on_hyphens=False) or [""]
        lines += [(*first, begun), *((*("" for _ in first), line) for line in more)]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]


def pair(bodies: Sequence[str] | None) -> str:
    """Two bodies in brackets, if there are any."""
    return f" ({bodies[0]} - {bodies[1]})" if bodies else ""


def millimetres(distance: float | None) -> str:
    """A distance [m] for a person."""
    return "-" if distance is None else f"{1e3 * distance:.1f} mm"


def milliseconds(seconds: float) -> str:
    """A time [s] for a person."""
    return f"{1e3 * seconds:.1f} ms"
