"""Compare two plans: a table of both, and the fields that differ in any bit."""

from __future__ import annotations

import hashlib

import msgspec
from rich import box
from rich.console import RenderableType
from rich.table import Table

from guidefield.messages.replies import PlanReply, Timing

PLAN_FIELDS = ("status", "position_names", "velocity_names", "path", "trajectory", "guide_planes", "planner", "seed")
"""The fields of a reply that are the plan itself; the others are measured, or name the run."""


def motion_hash(reply: PlanReply) -> str:
    """Return the SHA-256 of the plan itself in hexadecimal: equal if and only if `list_differences` is empty."""
    return hashlib.sha256(b"\n".join(_encode_fields(reply).values())).hexdigest()


def list_differences(first: PlanReply, second: PlanReply) -> list[str]:
    """List the fields of the plan that differ in any bit, in the order of the reply."""
    one, other = _encode_fields(first), _encode_fields(second)
    return [name for name in PLAN_FIELDS if one[name] != other[name]]


def largest_step(first: PlanReply, second: PlanReply) -> float | None:
    """Return the largest difference of a coordinate of two paths [rad or m]; None if their shapes differ."""
    if [len(row) for row in first.path] != [len(row) for row in second.path]:
        return None
    rows = zip(first.path, second.path, strict=True)
    return max((abs(a - b) for one, other in rows for a, b in zip(one, other, strict=True)), default=0.0)


def comparison_table(first: PlanReply, second: PlanReply) -> RenderableType:
    """Make a table of outcome, motion, clearance and times of two plans, and of the fields that differ."""
    table = Table("", first.run_id, second.run_id, box=box.SIMPLE_HEAD)
    for (name, one), (_, other) in zip(_rows(first), _rows(second), strict=True):
        table.add_row(name, one, other)
    step = largest_step(first, second)
    parts = ", ".join(list_differences(first, second)) or "nothing: the same plan to the last bit"
    table.add_row("that differs", parts, "" if step is None else f"waypoints by at most {step:.3g}")
    return table


def _encode_fields(reply: PlanReply) -> dict[str, bytes]:
    return {name: msgspec.json.encode(getattr(reply, name)) for name in PLAN_FIELDS}


def _rows(reply: PlanReply) -> list[tuple[str, str]]:
    clearance, metrics = reply.clearance, reply.metrics
    return [
        ("status", reply.status.name),
        ("planner", f"{reply.planner}, seed {reply.seed}"),
        ("waypoints", str(len(reply.path))),
        ("length [rad]", _format_number(None if metrics is None else metrics.joint_path_length)),
        ("duration [s]", _format_number(None if metrics is None else metrics.duration)),
        ("clearance [mm]", _format_number(None if clearance is None else clearance.minimum, 1e3)),
        ("away from the ends [mm]", _format_number(None if clearance is None else clearance.inner, 1e3)),
        *(
            (f"{stage} [ms]", _format_number(getattr(reply.timing, stage), 1e3))
            for stage in msgspec.structs.asdict(Timing())
        ),
    ]


def _format_number(value: float | None, unit: float = 1.0) -> str:
    return "-" if value is None else f"{value * unit:.4g}"
