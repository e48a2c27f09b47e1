"""Tables of plans and verdicts for a terminal."""

from __future__ import annotations

import shlex
import shutil
import sys
from pathlib import Path

from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from guidefield.errors import Status
from guidefield.messages.certify_reply import describe_certificate, describe_place
from guidefield.messages.replies import CertifyReply, ClearanceFigures, LimitUse, MotionReply, PlanReply, Stage, Timing


def plan_table(reply: PlanReply, title: str = "plan") -> RenderableType:
    """Make a table of a plan: outcome, motion, clearance and its place, certificate, time by stage, recording.

    Args:
        reply: The reply.
        title: Title of the table.
    """
    return _make_table(title, [*_plan_rows(reply), *_last_rows(reply)])


def certify_table(reply: CertifyReply, title: str = "certify") -> RenderableType:
    """Make a table of a verdict: the free part, clearance and its place, shares of limits, recording.

    Args:
        reply: The reply.
        title: Title of the table.
    """
    return _make_table(title, [*_verdict_rows(reply), *_last_rows(reply)])


def _make_table(title: str, rows: list[tuple[str, RenderableType]]) -> Table:
    """Make a table of named values below a title."""
    table = Table(title=title, title_justify="left", title_style="bold", box=box.ROUNDED, show_header=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def _verdict_rows(reply: CertifyReply) -> list[tuple[str, RenderableType]]:
    certificate = reply.certificate
    verdict = ("collision-free", "green") if certificate.collision_free else (certificate.reason, "yellow")
    evaluations = _format_count(certificate.evaluations, "evaluation")
    rows: list[tuple[str, RenderableType]] = [
        ("status", _status(reply)),
        ("run", Text(f"{reply.run_id}  (curve {reply.curve})")),
        ("certificate", Text.assemble(verdict, f", {certificate.covers}: {certificate.method}, {evaluations}")),
    ]
    if not certificate.collision_free:
        rows.append(("free until", Text(describe_place(certificate.free_until.row, certificate.free_until.time))))
    if certificate.place is not None:
        where = f"{describe_place(certificate.place.row, certificate.place.time)}{_format_pair(certificate.pair)}"
        rows.append(("refused at", Text(where)))
    rows += _distance_rows(reply)
    for name in reply.limits.__struct_fields__:
        use: LimitUse = getattr(reply.limits, name)
        if use.joint is not None and use.row is not None:
            share = "jumps below it" if use.share is None else f"{100 * use.share:.1f} %"
            rows.append((f"{name} limit", Text(f"{share} by {use.joint}, at {describe_place(use.row, use.time)}")))
    return rows


def _status(reply: MotionReply) -> Text:
    style = "bold green" if reply.status.code == Status.SUCCESS else "bold red"
    return Text.assemble((reply.status.name, style), f"  {reply.status.message}")


def _distance_rows(reply: MotionReply) -> list[tuple[str, RenderableType]]:
    """Make the rows of the distances to obstacles, and between links."""
    rows: list[tuple[str, RenderableType]] = []
    if reply.clearance is not None:
        rows.append(("clearance", Text(_clearance(reply.clearance))))
    own = reply.self_clearance
    if own is not None and own.minimum is not None:
        rows.append(("to itself", Text(f"{_format_millimetres(own.minimum)}{_format_pair(own.pair)}")))
    return rows


def _last_rows(reply: MotionReply) -> list[tuple[str, RenderableType]]:
    """Make the rows of time, warnings, recording and proof."""
    rows: list[tuple[str, RenderableType]] = [("time", Text(_timing(reply.timing)))]
    rows.extend(("warning", Text(warning, style="yellow")) for warning in reply.warnings)
    if reply.recording is not None:
        rows.append(("recording", Text(reply.recording)))
        if reply.recording.endswith(".rrd"):
            rows.append(("to open it", Text(f"{_this_command()} show {shlex.quote(reply.recording)}")))
    if reply.proof is not None:
        rows.append(("proof", Text(reply.proof)))
        if reply.proof.endswith(".npz"):
            rows.append(("to check it", Text(f"{_this_command()} certify --replay {shlex.quote(reply.proof)}")))
    return rows


def _plan_rows(reply: PlanReply) -> list[tuple[str, RenderableType]]:
    rows: list[tuple[str, RenderableType]] = [
        ("status", _status(reply)),
        ("run", Text(f"{reply.run_id}  (planner {reply.planner}, objective {reply.objective}, seed {reply.seed})")),
        ("path", Text(_path(reply))),
    ]
    if reply.guide_planes:
        rows.append(("guide planes", Text(" → ".join(plane.name for plane in reply.guide_planes))))
    rows += _distance_rows(reply)
    rows.append(("certificate", _certificate(reply)))
    rows.extend(("stage", Text(_stage(reply, stage))) for stage in reply.stages)
    return rows


def _this_command() -> str:
    """Return the command that runs this command line, which may not be on the PATH."""
    if shutil.which("guidefield") is not None:
        return "guidefield"
    beside = Path(sys.executable).with_name("guidefield")
    here = Path.cwd()
    return shlex.quote(str(beside.relative_to(here) if beside.is_relative_to(here) else beside))


def _path(reply: PlanReply) -> str:
    parts = [_format_count(len(reply.path), "waypoint")]
    if reply.metrics is not None:
        parts.append(f"{reply.metrics.joint_path_length:.2f} rad or m in the joints")
        parts.append(f"{reply.metrics.tip_path_length:.2f} m of the tip")
        parts.append(f"{reply.metrics.duration:.2f} s long")
    return ", ".join(parts)


def _clearance(clearance: ClearanceFigures) -> str:
    if clearance.minimum is None:
        return "no obstacle"
    text = f"{_format_millimetres(clearance.minimum)}{_format_pair(clearance.pair)}"
    if clearance.time is not None:
        text += f", at {clearance.time:.2f} s"
    if clearance.inner is not None:
        text += f"; away from the ends {_format_millimetres(clearance.inner)}"
    if clearance.mean is not None:
        text += f"; on average {_format_millimetres(clearance.mean)}"
    return text


def _certificate(reply: PlanReply) -> Text:
    figures = reply.certificate
    said = (describe_certificate(reply), "green" if figures.collision_free else "yellow")
    return Text.assemble(said, f", {_format_count(figures.evaluations, 'evaluation')}")


def _stage(reply: PlanReply, stage: Stage) -> str:
    about = ""
    if stage.plane is not None and stage.plane < len(reply.guide_planes):
        about = f" {reply.guide_planes[stage.plane].name}"
    return f"{stage.name}{about}: {stage.outcome}, {_format_time(stage.seconds)}"


def _timing(timing: Timing) -> str:
    spent = [
        ("queue", timing.queue),
        ("load", timing.load),
        ("ends", timing.ends),
        ("guide", timing.guide),
        ("connect", timing.connect),
        ("relax", timing.relax),
        ("parameterize", timing.parameterize),
        ("certify", timing.certify),
        ("measure", timing.measure),
    ]
    parts = ", ".join(f"{name} {_format_time(seconds)}" for name, seconds in spent if seconds >= 5e-5)
    return f"{_format_time(timing.total)} in all" + (f" ({parts})" if parts else "")


def _format_count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _format_pair(pair: list[str] | None) -> str:
    return f" between {pair[0]} and {pair[1]}" if pair else ""


def _format_millimetres(metres: float) -> str:
    return f"{1e3 * metres:.1f} mm"


def _format_time(seconds: float) -> str:
    return f"{seconds:.2f} s" if seconds >= 1.0 else f"{1e3 * seconds:.1f} ms"
