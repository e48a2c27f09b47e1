"""`guidefield runs` and `guidefield replay`: list, render, compare, export stored runs; plan their requests again.

A change of `PLAN_FIELDS` makes hashes of plans that users noted incomparable.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich import box
from rich.console import Console, RenderableType
from rich.progress import track
from rich.table import Table

from guidefield.cli.found_run import (
    Data,
    RunName,
    Service,
    StreamName,
    data_folder,
    find_plan,
    find_run,
    open_runs,
    owner_of,
    record_stream,
    recording_file,
    replay_stream,
    replaying_engine,
    require_recording_file,
    require_writable,
    split_run_name,
    stream_files,
)
from guidefield.errors import GuidefieldError, MalformedRequest
from guidefield.messages.execution import CONTROLLER_KINDS, KINDS
from guidefield.messages.identities import PLAIN
from guidefield.messages.replies import CertifyReply, PlanReply, RunsReply, RunSummary, Timing
from guidefield.messages.requests import LARGEST_PAGE, ReadRuns
from guidefield.stores.files import user_folder, users_in
from guidefield.stores.recordings import Recordings
from guidefield.stores.runs import UserRuns
from guidefield.whole_file import write_whole

PLAN_FIELDS = ("status", "position_names", "velocity_names", "path", "trajectory", "guide_planes", "planner", "seed")
"""The fields of a reply that are the plan itself; the others are measured, prove it, or name the run."""


def motion_hash(reply: PlanReply) -> str:
    """Return the SHA-256 of the plan itself in hexadecimal: equal if and only if `list_differences` is empty."""
    return hashlib.sha256(b"\n".join(_encode_fields(reply).values())).hexdigest()


def list_differences(first: PlanReply, second: PlanReply) -> list[str]:
    """List the fields of the plan that differ in any bit, in the order of the reply."""
    one, other = _encode_fields(first), _encode_fields(second)
    return [name for name in PLAN_FIELDS if one[name] != other[name]]


def largest_deviation(first: PlanReply, second: PlanReply) -> float | None:
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
    step = largest_deviation(first, second)
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


WIDTH_OF_A_LINE = 130  # width of a terminal from which a listed run has one line, else two [characters]
SHOWN_DIGITS = 16  # number of digits of a hash that are shown
VERDICT_FIELDS = ("status", "curve", "certificate", "clearance", "self_clearance", "limits", "cartesian", "effort")
"""The fields of a certify reply that must be the same; `effort` are the joints' torques."""

out = Console()

Packages = Annotated[
    list[Path] | None, typer.Option(exists=True, file_okay=False, help="Folder of packages with the robot's meshes.")
]


def replay(
    run: StreamName,
    data: Data = None,
    name: Service = "local",
    packages: Packages = None,
    record: Annotated[
        Path | None,
        typer.Option(help="Write a recording of a stream to this .rrd.", callback=require_recording_file),
    ] = None,
) -> None:
    """Plan the request of a run again, or judge its motion; exit code 0 if that is the same to the last bit, else 1.

    If the answer differs, the output says whether the run was made on another kind of processor, and by which version
    of guidefield. Exit code 2 if there is no such run, or its request is refused now.

    Robots and scenes that a client stored are read from the data folder. A stream is replayed file by file, and its
    pieces are compared.
    """
    if files := stream_files(run, data_folder(data, name)):
        if record is not None:
            record_stream(files, data_folder(data, name), packages or (), record)
        raise typer.Exit(replay_stream(files, data_folder(data, name), packages or (), _say, _describe_maker))
    if record is not None:
        raise MalformedRequest(f"{run!r} is no stream, and has a recording already", run=run)
    before = find_run(run, data, name)
    engine = replaying_engine(owner_of(run), data_folder(data, name), packages or ())
    try:
        now = engine.answer(msgspec.structs.replace(before.request, run_id=None, recording="off", proof=False))
    except GuidefieldError:
        if by_another := describe_version(before.versions):
            _say(f"{run}: {by_another}its request is refused now")
        raise
    if isinstance(before.reply, CertifyReply) and isinstance(now, CertifyReply):
        raise typer.Exit(_compare_verdicts(run, before.reply, now, before.versions))
    assert isinstance(before.reply, PlanReply), "the request is a plan request"
    assert isinstance(now, PlanReply), "the request is a plan request"
    parts = list_differences(before.reply, now)
    if not parts:
        _say(f"{run}: bit-identical: {_summarize(now)}")
        raise typer.Exit(0)
    step = largest_deviation(before.reply, now)
    by = "" if step is None else f"; waypoints by at most {step:.3g}"
    verdict = describe_processor(before.versions) or "not the same: "
    _say(f"{run}: {verdict}{describe_version(before.versions)}the plan differs in {', '.join(parts)}{by}")
    _say(f"then: {_summarize(before.reply)}\nnow:  {_summarize(now)}\n{describe_versions(before.versions)}")
    raise typer.Exit(1)


def _compare_verdicts(run: str, before: CertifyReply, now: CertifyReply, versions: dict[str, str]) -> int:
    parts = [name for name in VERDICT_FIELDS if getattr(before, name) != getattr(now, name)]
    if not parts:
        _say(f"{run}: judged as before: {now.status.name}, {now.status.message}")
        return 0
    _say(f"{run}: {describe_processor(versions) or 'not judged as before: '}it differs in {', '.join(parts)}")
    _say(f"then: {before.status.name}, {before.status.message}\nnow:  {now.status.name}, {now.status.message}")
    return 1


def _describe_maker(before: dict[str, str]) -> str:
    return f"{describe_processor(before) or 'not the same: '}{describe_version(before)}"


def describe_processor(before: dict[str, str]) -> str:
    """Name the processor that made a run, if it is of another kind, which rounds differently; else return ""."""
    from guidefield.versions import PROCESSOR, versions

    then, now = before.get(PROCESSOR), versions()[PROCESSOR]
    if then in (None, now):
        return ""
    family, here = then.partition(" ")[0], now.partition(" ")[0]
    return f"made on {family}, this is {here}: " if family != here else f"made on another kind of {here}: "


def describe_version(before: dict[str, str]) -> str:
    """Name the version of guidefield that planned a run, if it is another one; else return ""."""
    from guidefield.versions import PACKAGE, versions

    then, now = before.get(PACKAGE), versions()[PACKAGE]
    return "" if then in (None, now) else f"planned by {PACKAGE} {then}, this is {now}: "


def describe_versions(before: dict[str, str]) -> str:
    """Say in a sentence which packages, except guidefield, had other versions when a run was made."""
    from guidefield.versions import PACKAGE, versions

    if not before:
        return "the versions that it was made with were not recorded"
    here = versions()
    others = [
        f"{name} {text} (here {here.get(name, 'none')})"
        for name, text in before.items()
        if name != PACKAGE and here.get(name) != text
    ]
    if others:
        return f"it was made with {', '.join(others)}"
    return f"{'otherwise ' if describe_version(before) else ''}it was made with the same versions as are here"


def _summarize(reply: PlanReply) -> str:
    return f"{reply.status.name}, {len(reply.path)} waypoints, sha256 {motion_hash(reply)[:SHOWN_DIGITS]}"


def _say(line: str) -> None:
    out.print(line, highlight=False, soft_wrap=True)


runs_app = typer.Typer(help="List, compare and export the runs that a service has kept.", no_args_is_help=True)


@runs_app.command("list")
def list_runs(
    data: Data = None,
    name: Service = "local",
    status: Annotated[str | None, typer.Option(help="Only those with this status, such as SUCCESS.")] = None,
    robot: Annotated[str | None, typer.Option(help="Only those of this robot.")] = None,
    since: Annotated[
        datetime | None,
        typer.Option(help="Only those that began at that time or later, such as 2026-01-31 or 2026-01-31T08:00."),
    ] = None,
    text: Annotated[str | None, typer.Option(help="Only those with this text in their status' sentence.")] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Largest number of runs; else all.")] = None,
    json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """List the runs that are kept, newest first; also while a service runs."""
    given = {"status": status, "robot": robot, "since": None if since is None else since.timestamp(), "text": text}
    try:
        wanted = msgspec.convert(given, ReadRuns)
    except msgspec.ValidationError as error:
        raise typer.BadParameter(
            str(error), param_hint="'--text'" if "$.text" in str(error) else "'--status'"
        ) from None
    pages = _read_pages(open_runs(data, name), wanted, limit)
    if json:
        first, *others = pages
        runs = [run for page in (first, *others) for run in page.runs]
        typer.echo(msgspec.json.encode(msgspec.structs.replace(first, runs=runs, next=None)).decode())
        return
    for number, page in enumerate(pages):
        out.print(_make_table(page.runs, headed=number == 0))


def _read_pages(runs: UserRuns, wanted: ReadRuns, limit: int | None) -> Iterator[RunsReply]:
    while True:
        most = LARGEST_PAGE if limit is None else min(limit, LARGEST_PAGE)
        page = runs.list(msgspec.structs.replace(wanted, limit=most))
        yield page
        limit = None if limit is None else limit - len(page.runs)
        if page.next is None or limit == 0:
            return
        wanted = msgspec.structs.replace(wanted, after=page.next)


def _make_table(runs: list[RunSummary], *, headed: bool) -> Table:
    table = Table(box=box.SIMPLE_HEAD if headed else box.SIMPLE, show_header=headed)
    narrow = out.width < WIDTH_OF_A_LINE
    table.add_column("run, and when it began" if narrow else "run", no_wrap=True)
    for column in ("status, robot and scene",) if narrow else ("status", "robot", "scene", "began", "recording"):
        table.add_column(column, overflow="fold")
    for run in runs:
        began = datetime.fromtimestamp(run.began).astimezone().isoformat(" ", "seconds")
        if narrow:
            outcome = f"{run.status}, recording {run.recording}\n{run.robot} in {run.scene}"
            table.add_row(f"{run.run_id}\n{began}", outcome)
        else:
            table.add_row(run.run_id, run.status, run.robot, run.scene, began, run.recording)
    return table


@runs_app.command()
def render(
    folder: Annotated[
        Path | None, typer.Argument(help="Folder of a batch's results; else the service's data folder.")
    ] = None,
    data: Data = None,
    name: Service = "local",
) -> None:
    """Render the recordings that have only a log, the newest first; also while a service runs.

    Exit code 0 if all are rendered, 1 if some are lost, 2 where the disk refuses.
    """
    from guidefield.batch import RECORDINGS
    from guidefield.rendering import Renderings

    if folder is not None:
        places = [Recordings(folder / RECORDINGS)]
    else:
        open_runs(data, name)
        base = data_folder(data, name)
        places = [Recordings(user_folder(base, user) / RECORDINGS) for user in (PLAIN, *users_in(base))]
    renderings, done, lost = Renderings(), 0, 0
    owed = [(recordings, run_id) for recordings in places for run_id in recordings.list_owed()]
    for recordings, run_id in track(owed, "rendered", console=Console(stderr=True)):
        renderings.render(recordings, run_id, whole=folder is not None)
        kind = recordings.describe(run_id).kind
        done, lost = done + (kind == "rendered"), lost + (kind == "lost")
    for recordings in places:
        recordings.sweep_shared(unused=0.0)
    out.print(f"{done} rendered" + (f", {lost} lost" if lost else ""), highlight=False)
    raise typer.Exit(1 if lost else 0)


@runs_app.command()
def compare(first: RunName, second: RunName, data: Data = None, name: Service = "local") -> None:
    """Show two runs beside each other: waypoints, clearance, times, and where the plans differ."""
    out.print(comparison_table(find_plan(first, data, name), find_plan(second, data, name)))


@runs_app.command()
def export(
    run: StreamName,
    file: Annotated[
        Path,
        typer.Argument(
            help="Where to: .csv, .json, .npz; .ros.json, .yaml (ROS), .script (UR), if the run is certified for a"
            " controller; .rrd for the recording, or a name ending with proof.npz for the proof.",
            callback=require_writable,
        ),
    ],
    data: Data = None,
    name: Service = "local",
) -> None:
    """Write the motion, proof or recording of a run, or the recording of a stream, to a file.

    The motion of a run with an `execution` is the rows to send to a controller.
    """
    from guidefield.arrays import run_arrays, write_motion

    if file.suffix == ".rrd":
        with recording_file(run, data, name) as recording:
            write_whole(file, recording.read_bytes())
        return
    if file.name.endswith("proof.npz"):
        runs, run_id = split_run_name(run, data, name)
        runs.require(run_id)
        write_whole(file, runs.recordings.read_proof(run_id))
        return
    found = find_run(run, data, name)
    kind = next((kind for kind in KINDS if file.name.endswith(f".{kind}")), None)
    if kind is not None and (found.request.execution is not None or kind in CONTROLLER_KINDS):
        write_whole(file, found.reply.export(kind))
        return
    write_motion(run_arrays(find_plan(run, data, name)), file)
