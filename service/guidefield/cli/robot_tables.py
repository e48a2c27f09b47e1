"""Tables of robots for a terminal: the list, and one robot in detail."""

from __future__ import annotations

from collections import Counter
from itertools import groupby

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from guidefield.messages.replies import GeometryInfo, JointInfo, RobotReply, RobotsReply, RobotSummary

MAX_LISTED_GROUPS = 4
"""The largest number of groups in a line of the list."""


def robots_table(reply: RobotsReply) -> RenderableType:
    """Make a table of the robots, variants of a family together, and of those that are unusable, with reasons."""
    table = _make_table("name", "DoF", "joints", "groups", "tip", "from")
    usable = [robot for robot in reply.robots if robot.problem is None]
    for _, family in groupby(sorted(usable, key=lambda r: (r.family, r.name)), key=lambda r: r.family):
        for robot in family:
            dof = "" if robot.dof is None else str(robot.dof)
            table.add_row(
                robot.name, dof, _count_kinds(robot), _list_groups(robot.groups), robot.tip or "", robot.source
            )
    problems = [Text(f"{robot.name}: {robot.problem}") for robot in reply.robots if robot.problem is not None]
    if not problems:
        return table
    return Group(table, Text("These can't be used:", style="bold"), *problems)


def robot_table(reply: RobotReply) -> RenderableType:
    """Make tables of one robot: joints, limits and their sources, groups, shapes, link pairs that aren't tested."""
    joints = _make_table("joint", "kind", "range", "velocity", "acceleration")
    for joint in reply.joints:
        joints.add_row(
            joint.name,
            joint.kind if joint.mimics is None else _describe_mimic(joint),
            _format_range(joint),
            f"{_format_numbers(joint.velocity)} ({joint.velocity_source})",
            f"{_format_numbers(joint.acceleration)} ({joint.acceleration_source})",
        )
    pairs = _make_table("links not tested against each other", "reason")
    for pair in reply.pairs_left_out:
        pairs.add_row(" and ".join(pair.links), pair.reason)
    judged = Counter(shape.judged_as for shape in reply.geometry)
    return Group(
        Text(reply.name, style="bold"),
        Text(f"tip {reply.tip}; {len(reply.links)} links, {len(reply.frames)} frames"),
        *([] if reply.rest_state is None else [Text(f"rest: the SRDF's state {reply.rest_state}")]),
        Text(f"collision shapes: {', '.join(f'{count} {kind}' for kind, count in judged.items()) or 'none'}"),
        *(Text(line) for line in _describe_covers(reply.geometry)),
        *(Text(f"group {name}: {', '.join(members)}") for name, members in reply.groups.items()),
        joints,
        Text(f"{len(reply.collision_pairs)} pairs of links are tested against each other"),
        *([pairs] if reply.pairs_left_out else []),
        *(Text(warning, style="yellow") for warning in reply.warnings),
    )


def _describe_covers(geometry: list[GeometryInfo]) -> list[str]:
    """Describe the bounding spheres and convex parts of shapes, as far as they are known."""
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


def _make_table(*headings: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD)
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
