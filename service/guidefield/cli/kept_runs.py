"""`guidefield runs`: what a service has kept, read from its data folder; a single recording too."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich import box
from rich.console import Console
from rich.table import Table

from guidefield.cli.comparison import comparison_table
from guidefield.cli.files import writable
from guidefield.cli.found_run import Data, RunName, Service, StreamName, find_plan, recording_file, run_store
from guidefield.engine import Engine
from guidefield.messages.replies import RunsReply
from guidefield.messages.store_requests import ReadRuns
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
    json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """List the runs that are kept, newest first."""
    try:
        wanted = ReadRuns(status=status, robot=robot, since=None if since is None else since.timestamp())
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="'--status'") from None
    found = Engine(name, runs=run_store(data, name)).answer(wanted)
    assert isinstance(found, RunsReply), "runs were asked for"
    if json:
        typer.echo(msgspec.json.encode(found).decode())
        return
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("run", no_wrap=True, min_width=max((len(run.run_id) for run in found.runs), default=0))
    for column in ("status", "robot", "scene", "began"):
        table.add_column(column, overflow="fold")
    for run in found.runs:
        began = datetime.fromtimestamp(run.began).astimezone().isoformat(" ", "seconds")
        table.add_row(run.run_id, run.status, run.robot, run.scene, began)
    out.print(table)


@runs_app.command()
def compare(first: RunName, second: RunName, data: Data = None, name: Service = "local") -> None:
    """Show two runs beside each other: waypoints, clearance, times, and where the plans differ."""
    out.print(comparison_table(find_plan(first, data, name), find_plan(second, data, name)))


@runs_app.command()
def export(
    run: StreamName,
    file: Annotated[
        Path, typer.Argument(help="Where to: .csv, .json, .npz, or .rrd for the recording.", callback=writable)
    ],
    data: Data = None,
    name: Service = "local",
) -> None:
    """Write the motion of a run to a file for other programs, or a run's or stream's recording with all it needs."""
    from guidefield.arrays import run_arrays, write_motion

    if file.suffix == ".rrd":
        with recording_file(run, data, name) as recording:
            write_whole(file, recording.read_bytes())
        return
    write_motion(run_arrays(find_plan(run, data, name)), file)
