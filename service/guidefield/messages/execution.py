"""The curve that a controller draws of a motion, the rows that it is sent, and the files by which it takes these.

Each file names the interpolation that it is certified for; `KINDS` names them by their endings. Names and meanings of
fields are the wire. Docstrings of messages are in docs/wire.schema.json: after a change, `tools/wire_page`.
"""

from __future__ import annotations

import csv
import io
import json
import struct
import sys
import zipfile
from array import array
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Annotated, Any, Literal

import msgspec

from guidefield.errors import MalformedRequest
from guidefield.messages.values import Message, NonNegative, Reply, require_finite_number

Interpolation = Literal["linear", "cubic", "quintic", "first_order_hold", "zero_order_hold"]
MOST_SENT_ROWS = 100_000
"""The largest number of rows, or of commands, that a controller is sent (docs/execution.md)."""

HOLDS = ("first_order_hold", "zero_order_hold")
"""Interpolations of commands at the ticks of a clock; the others draw between rows, as a ROS trajectory is read."""


class ExecutionOptions(Message):
    """The curve that a controller draws, and how well the robot follows it.

    Attributes:
        interpolation: Between rows: "linear" in the joints, "cubic" by positions and velocities, "quintic" by
            accelerations too, as ros2_control's JointTrajectoryController draws them; between commands at ticks:
            "first_order_hold", straight from one to the next, "zero_order_hold", steps.
        rate: Of the ticks [1/s]; of rows the least, more are sent where the curve would leave the plan too far; null:
            the knots of the plan are sent.
        tolerance: How far each joint may be from that curve at each time, for all joints or by name [rad or m].
    """

    interpolation: Interpolation
    rate: Annotated[float, msgspec.Meta(ge=0.1, le=10_000.0)] | None = None
    tolerance: NonNegative | dict[str, NonNegative] = 0.0

    def __post_init__(self) -> None:
        if self.interpolation in HOLDS and self.rate is None:
            raise ValueError(f"`interpolation` {self.interpolation!r} needs the `rate` of its ticks")
        each = self.tolerance if isinstance(self.tolerance, dict) else {"": self.tolerance}
        for joint, value in each.items():
            require_finite_number(f"tolerance.{joint}" if joint else "tolerance", value)


class MotionDeviation(Reply):
    """How far a motion leaves the planned one, at the same times, between rows too.

    Attributes:
        largest: Of any joint [rad or m].
        joint: The joint.
        time: When [s].
        joints: The largest of each, by the names of `position_names`.
    """

    largest: float
    joint: str
    time: float
    joints: dict[str, float]


class ExecutionFigures(Reply):
    """A motion as a controller executes it: the rows to send, in columns as the reply's, and what is certified of it.

    Attributes:
        interpolation: The request's.
        rate: The request's [1/s].
        tolerance: Of each column of `position_names` [rad or m].
        deviation: Of the drawn curve from the planned one, without the tolerance.
        times: Of the rows, strictly increasing [s].
        positions: The rows [rad or m].
        velocities: The same [rad/s or m/s]; null where the interpolation reads none.
        accelerations: The same [rad/s^2 or m/s^2].
        end: When the motion has ended: one tick after the last row of a zero-order hold [s].
    """

    interpolation: str
    rate: float | None
    tolerance: list[float]
    deviation: MotionDeviation
    times: list[float]
    positions: list[list[float]]
    velocities: list[list[float]] | None
    accelerations: list[list[float]] | None
    end: float


def describe_deviation(found: MotionDeviation) -> str:
    """Say in words how far a motion leaves the planned one."""
    return f"{found.largest:.3g} rad or m at most, {found.joint} at {found.time:.3f} s"


def describe_execution(figures: ExecutionFigures) -> str:
    """Say in words what a motion is certified for: interpolation, rate, and the largest tolerance."""
    rate = "" if figures.rate is None else f" at {figures.rate:g} Hz"
    widest = max(figures.tolerance, default=0.0)
    return f"{figures.interpolation}{rate}, within {widest:g} rad or m of it"


NANOSECONDS = 1_000_000_000
SHORTEST_SERVO_STEP = 0.002  # of UR's e-series [s]; docs/execution.md and the refusal below say 500 Hz
UR_JOINTS = 6
SERVO_LOOKAHEAD = 0.03  # of URScript's `servoj`: the shortest that it takes [s]
SERVO_GAIN = 300  # of `servoj`: its default
FAR_FROM_START = 0.01  # a robot that is farther from the first command in a joint isn't moved [rad]


class SentMotion(msgspec.Struct, frozen=True):
    """The rows of a motion that is certified as a controller executes it."""

    run_id: str
    joints: Sequence[str]
    rows: ExecutionFigures


def export_reply(reply: Any, kind: str) -> bytes:
    """Write the rows that a `PlanReply` or `CertifyReply` certifies for a controller: see `export`.

    Raises MalformedRequest if the motion isn't certified at all, too.
    """
    if reply.status.name != "SUCCESS":
        raise MalformedRequest(f"run {reply.run_id!r} is not certified: {reply.status.message}", run_id=reply.run_id)
    return export(reply.run_id, reply.position_names, reply.execution, kind)


def export(run_id: str, joints: Sequence[str], rows: ExecutionFigures | None, kind: str) -> bytes:
    """Write the rows of an execution as a file of a kind, one of `KINDS`.

    Raises:
        MalformedRequest: if there is no such kind, the motion isn't certified for an execution, or its interpolation
            isn't the one that readers of the kind draw.
    """
    if kind not in KINDS:
        raise MalformedRequest(f"a motion is exported as one of {', '.join(KINDS)}, not as {kind!r}", kind=kind)
    if rows is None:
        raise MalformedRequest(
            f"run {run_id!r} is not certified for a controller, and {kind!r} is for one: give the request an"
            " `execution`, or judge the motion with `guidefield certify --execution`",
            run_id=run_id,
            kind=kind,
        )
    return KINDS[kind](SentMotion(run_id, joints, rows))


def describe_certified(motion: SentMotion) -> str:
    """Say in a line what a motion was certified for."""
    return f"certified for: {describe_execution(motion.rows)}; guidefield run {motion.run_id}"


def stamps(times: Sequence[float]) -> list[int]:
    """Return times since the first [ns]; raises MalformedRequest if two are the same."""
    found = [round((time - times[0]) * NANOSECONDS) for time in times]
    for row, (first, second) in enumerate(pairwise(found), 1):
        if second <= first:
            raise MalformedRequest(
                f"row {row} is less than a nanosecond after the one before, so that both have one stamp"
            )
    return found


def trajectory_message(motion: SentMotion) -> dict[str, Any]:
    """Return trajectory_msgs/JointTrajectory as plain data.

    Raises:
        MalformedRequest: if commands are held, which no such message says.
    """
    rows = motion.rows
    if rows.interpolation in HOLDS:
        raise MalformedRequest(
            f"run {motion.run_id!r} is certified for {rows.interpolation!r}, and who reads a ROS trajectory draws it as"
            " 'linear', 'cubic' or 'quintic'",
            interpolation=rows.interpolation,
        )
    points = []
    for row, stamp in enumerate(stamps(rows.times)):
        point: dict[str, Any] = {"positions": rows.positions[row]}
        if rows.velocities is not None:
            point["velocities"] = rows.velocities[row]
        if rows.accelerations is not None:
            point["accelerations"] = rows.accelerations[row]
        point["time_from_start"] = {"sec": stamp // NANOSECONDS, "nanosec": stamp % NANOSECONDS}
        points.append(point)
    return {"joint_names": [*motion.joints], "points": points}


def _ros_json(motion: SentMotion) -> bytes:
    goal = {"certified_for": describe_certified(motion), "trajectory": trajectory_message(motion)}
    return json.dumps(goal, allow_nan=False).encode()


def _ros_yaml(motion: SentMotion) -> bytes:
    """The goal of a FollowJointTrajectory action, in YAML 1.1: there a number with an exponent has a point."""
    message, lines = trajectory_message(motion), [f"# {describe_certified(motion)}", "trajectory:"]
    lines.append(f"  joint_names: [{', '.join(map(_quoted, message['joint_names']))}]")
    lines.append("  points:")
    for point in message["points"]:
        fields = [f"{name}: {_yaml_row(point[name])}" for name in point if name != "time_from_start"]
        stamp = point["time_from_start"]
        fields.append(f"time_from_start: {{sec: {stamp['sec']}, nanosec: {stamp['nanosec']}}}")
        lines += [f"  - {fields[0]}", *(f"    {field}" for field in fields[1:])]
    return ("\n".join(lines) + "\n").encode()


def _quoted(name: str) -> str:
    """A name in double quotes and ASCII, on one line: in YAML an escape is of a character, not of half of one."""
    return "".join(c if " " <= c <= "~" else f"\\U{ord(c):08x}" for c in json.dumps(name, ensure_ascii=False))


def _yaml_row(values: Sequence[float]) -> str:
    return f"[{', '.join(map(_yaml_number, values))}]"


def _yaml_number(value: float) -> str:
    mantissa, e, exponent = repr(float(value)).partition("e")
    return f"{mantissa if '.' in mantissa or not e else mantissa + '.0'}{e}{exponent}"


def _urscript(motion: SentMotion) -> bytes:
    """A program of `servoj`, which takes one command each step; it stops where the robot isn't at its start."""
    rows = motion.rows
    if rows.interpolation not in HOLDS or rows.rate is None:
        raise MalformedRequest(
            f"run {motion.run_id!r} is certified for {rows.interpolation!r}: URScript's `servoj` takes commands at"
            " ticks, 'zero_order_hold' or 'first_order_hold', and what `movej` draws with its blends isn't known",
            interpolation=rows.interpolation,
        )
    if len(motion.joints) != UR_JOINTS:
        raise MalformedRequest(f"URScript moves {UR_JOINTS} joints, and run {motion.run_id!r} has {len(motion.joints)}")
    step = 1.0 / rows.rate
    if step < SHORTEST_SERVO_STEP * (1.0 - 1e-9):
        raise MalformedRequest(
            f"`servoj` takes a command each {SHORTEST_SERVO_STEP:g} s at most, 500 Hz: this is for {rows.rate:g} Hz",
            rate=rows.rate,
        )
    first, *others = rows.positions
    given = f"0, 0, {step!r}, {SERVO_LOOKAHEAD}, {SERVO_GAIN}"
    lines = [
        f"# {describe_certified(motion)}",
        f"# joints: {', '.join(map(_quoted, motion.joints))}",
        "def guidefield_motion():",
        f"  start = {first}",
        "  now = get_actual_joint_positions()",
        "  joint = 0",
        f"  while joint < {UR_JOINTS}:",
        f"    if norm(now[joint] - start[joint]) > {FAR_FROM_START}:",
        '      popup("the robot is not at the start of the motion", "guidefield", error=True)',
        "      halt",
        "    end",
        "    joint = joint + 1",
        "  end",
        *(f"  servoj({row}, {given})" for row in (first, *others)),
        "  stopj(2.0)",
        "end",
        "guidefield_motion()",
    ]
    return ("\n".join(lines) + "\n").encode()


def _columns(motion: SentMotion) -> list[tuple[str, Sequence[Sequence[float]]]]:
    rows = motion.rows
    kinds = (("position", rows.positions), ("velocity", rows.velocities), ("acceleration", rows.accelerations))
    return [(kind, table) for kind, table in kinds if table is not None]


def _csv(motion: SentMotion) -> bytes:
    columns = _columns(motion)
    head = ["time", *(f"{kind}:{joint}" for kind, _ in columns for joint in motion.joints)]
    rows = (
        [time, *(value for _, values in columns for value in values[row])] for row, time in enumerate(motion.rows.times)
    )
    return f"# {describe_certified(motion)}\n{write_table(head, rows)}".encode()


def write_table(head: Sequence[str], rows: Iterable[Sequence[float]]) -> str:
    """Return a table as CSV; names with a carriage return are quoted, which Python before 3.13 leaves out."""
    text = io.StringIO(newline="")
    plain = csv.writer(text, lineterminator="\n")
    quoted = csv.writer(text, lineterminator="\n", quoting=csv.QUOTE_ALL)
    (quoted if any("\r" in name for name in head) else plain).writerow(head)
    plain.writerows(rows)
    return text.getvalue()


def _fields(motion: SentMotion) -> dict[str, Any]:
    rows = motion.rows
    names = {"position_names": [*motion.joints], "velocity_names": [*motion.joints]}
    values = {name: getattr(rows, name) for name in ("times", "positions", "velocities", "accelerations")}
    head = {
        "run_id": motion.run_id,
        "interpolation": rows.interpolation,
        "rate": rows.rate,
        "tolerance": rows.tolerance,
    }
    return {**head, **names, **{name: value for name, value in values.items() if value is not None}}


def _json(motion: SentMotion) -> bytes:
    return json.dumps(_fields(motion), allow_nan=False).encode()


def _npz(motion: SentMotion) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as members:
        for name, value in _fields(motion).items():
            if value is not None:
                members.writestr(f"{name}.npy", _npy(value))
    return file.getvalue()


def _npy(value: Any) -> bytes:
    """An array of numbers or of texts in NumPy's format 1.0: a header padded to 64 bytes, and the values."""
    shape, flat = list[int](), [value]
    while isinstance(flat[0], list):
        shape.append(len(flat[0]))
        flat = [each for part in flat for each in part]
    if isinstance(flat[0], str):
        width = max(map(len, flat))
        kind, data = f"<U{width}", b"".join(text.encode("utf-32-le").ljust(4 * width, b"\0") for text in flat)
    else:
        numbers = array("d", flat)
        if sys.byteorder == "big":
            numbers.byteswap()
        kind, data = "<f8", numbers.tobytes()
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {tuple(shape)!r}, }}".encode()
    header += b" " * (-(10 + len(header) + 1) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


KINDS: dict[str, Callable[[SentMotion], bytes]] = {
    "ros.json": _ros_json,
    "yaml": _ros_yaml,
    "script": _urscript,
    "csv": _csv,
    "json": _json,
    "npz": _npz,
}
"""Writers by kind: the first one counts with whose name a file ends, so that `ros.json` has to stand before `json`."""
CONTROLLER_KINDS = ("ros.json", "yaml", "script")
"""Those of controllers, which are exported of certified executions only; others need a writer in arrays.py, too."""
