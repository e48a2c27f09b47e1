"""`guidefield runs`: list, render, compare and export the stored runs of a service; a recording's file, too."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from guidefield.batch.results import RECORDINGS
from guidefield.cli.found_run import (
    Data,
    RunName,
    Service,
    StreamName,
    data_folder,
    find_plan,
    find_run,
    open_runs,
    recording_file,
    require_writable,
    split_run_name,
)
from guidefield.cli.replaying import comparison_table
from guidefield.messages.exports import CONTROLLER_KINDS, KINDS
from guidefield.messages.identities import PLAIN
from guidefield.messages.replies import RunsReply, RunSummary
from guidefield.messages.store_requests import LARGEST_PAGE, ReadRuns
from guidefield.stores.files import user_folder, users_in
from guidefield.stores.recordings import Recordings
from guidefield.stores.runs import UserRuns
from guidefield.whole_file import write_whole

out = Console()

runs_app = typer.Typer(help="List, compare and export the runs that a service has kept.", no_args_is_help=True)


@runs_app.command("list")
def list_runs(
    data: Data = None,
    name: Service = "local",
    status: Annotated[str | None, typer.Option(help="Only those that ended so, such as SUCCESS.")] = None,
    robot: Annotated[str | None, typer.Option(help="Only those of this robot.")] = None,
    since: Annotated[datetime | None, typer.Option(help="Only those that began at that time or later.")] = None,
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
    table.add_column("run", no_wrap=True, min_width=max((len(run.run_id) for run in runs), default=0))
    for column in ("status", "robot", "scene", "began", "recording"):
        table.add_column(column, overflow="fold")
    for run in runs:
        began = datetime.fromtimestamp(run.began).astimezone().isoformat(" ", "seconds")
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
    """Write the motion of a run to a file for other programs, its proof, or its or a stream's recording.

    Of a run with an `execution` it is the rows that a controller is to be sent.
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
