"""`guidefield runs` and `guidefield replay`: what a service has kept, read from its data folder."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich import box
from rich.console import Console
from rich.table import Table

from guidefield.cli.comparison import comparison_table, differing, largest_step
from guidefield.engine import Engine
from guidefield.errors import UnknownObject
from guidefield.messages.replies import PlanReply, RunsReply
from guidefield.messages.store_requests import ReadRuns
from guidefield.stores.files import default_data_folder
from guidefield.stores.robots import RobotStore
from guidefield.stores.runs import RunStore
from guidefield.stores.scenes import SceneStore

out = Console()

runs_app = typer.Typer(help="List, compare and export the runs that a service has kept.", no_args_is_help=True)

Data = Annotated[Path | None, typer.Option(help="The service's data folder; else that of the user.")]
Service = Annotated[str, typer.Option("--name", help="Name of the service whose data folder it is.")]
RunName = Annotated[str, typer.Argument(help="Id of a run.")]


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
    wanted = ReadRuns(status=status, robot=robot, since=None if since is None else since.timestamp())
    kept = _store(data, name).summaries()
    found = [run for run in kept if wanted.wants(run.status, run.robot, run.began)]
    if json:
        typer.echo(msgspec.json.encode(RunsReply(runs=found)).decode())
        return
    table = Table("run", "status", "robot", "scene", "began", box=box.SIMPLE_HEAD)
    for run in found:
        began = datetime.fromtimestamp(run.began).astimezone().isoformat(" ", "seconds")
        table.add_row(run.run_id, run.status, run.robot, run.scene, began)
    out.print(table)


@runs_app.command()
def compare(first: RunName, second: RunName, data: Data = None, name: Service = "local") -> None:
    """Show two runs beside each other: waypoints, clearance, times, and what of the plan differs."""
    store = _store(data, name)
    out.print(comparison_table(_reply(store, first), _reply(store, second)))


@runs_app.command()
def export(
    run: RunName,
    file: Annotated[Path, typer.Argument(help="Where to: .csv, .json or .npz.")],
    data: Data = None,
    name: Service = "local",
) -> None:
    """Write the motion of a run to a file for other programs."""
    from guidefield.stores.run_arrays import run_arrays, write_motion

    write_motion(run_arrays(_store(data, name).read(run)), file)


def replay(run: RunName, data: Data = None, name: Service = "local") -> None:
    """Plan the request of a kept run again; exit code 0 if the plan is the same to the last bit, else 1."""
    store = _store(data, name)
    before, asked, folder = _reply(store, run), store.read(run).request, _folder(data, name)
    engine = Engine(name, scenes=SceneStore(folder / "scenes"), robots=RobotStore(folder / "robots"))
    now = engine.answer(msgspec.structs.replace(asked, run_id=None, recording="off"))
    assert isinstance(now, PlanReply), "a plan was asked for"
    parts = differing(before, now)
    if not parts:
        out.print(f"{run}: bit-identical, {now.status.name}, {len(now.path)} waypoints", highlight=False)
        raise typer.Exit(0)
    step = largest_step(before, now)
    by = "" if step is None else f"; waypoints by at most {step:.3g}"
    out.print(f"{run}: not the same: {', '.join(parts)} differ{by}", highlight=False, soft_wrap=True)
    raise typer.Exit(1)


def _folder(data: Path | None, name: str) -> Path:
    return default_data_folder(name) if data is None else data


def _store(data: Path | None, name: str) -> RunStore:
    """The runs of a data folder; UnknownObject where there are none, so that looking leaves no folder behind."""
    folder = _folder(data, name) / "runs"
    if not folder.is_dir():
        raise UnknownObject(f"no service has kept runs in {folder}", path=str(folder))
    return RunStore(folder)


def _reply(store: RunStore, run_id: str) -> PlanReply:
    found = store.read(run_id)
    if found.reply is None:
        why = "is still under way" if found.error is None else f"ended with an error: {found.error.message}"
        raise UnknownObject(f"run {run_id!r} has no reply: it {why}", run_id=run_id)
    return found.reply
