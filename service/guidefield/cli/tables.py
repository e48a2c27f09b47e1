"""Tables of plans, verdicts and robots for a terminal; the notebook shows the rows of plans and verdicts, too.

They are for people, and words may be changed: programs read the replies' JSON.
"""

from __future__ import annotations

import shlex
import shutil
import sys
from collections import Counter
from itertools import groupby
from pathlib import Path

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from guidefield.errors import Status
from guidefield.messages.certify_reply import describe_certificate, describe_effort, describe_place, describe_speed
from guidefield.messages.execution import describe_deviation, describe_execution
from guidefield.messages.replies import (
    CertifyReply,
    ClearanceFigures,
    GeometryInfo,
    JointInfo,
    LimitUse,
    MotionReply,
    PlanReply,
    RobotReply,
    RobotsReply,
    RobotSummary,
    Stage,
    Timing,
)

MAX_LISTED_GROUPS = 4  # number of groups of a robot that the list names at most


def robots_table(reply: RobotsReply, *, narrow: bool = False) -> RenderableType:
    """Make a table of the robots, variants of a family together, and of those that are unusable, with reasons.

    A narrow one has neither groups nor sources.
    """
    columns = ("name", "DoF", "joints", "tip") if narrow else ("name", "DoF", "joints", "tip", "groups", "from")
    table = _make_headed_table(*columns)
    usable = [robot for robot in reply.robots if robot.problem is None]
    for _, family in groupby(sorted(usable, key=lambda r: (r.family, r.name)), key=lambda r: r.family):
        for robot in family:
            dof = "" if robot.dof is None else str(robot.dof)
            cells = (robot.name, dof, _count_kinds(robot), robot.tip or "", _list_groups(robot.groups), robot.source)
            table.add_row(*cells[: len(columns)])
    problems = [Text(f"{robot.name}: {robot.problem}") for robot in reply.robots if robot.problem is not None]
    if not problems:
        return table
    return Group(table, Text("These can't be used:", style="bold"), *problems)


def robot_table(reply: RobotReply) -> RenderableType:
    """Make tables of one robot: joints, limits and their sources, groups, shapes, link pairs that aren't tested."""
    joints = _make_headed_table("joint", "kind", "range", "velocity", "acceleration")
    for joint in reply.joints:
        joints.add_row(
            joint.name,
            joint.kind if joint.mimics is None else _describe_mimic(joint),
            _format_range(joint),
            f"{_format_numbers(joint.velocity)} ({joint.velocity_source})",
            f"{_format_numbers(joint.acceleration)} ({joint.acceleration_source})",
        )
    pairs = _make_headed_table("links not tested against each other", "reason")
    for pair in reply.pairs_left_out:
        pairs.add_row(" and ".join(pair.links), pair.reason)
    kinds = Counter(shape.judged_as for shape in reply.geometry)
    return Group(
        Text(reply.name, style="bold"),
        Text(f"tip {reply.tip}; {len(reply.links)} links, {len(reply.frames)} frames"),
        *([] if reply.rest_state is None else [Text(f"rest: the SRDF's state {reply.rest_state}")]),
        Text(f"collision shapes: {', '.join(f'{count} {kind}' for kind, count in kinds.items()) or 'none'}"),
        *(Text(line) for line in _describe_covers(reply.geometry)),
        *(Text(f"group {name}: {', '.join(members)}") for name, members in reply.groups.items()),
        joints,
        Text(f"{len(reply.collision_pairs)} pairs of links are tested against each other"),
        *([pairs] if reply.pairs_left_out else []),
        *(Text(warning, style="yellow") for warning in reply.warnings),
    )


def _describe_covers(geometry: list[GeometryInfo]) -> list[str]:
    lines = []
    covers = [shape.cover for shape in geometry if shape.cover is not None]
    if covers and len(covers) == len(geometry):
        lines.append(
            f"covered by {sum(cover.spheres for cover in covers)} spheres that stand out by at most "
            f"{1e3 * max(cover.overhang for cover in covers):.1f} mm; "
            f"{sum(cover.inner_balls for cover in covers)} balls inside"
        )
    parts = [shape.parts for shape in geometry if shape.parts is not None]
    if parts:
        meshes = "1 mesh is" if len(parts) == 1 else f"{len(parts)} meshes are"
        lines.append(
            f"{meshes} contained in {sum(part.count for part in parts)} convex parts that stand off by "
            f"at most {1e3 * max(part.stand_off for part in parts):.1f} mm"
        )
    return lines


def _make_headed_table(name: str, *headings: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column(name, no_wrap=True)  # to be typed again
    for heading in headings:
        table.add_column(heading, overflow="fold")
    return table


def _count_kinds(robot: RobotSummary) -> str:
    kinds = [f"{count} {kind}" for kind, count in robot.joint_kinds.items()]
    if robot.mimics:
        kinds.append(f"{robot.mimics} that follow")
    return ", ".join(kinds) or "none"


def _list_groups(groups: list[str]) -> str:
    more = len(groups) - MAX_LISTED_GROUPS
    return ", ".join(groups[:MAX_LISTED_GROUPS]) + (f" and {more} more" if more > 0 else "")


def _describe_mimic(joint: JointInfo) -> str:
    times = "" if joint.multiplier == 1.0 else f"{joint.multiplier:g} * "
    sign = "-" if joint.offset < 0.0 else "+"
    offset = f" {sign} {abs(joint.offset):g}" if joint.offset else ""
    return f"{joint.kind}, = {times}{joint.mimics}{offset}"


def _format_range(joint: JointInfo) -> str:
    pairs = zip(joint.lower, joint.upper, strict=True)
    return ", ".join(
        "no limits" if lower is None and upper is None else f"{_format_limit(lower)} … {_format_limit(upper)}"
        for lower, upper in dict.fromkeys(pairs)
    )


def _format_limit(value: float | None) -> str:
    return "none" if value is None else f"{value:.4g}"


def _format_numbers(values: list[float]) -> str:
    return ", ".join(f"{value:.4g}" for value in dict.fromkeys(values))


def motion_table(reply: MotionReply, title: str | None = None) -> RenderableType:
    """Make a table of a plan or a verdict; its title, unless given, says which it is."""
    heading = title or ("plan" if isinstance(reply, PlanReply) else "certify")
    table = Table(title=heading, title_justify="left", title_style="bold", box=box.ROUNDED, show_header=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for row in motion_rows(reply):
        table.add_row(*row)
    return table


def motion_rows(reply: MotionReply) -> list[tuple[str, Text]]:
    """List the names and contents of a table's rows.

    Of a plan these are outcome, motion, clearance and its place, certificate, time by stage and recording, of a verdict
    the free part, clearance and its place, shares of limits and recording.
    """
    return [*(_plan_rows(reply) if isinstance(reply, PlanReply) else _verdict_rows(reply)), *_last_rows(reply)]


def _verdict_rows(reply: CertifyReply) -> list[tuple[str, Text]]:
    certificate = reply.certificate
    verdict = ("collision-free", "green") if certificate.collision_free else (certificate.reason, "yellow")
    evaluations = _format_count(certificate.evaluations, "evaluation")
    rows: list[tuple[str, Text]] = [
        ("status", _status(reply)),
        ("run", Text(f"{reply.run_id}  (curve {reply.curve})")),
        ("certificate", Text.assemble(verdict, f", {certificate.covers}: {certificate.method}, {evaluations}")),
    ]
    if not certificate.collision_free:
        rows.append(("free until", Text(describe_place(certificate.free_until.row, certificate.free_until.time))))
    if certificate.place is not None:
        where = f"{describe_place(certificate.place.row, certificate.place.time)}{_format_pair(certificate.pair)}"
        rows.append(("refused at", Text(where)))
    if reply.deviation is not None:
        rows.append(("off the plan", Text(describe_deviation(reply.deviation))))
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


def _distance_rows(reply: MotionReply) -> list[tuple[str, Text]]:
    rows: list[tuple[str, Text]] = []
    if reply.execution is not None:
        leaves = f"leaves the plan by {describe_deviation(reply.execution.deviation)}"
        rows.append(("as executed", Text(f"{describe_execution(reply.execution)}; {leaves}")))
    if reply.clearance is not None:
        rows.append(("clearance", Text(_clearance(reply.clearance))))
    rows += [("in space", Text(describe_speed(use))) for use in reply.cartesian]
    if reply.effort is not None and (strongest := describe_effort(reply.effort)) is not None:
        rows.append(("torque", Text(strongest)))
    own = reply.self_clearance
    if own is not None and own.minimum is not None:
        rows.append(("to itself", Text(f"{_format_millimetres(own.minimum)}{_format_pair(own.pair)}")))
    return rows


def _last_rows(reply: MotionReply) -> list[tuple[str, Text]]:
    rows: list[tuple[str, Text]] = [("time", Text(_timing(reply.timing)))]
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


def _plan_rows(reply: PlanReply) -> list[tuple[str, Text]]:
    rows: list[tuple[str, Text]] = [
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
    names = ("queue", "load", "ends", "guide", "connect", "relax", "parameterize", "certify", "measure")
    spent = [(name, getattr(timing, name)) for name in names]
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
