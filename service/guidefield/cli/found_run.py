"""Find the run that a command line names: an id in a service's data folder, or a recording."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from guidefield.cli.stream_replaying import record_stream, stream_files
from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages.identities import PLAIN, check_user
from guidefield.messages.replies import MotionReply, PlanReply
from guidefield.messages.requests import MotionRequest
from guidefield.stores.files import default_data_folder
from guidefield.stores.recordings import LOG
from guidefield.stores.run_file import FILE
from guidefield.stores.runs import RunDatabase, UserRuns
from guidefield.versions import parse_versions

Data = Annotated[Path | None, typer.Option(help="The service's data folder; else ~/.local/share/guidefield/NAME.")]
Service = Annotated[str, typer.Option("--name", help="Name of the service whose data folder it is.")]
StreamName = Annotated[
    str,
    typer.Argument(
        help="Id of a kept run or stream, a recording's file, which ends with .rrd, or a stream's, with .stream."
    ),
]
RunName = Annotated[str, typer.Argument(help="Id of a kept run, or a recording's file, which ends with .rrd.")]


@dataclass(frozen=True)
class FoundRun:
    """A run that has ended; `versions` are those of the packages that made it, empty if they weren't recorded."""

    request: MotionRequest
    reply: MotionReply
    versions: dict[str, str]


def data_folder(data: Path | None, name: str) -> Path:
    """Return the data folder of the options."""
    return default_data_folder(name) if data is None else data


def open_runs(data: Path | None, name: str, owner: str = PLAIN) -> UserRuns:
    """Open the runs of a user in a data folder for reading.

    Raises:
        UnknownObject: if there are none; no file is created.
    """
    folder = data_folder(data, name)
    if (folder / FILE).is_file():
        return RunDatabase(folder).of(owner)
    if (folder / "runs").is_dir():
        told = f"the runs in {folder} were kept by guidefield 0.1; `guidefield serve --data {folder}` takes them over"
        raise UnknownObject(told, path=str(folder))
    raise UnknownObject(
        f"no service has kept runs in {folder}; --data names another folder, and a recording's file ends with .rrd",
        path=str(folder),
    )


def split_run_name(run: str, data: Path | None, name: str) -> tuple[UserRuns, str]:
    """Return the store and the id of a named run; another user's is ``user:id``.

    Raises:
        UnknownObject: if no runs are kept there.
        MalformedRequest: if nobody can be a user of that name.
    """
    owner, colon, own = run.partition(":")
    if not colon:
        return open_runs(data, name), run
    return open_runs(data, name, owner if owner == PLAIN else check_user(owner)), own


def find_run(run: str, data: Path | None, name: str) -> FoundRun:
    """Find the run of an argument.

    Raises:
        UnknownObject: if there is no such run or file, or it has no reply.
        MalformedRequest: if the file is no whole recording of guidefield.
    """
    from guidefield.recorder.reading import read_recording
    from guidefield.run_log import made_with_of

    if run.endswith(".rrd"):
        recorded = read_recording(Path(run))
        return FoundRun(recorded.request, recorded.reply, recorded.versions)
    runs, run_id = split_run_name(run, data, name)
    kept = runs.read(run_id)
    if kept.reply is None:
        why = "is still under way" if kept.error is None else f"ended with an error: {kept.error.message}"
        raise UnknownObject(f"run {run!r} has no reply: it {why}", run_id=run)
    path, log = runs.recordings.path(run_id), runs.recordings.file(run_id, LOG)
    versions = read_recording(path).versions if path.is_file() else parse_versions(made_with_of(log))
    return FoundRun(kept.request, kept.reply, versions)


def find_plan(run: str, data: Path | None, name: str) -> PlanReply:
    """Find the plan of the run of an argument.

    Raises:
        UnknownObject: as `find_run`.
        MalformedRequest: as `find_run`, and if the run judged a motion instead of planning one.
    """
    reply = find_run(run, data, name).reply
    if not isinstance(reply, PlanReply):
        raise MalformedRequest(f"run {run!r} is no plan: it judged a motion that was given", run_id=run)
    return reply


@contextlib.contextmanager
def recording_file(run: str, data: Path | None, name: str) -> Iterator[Path]:
    """Yield the self-contained recording of a run or stream; that of a stored one exists while the block runs.

    Raises:
        UnknownObject: if there is no such run, stream or file.
        MalformedRequest: if nothing can be shown of the stream.
    """
    if run.endswith(".rrd"):
        file = Path(run)
        if not file.is_file():
            raise UnknownObject(f"there is no recording {run!r}", path=run)
        yield file
        return
    from guidefield.rendering import rendered

    with tempfile.TemporaryDirectory(prefix="guidefield-") as folder:
        if files := stream_files(run, data_folder(data, name)):
            file = Path(folder) / f"{files[-1].stem}.rrd"
            record_stream(files, data_folder(data, name), (), file)
        else:
            runs, run_id = split_run_name(run, data, name)
            file = Path(folder) / f"{run_id}.rrd"
            runs.require(run_id)
            file.write_bytes(rendered(runs.recordings, run_id))
        yield file
