"""`guidefield certify`: make its request from a file or a kept run and from options; have the referee judge, too.

Motion files are those that `arrays.py` writes, recordings, certify requests in JSON, and tables of other programs:
suffixes, fields and names of columns must stay readable.
"""

from __future__ import annotations

import csv
import json
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import typer

from guidefield.cli.found_run import data_folder, find_run, owner_of, replaying_engine
from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages import codec, requests
from guidefield.messages.certify_reply import SHARED_FIELDS, JointStates, judgement_of
from guidefield.messages.identities import PLAIN
from guidefield.messages.replies import CertifyReply, PlanReply
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest
from guidefield.messages.scene import Scene

if TYPE_CHECKING:
    from guidefield.engine import Engine

MOTION_ENDINGS = (".csv", ".json", ".npz", ".rrd")  # each has a case in `read_fields`; all else is a run's id
TRAJECTORY_FIELDS = ("times", "positions", "velocities", "accelerations")  # fields of a motion in a file


def read_fields(file: Path) -> dict[str, Any]:
    """Read the fields of a certify request from a file that ends with one of `MOTION_ENDINGS`.

    Raises UnknownObject if there is no such file; MalformedRequest if it holds no motion.
    """
    if file.suffix not in MOTION_ENDINGS:
        raise MalformedRequest(f"{file.name!r} must end with one of {', '.join(MOTION_ENDINGS)}", path=str(file))
    if not file.is_file():
        raise UnknownObject(f"there is no file {str(file)!r}", path=str(file))
    if file.suffix == ".rrd":
        from guidefield.recorder.stored import read_recording

        recorded = read_recording(file)
        return make_recorded_fields(recorded.request, msgspec.to_builtins(recorded.reply), file.name)
    try:
        match file.suffix:
            case ".csv":
                return _select_motion(_read_csv(file), file.name)
            case ".npz":
                return _select_motion(_read_npz(file), file.name)
            case _:
                return _read_json(file)
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise MalformedRequest(f"{file.name!r} holds no motion: {error}", path=str(file)) from None


def make_recorded_fields(request: MotionRequest, reply: dict[str, Any], run: str) -> dict[str, Any]:
    """Make the fields of a certify request about the motion of a run; raises MalformedRequest if it made none."""
    plain: dict[str, Any] = msgspec.to_builtins(request)
    if isinstance(request, CertifyRequest):
        return {name: value for name, value in plain.items() if name not in ("run_id", "type")}
    assert isinstance(request, PlanRequest), "a run plans or judges"
    return {**{name: plain[name] for name in SHARED_FIELDS}, "tip": request.tip, **_select_motion(reply, run)}


def _select_motion(found: dict[str, Any], name: str) -> dict[str, Any]:
    motion = found.get("trajectory") or {key: found[key] for key in TRAJECTORY_FIELDS if found.get(key) is not None}
    if not isinstance(motion, dict):
        raise MalformedRequest(f"{name!r} holds no motion: `trajectory` is a {type(motion).__name__}", path=name)
    fields = {key: found[key] for key in ("position_names", "velocity_names") if found.get(key) is not None}
    if motion.get("positions"):
        timed = "times" in motion
        if not timed and "velocities" not in motion:
            return {"path": motion["positions"], **_drop_rates(fields)}
        if "velocities" not in motion:
            fields = _drop_rates(fields)
        return {"trajectory": motion, **fields}
    if found.get("path"):
        return {"path": found["path"], **_drop_rates(fields)}
    raise MalformedRequest(f"{name!r} holds no motion: neither `positions` nor a `path`", path=name)


def _drop_rates(fields: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in fields.items() if key != "velocity_names"}


def _read_json(file: Path) -> dict[str, Any]:
    found = json.loads(file.read_bytes())
    if not isinstance(found, dict):
        raise ValueError(f"it is a {type(found).__name__}, not an object")
    if found.get("type") == "certify":
        return {name: value for name, value in found.items() if name != "type"}
    return _select_motion(found, file.name)


def _read_npz(file: Path) -> dict[str, Any]:
    import numpy as np

    with np.load(file, allow_pickle=False) as arrays:
        return {name: arrays[name].tolist() for name in arrays.files}


def _read_csv(file: Path) -> dict[str, Any]:
    with file.open(newline="", encoding="utf-8-sig") as text:
        content = (line for line in text if not line.startswith("#"))
        lines = [line for line in csv.reader(content, skipinitialspace=True) if line]
    if len(lines) < 2:
        raise ValueError("a head with the names of its columns and a row at least are expected")
    head = [name.strip() for name in lines[0]]
    table = [_parse_row(line, head, number) for number, line in enumerate(lines[1:], 2)]
    kinds = [_parse_column(name) for name in head]
    found: dict[str, Any] = {}
    for name, kind in (("positions", "position"), ("velocities", "velocity"), ("accelerations", "acceleration")):
        columns = [k for k, (own, _) in enumerate(kinds) if own == kind and head[k] != "time"]
        if columns:
            found[name] = [[row[k] for k in columns] for row in table]
            found.setdefault(f"{kind}_names", [kinds[k][1] for k in columns])
    if "time" in head:
        found["times"] = [row[head.index("time")] for row in table]
    return found


def _parse_column(name: str) -> tuple[str, str]:
    kind, colon, column = (part.strip() for part in name.partition(":"))
    if colon and kind not in ("position", "velocity", "acceleration"):
        raise ValueError(
            f"column {name!r} is neither of `position:`, `velocity:`, `acceleration:` nor a name; a joint's name with a"
            f" colon needs its kind before it, such as `position:{name}`"
        )
    return (kind, column) if colon else ("position", name)


def _parse_row(line: list[str], head: list[str], number: int) -> list[float]:
    if len(line) != len(head):
        raise ValueError(f"line {number} has {len(line)} values, the head names {len(head)} columns")
    row = []
    for name, value in zip(head, line, strict=True):
        try:
            row.append(float(value))
        except ValueError:
            raise ValueError(
                f"line {number}: column {name!r} has {value!r}, which is no number; columns are separated by commas"
            ) from None
    return row


ROBOT_ENDINGS = (".urdf", ".xacro", ".xml")  # suffixes of robot files, in lower case


def make_robot_reference(
    robot: str, srdf: Path | None, package_dirs: Sequence[Path], xacro_args: Sequence[str]
) -> requests.RobotReference:
    """Make the reference of a robot: a name, or a file with its SRDF, package folders and xacro arguments."""
    if not robot.lower().endswith(ROBOT_ENDINGS):
        if xacro_args:
            raise MalformedRequest(f"--xacro-arg goes with a .xacro file, not with the robot {robot!r}")
        return robot
    folders = [str(folder) for folder in package_dirs]
    srdf_path = None if srdf is None else str(srdf)
    arguments = split_xacro_arguments(xacro_args)
    return requests.UrdfFile(robot, srdf_path=srdf_path, package_dirs=folders, xacro_args=arguments)


def split_xacro_arguments(xacro_args: Sequence[str]) -> dict[str, str | bool | int | float]:
    """Split arguments of xacro into names and values; raises MalformedRequest if one isn't ``name:=value``."""
    arguments: dict[str, str | bool | int | float] = {}
    for argument in xacro_args:
        name, separator, value = argument.partition(":=")
        if not (name and separator):
            raise MalformedRequest(f"--xacro-arg must be name:=value, got {argument!r}")
        arguments[name] = value
    return arguments


def read_scene_file(file: Path, **options: Any) -> Scene:
    """Read the scene of a file of any kind with the options of `Scene.read`, and print its warnings."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        scene = Scene.read(file, **options)
    for one in said:
        typer.echo(f"warning: {one.message}", err=True)
    return scene


def make_certify_request(
    motion: str, given: Mapping[str, Any], allowed_time: float, data: Path | None, name: str
) -> requests.CertifyRequest:
    """Make the request about a motion of a file or run; given fields replace its own, unless None.

    Raises:
        UnknownObject, MalformedRequest: if there is no such file or run, or it holds no motion; if no robot or scene is
            known.
    """
    if motion.endswith(MOTION_ENDINGS):
        fields = read_fields(Path(motion))
    else:
        found = find_run(motion, data, name)
        fields = make_recorded_fields(found.request, msgspec.to_builtins(found.reply), motion)
    fields |= {field: msgspec.to_builtins(value) for field, value in given.items() if value is not None}
    if given["time_step"] is not None and "path" in fields:
        fields["trajectory"] = {"positions": fields.pop("path")}
    for field in ("robot", "scene"):
        if field not in fields:
            raise MalformedRequest(f"{motion!r} says no {field}: give --{field}", field=field)
    request = codec.decode_request({"type": "certify", **fields, "allowed_time": allowed_time})
    assert isinstance(request, requests.CertifyRequest), "a certify request was made"
    return request


BAG_ENDINGS = (".bag", ".mcap", ".db3")  # suffixes of ROS bags; a folder is one, too


def make_executed_request(
    states: str, run: str, begin: float, topic: str, allowed_time: float, data: Path | None, name: str
) -> requests.CertifyRequest:
    """Make the request that judges the joint states of a file or bag against the plan of a run.

    `begin` is when the motion began, in seconds since the first state.

    Raises:
        UnknownObject, MalformedRequest: if there is no such file or run, or the states aren't of the plan's joints.
    """
    found = find_run(run, data, name)
    if not (isinstance(found.reply, PlanReply) and isinstance(found.request, PlanRequest)):
        raise MalformedRequest(f"run {run!r} is no plan: it judged a motion that was given", run_id=run)
    read = _read_states(Path(states), found.reply.position_names, topic)
    first = read.times[0] if len(read.times) else 0.0
    return judgement_of(found.request, found.reply, read, first + begin, allowed_time)


def _read_states(file: Path, joints: Sequence[str], topic: str) -> JointStates:
    if file.is_dir() or file.suffix in BAG_ENDINGS:
        try:
            from guidefield.endpoint.ros.robot_messages import read_bag
        except ImportError:
            raise MalformedRequest("bags are read by rosbags: pip install 'guidefield[ros]'") from None
        return read_bag(file, topic, joints)
    fields = read_fields(file)
    motion, names = fields.get("trajectory"), fields.get("position_names")
    if not isinstance(motion, dict) or names is None or motion.get("times") is None:
        raise MalformedRequest(
            f"{file.name!r} has no `time` or no names of joints: it isn't joint states", path=str(file)
        )
    try:
        return msgspec.convert((names, motion["times"], motion["positions"]), JointStates)
    except msgspec.ValidationError as error:
        raise MalformedRequest(f"{file.name!r} holds no joint states: {error}", path=str(file)) from None


def judging_engine(run: str, data: Path | None, name: str) -> Engine:
    """Make the engine that judges a motion of a run, or of a file; it knows the scenes and robots of the run's user."""
    owner = PLAIN if run.endswith(MOTION_ENDINGS) else owner_of(run)
    return replaying_engine(owner, data_folder(data, name), ())


def run_referee(
    engine: Engine, request: CertifyRequest, reply: CertifyReply, file: Path | None, *, with_verdict: bool
) -> bool:
    """Write the referee's file, if one is named; with a verdict, have it judge the motion. Return whether that is free.

    If the certificate is free and a verdict refuses the motion, one of them has a bug, and a line says so.
    """
    # Pinocchio and Coal are loaded only here
    from guidefield import case_file
    from guidefield.referee.case import Answer, lines
    from guidefield.referee.judge import judge
    from guidefield.referee.loading import case_of

    motions = engine.motions_of(request)
    if file is not None:
        case_file.write(file, *motions)
    if not with_verdict:
        return True
    verdicts = [judge(case_of(case), seconds=request.allowed_time) for case in case_file.make_cases(*motions)]
    for verdict in verdicts:
        typer.echo("\n".join(lines(verdict)))
    free = all(verdict.answer is Answer.FREE for verdict in verdicts)
    compatible = {Answer.FREE, Answer.UNDECIDED, Answer.NOT_JUDGED}
    if reply.status.name == "SUCCESS" and not all(verdict.answer in compatible for verdict in verdicts):
        typer.echo("the certificate and the referee contradict each other: please report it with `--case FILE`")
    return free


def replay_proofs(file: Path, seconds: float) -> bool:
    """Have the referee check a file of proofs, print its verdicts, and return whether all hold."""
    from guidefield.referee.case import Answer, lines
    from guidefield.referee.loading import UnusableFile
    from guidefield.referee.replay import replay_file

    try:
        verdicts = replay_file(file, seconds)
    except (UnusableFile, OSError) as error:
        raise MalformedRequest(str(error)) from None
    for verdict in verdicts:
        typer.echo("\n".join(lines(verdict, "slabs")))
    return all(verdict.answer is Answer.FREE for verdict in verdicts)
