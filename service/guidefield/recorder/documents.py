"""The words of a recording: a summary to read first, the request and the reply, the planner's log."""

from __future__ import annotations

import functools
import hashlib
import json
import platform
import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import msgspec
import rerun as rr
from rerun.chunk import Chunk

from guidefield.errors import Status
from guidefield.messages import codec
from guidefield.messages.certificate_in_words import certified
from guidefield.messages.replies import MotionReply, PlanReply, as_plain_data
from guidefield.messages.requests import PlanRequest
from guidefield.recorder.chunks import still
from guidefield.recorder.packing import MESSAGE_COMPONENT, packed

if TYPE_CHECKING:
    from guidefield.robot.group.group import PlanningGroup
    from guidefield.scene.scene import Scene

REQUEST, REPLY, SUMMARY = "/documents/request", "/documents/reply", "/documents/summary"
PROPERTIES, MADE_WITH = "/__properties/plan", "made_with"
"""Entities of the documents and of what identifies a run; its component that names packages and their versions."""

OURS = "guidefield"
"""The package that planned."""

PACKAGES = (OURS, "pin", "coal", "example-robot-data", "numpy", "numba", "rerun-sdk")
"""Whose versions are recorded."""

SHORTENED = "*Rounded and shortened to be read; the message itself, exact, is in this entity's component `message`.*"

LONGEST_LIST = 12
"""Entries of a list that are shown; of a longer one the first and the last, and how many there are between."""

LONGEST_TEXT = 300
"""Characters of a text that are shown."""

LEAST_TOLD = 5e-5
"""A shorter time is left out [s]."""

COLUMN = 76
"""Characters of a line in the last column of a table."""

WIDTH = 110
"""Characters of a line within which a list of plain values stays."""


def message_document(path: str, message: msgspec.Struct) -> Chunk:
    """A message to read, and beside it, in the component `message`, to the last bit for programs (packing.py)."""
    kept = {MESSAGE_COMPONENT: packed(message)}
    shown = f"{SHORTENED}\n\n```json\n{readable(as_plain_data(message))}\n```"
    return still(path, rr.TextDocument(shown, media_type=rr.MediaType.MARKDOWN), rr.AnyValues(**kept))


def summary_document(
    request: PlanRequest, reply: PlanReply, group: PlanningGroup, scene: Scene, remarks: Sequence[str]
) -> Chunk:
    """How the plan ended, in figures; what it was about; what it was made with."""
    parts = [*headline(reply), *remarks_of((*reply.warnings, *remarks)), *_figures(reply, group), *_stages(reply)]
    parts += _origin(request, reply, group, scene)
    return still(SUMMARY, rr.TextDocument("\n".join(parts), media_type=rr.MediaType.MARKDOWN))


def with_warning(chunks: Sequence[Chunk], text: str) -> list[Chunk]:
    """A recording's chunks, its summary beginning with a warning."""
    kept = [chunk for chunk in chunks if chunk.entity_path != SUMMARY]
    for chunk in chunks:
        if chunk.entity_path == SUMMARY:
            (summary,) = chunk.to_record_batch().column("TextDocument:text").to_pylist()[0]
            warned = "\n".join([*remarks_of([text]), summary])
            kept.append(still(SUMMARY, rr.TextDocument(warned, media_type=rr.MediaType.MARKDOWN)))
    return kept


def properties(request: PlanRequest, reply: PlanReply, group: PlanningGroup, scene: Scene) -> Iterator[Chunk]:
    """What identifies a run, to be queried across many recordings."""
    figures: dict[str, Any] = {
        "run_id": reply.run_id,
        "status": reply.status.name,
        "code": reply.status.code,
        "robot": group.robot.name,
        "scene": scene.name,
        "planner": reply.planner,
        "seed": reply.seed,
        "request_sha256": hashlib.sha256(codec.encode(request)).hexdigest(),
        "planning_seconds": reply.timing.total,
    }
    if reply.metrics is not None:
        figures["duration"] = reply.metrics.duration
    if reply.clearance is not None and reply.clearance.minimum is not None:
        figures["clearance"] = reply.clearance.minimum
    figures[MADE_WITH] = made_with()
    yield Chunk.from_property("plan", rr.AnyValues(**figures))


def readable(value: Any, indent: int = 0) -> str:
    """Plain data as JSON for a person: six digits, short lists on one line, long ones cut and counted."""
    inner = " " * (indent + 2)
    if isinstance(value, dict) and value:
        rows = [f"{inner}{json.dumps(key)}: {readable(one, indent + 2)}" for key, one in value.items()]
        return "{\n" + ",\n".join(rows) + "\n" + " " * indent + "}"
    if isinstance(value, list | tuple) and value:
        return _readable_list(list(value), indent)
    if isinstance(value, str) and len(value) > LONGEST_TEXT:
        return f"{json.dumps(value[:LONGEST_TEXT])} … {len(value) - LONGEST_TEXT} more characters"
    if isinstance(value, float):
        return f"{value:.6g}"
    return json.dumps(value, ensure_ascii=False)


def _readable_list(values: list[Any], indent: int) -> str:
    inner = " " * (indent + 2)
    if not any(isinstance(one, dict | list | tuple) for one in values) or len(values) <= 2:
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


def headline(reply: MotionReply) -> list[str]:
    """How a run ended, in a sentence, and the values that it speaks about where it is no success."""
    lines = [f"## {reply.status.name}", "", reply.status.message, ""]
    if reply.status.code != Status.SUCCESS and reply.status.details:
        lines += ["```json", readable(reply.status.details), "```", ""]
    return lines


def _figures(reply: PlanReply, group: PlanningGroup) -> list[str]:
    rows: list[tuple[str, str]] = []
    if (clear := reply.clearance) is not None:
        where = f" ({clear.pair[0]} - {clear.pair[1]})" if clear.pair else ""
        when = f" at {clear.time:.2f} s" if clear.time is not None else ""
        rows.append(("clearance", f"**{millimetres(clear.minimum)}**{where}{when}"))
        others = (clear.mean, clear.inner, clear.ends)
        rows.append(("… mean / inner / ends", " / ".join(millimetres(distance) for distance in others)))
    if (own := reply.self_clearance) is not None:
        where = f" ({own.pair[0]} - {own.pair[1]})" if own.pair else ""
        rows.append(("to itself", f"{millimetres(own.minimum)}{where}"))
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


def remarks_of(remarks: Sequence[str]) -> list[str]:
    """What was odd, as a list."""
    return ["**Warnings**", "", *(f"- {remark}" for remark in remarks), ""] if remarks else []


def _origin(request: PlanRequest, reply: PlanReply, group: PlanningGroup, scene: Scene) -> list[str]:
    urdf = hashlib.sha256(group.robot.source.urdf_text.encode()).hexdigest()[:12]
    rows = [
        ("run", reply.run_id),
        ("robot", f"{group.robot.name} (URDF {urdf}), {len(group.joints)} joints, tip {group.tip}"),
        ("scene", f"{scene.name}: {len(scene.obstacles)} obstacles, {len(reply.guide_planes)} guide planes"),
        ("request", hashlib.sha256(codec.encode(request)).hexdigest()[:12]),
        ("planner, seed", f"{reply.planner}, {reply.seed}"),
        ("made with", made_with()),
    ]
    return table(("about", ""), rows)


@functools.cache
def made_with() -> str:
    """The packages and their versions, as `reading` takes them apart again."""
    return ", ".join(f"{name} {text}" for name, text in versions().items())


def versions() -> dict[str, str]:
    """Of each of `PACKAGES`, and of Python."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # run from the source tree
            found[package] = "unknown"
    return found


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


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    """A table whose last column is broken into lines, each a row: the viewer cuts what is too wide for it."""
    lines = [head, tuple("---" for _ in head)]
    for *first, last in rows:
        begun, *more = textwrap.wrap(last, COLUMN, break_on_hyphens=False) or [""]
        lines += [(*first, begun), *((*("" for _ in first), line) for line in more)]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]


def millimetres(distance: float | None) -> str:
    """A distance [m] for a person."""
    return "-" if distance is None else f"{1e3 * distance:.1f} mm"


def milliseconds(seconds: float) -> str:
    """A time [s] for a person."""
    return f"{1e3 * seconds:.1f} ms"
