"""Find the runs, streams and files that a command line names; check, fetch or replay them; their common options.

All commands that name a run do it so: an id, ``user:id``, or a file by its suffix.
"""

from __future__ import annotations

import contextlib
import math
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import msgspec
import typer

from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages.identities import PLAIN, check_user
from guidefield.messages.replies import CertifyReply, MotionReply, PlanReply
from guidefield.messages.requests import MotionRequest
from guidefield.messages.streams import Piece, StreamState
from guidefield.stores.files import default_data_folder
from guidefield.stores.recordings import LOG
from guidefield.stores.run_file import FILE
from guidefield.stores.runs import RunDatabase, UserRuns
from guidefield.versions import parse_versions

if TYPE_CHECKING:
    from guidefield.client import Client
    from guidefield.engine import Engine

_R = TypeVar("_R", bound=PlanReply | CertifyReply)


def fetch_files(client: Client, reply: _R, recording: Path | None, proof: Path | None = None) -> _R:
    """Write the recording and proof of a reply to files, if it has them, and return the reply with their paths.

    Without a proof an earlier one in its file is removed.
    """
    from guidefield.run import remove_earlier_proof

    if recording is not None and reply.recording is not None:
        recording.write_bytes(client.recording(reply.run_id))
        reply = msgspec.structs.replace(reply, recording=str(recording))
    if proof is not None and reply.proof is not None:
        proof.write_bytes(client.proof(reply.run_id))
        reply = msgspec.structs.replace(reply, proof=str(proof))
    elif proof is not None:
        reply = msgspec.structs.replace(reply, warnings=[*reply.warnings, *remove_earlier_proof(proof)])
    return reply


def require_writable(file: Path | None) -> Path | None:
    """Callback of an option or argument that names an output file: return the file if it can be written."""
    if file is None:
        return None
    if file.is_dir():
        raise typer.BadParameter(f"{str(file)!r} is a folder")
    if not file.parent.is_dir():
        raise typer.BadParameter(f"there is no folder {str(file.parent)!r}")
    if not os.access(file if file.exists() else file.parent, os.W_OK):
        raise typer.BadParameter(f"{str(file)!r} can't be written")
    return file


def require_recording_file(file: Path | None) -> Path | None:
    """Callback of an option that names a recording to write: as `require_writable`; `show` knows it by its suffix."""
    return _require_suffix(require_writable(file), ".rrd", "a recording")


def require_proof_file(file: Path | None) -> Path | None:
    """Callback of an option that names a proof to write: as `require_writable`; the referee knows it by its suffix."""
    return _require_suffix(require_writable(file), ".npz", "a proof")


def _require_suffix(file: Path | None, suffix: str, content: str) -> Path | None:
    if file is not None and file.suffix != suffix:
        raise typer.BadParameter(f"{content}'s file ends with {suffix}, got {str(file)!r}")
    return file


ENDING = ".stream"  # suffix of the files of a stream's journal: `ENDING` of `stream/journal.py`, which loads a planner


def stream_files(name: str, folder: Path) -> list[Path]:
    """List the files of a stream's journal, the oldest first; none if the argument names something else."""
    if name.endswith(ENDING):
        if not Path(name).is_file():
            raise UnknownObject(f"there is no file {name!r}", path=name)
        return [Path(name)]
    if Path(name).is_dir():
        return sorted(Path(name).glob(f"*{ENDING}"))
    user, colon, own = name.partition(":")
    if not colon:
        user, own = PLAIN, name
    if "/" in own or own in ("", ".", ".."):
        return []
    streams = folder if user == PLAIN else folder / "users" / check_user(user)
    return sorted((streams / "streams" / own).glob(f"*{ENDING}"))


def replay_stream(
    files: Sequence[Path],
    folder: Path,
    packages: Sequence[Path],
    say: Callable[[str], None],
    made_by: Callable[[dict[str, str]], str],
) -> int:
    """Replay the files of a journal, and say the outcome of each; return 0 if all is the same to the last bit, else 1.

    `made_by` describes the versions of a file with another outcome, as the begin of a sentence.

    Raises:
        MalformedRequest: if a file isn't one of a stream.
        GuidefieldError: if the request that opened it is refused now.
    """
    from guidefield.first_start import compile_kernels
    from guidefield.stream.journal import read, replay

    compile_kernels(say)
    code = 0
    for file in files:
        begun, _ = read(file)
        if file is files[0] and begun.index > 1:
            now = begun.snapshot.state.now
            since = f"{now} s of its client's clock" if math.isfinite(now) else "its first update"
            say(f"{file.parent.name} is kept from {since} on: {begun.index - 1} files before made room")
        done = replay(file, replaying_engine(begun.user, folder, packages).stream)
        name = f"{file.parent.name}/{file.name}"
        if done.same:
            say(f"{name}: bit-identical: {done.updates} updates, {done.pieces} pieces")
            continue
        code = 1
        say(f"{name}: {made_by(begun.versions)}the answer to the update at {done.first} s differs")
        say(f"then: {_summarize(done.was)}\nnow:  {_summarize(done.now)}")
    return code


def record_stream(files: Sequence[Path], folder: Path, packages: Sequence[Path], recording: Path) -> None:
    """Write the recording of a journal's files; MalformedRequest if one isn't a journal's, or none has an update."""
    from guidefield.stream.journal import read
    from guidefield.stream.shown import record

    begun, _ = read(files[-1])
    record(files, replaying_engine(begun.user, folder, packages).stream, recording)


def replaying_engine(user: str, folder: Path, packages: Sequence[Path]) -> Engine:
    """Make an engine that answers a user's requests again, with what is stored in a data folder; it writes nothing."""
    from guidefield.engines import Engines
    from guidefield.stores.by_user import StoresByUser

    return Engines("local", StoresByUser(folder, reading=True), [one.resolve() for one in packages]).of(user)


def _summarize(answer: Piece | StreamState | str | None) -> str:
    if isinstance(answer, Piece):
        return f"piece {answer.number}, {answer.leads_to}, stops at {answer.stops} s"
    if isinstance(answer, StreamState):
        return f"no piece: {answer.reason}"
    return "nothing" if answer is None else f"refused: {answer}"


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
    """A run that has ended."""

    request: MotionRequest
    reply: MotionReply
    versions: dict[str, str]  # of packages that made it; empty if they weren't recorded


def data_folder(data: Path | None, name: str) -> Path:
    """Return the data folder of the options."""
    return default_data_folder(name) if data is None else data


def open_runs(data: Path | None, name: str, owner: str = PLAIN) -> UserRuns:
    """Open a user's runs in a data folder for reading; raises UnknownObject, and makes no file, without any."""
    folder = data_folder(data, name)
    if (folder / FILE).is_file():
        return RunDatabase(folder).of(owner)
    if (folder / "runs").is_dir():
        reason = f"the runs in {folder} were kept by guidefield 0.1; `guidefield serve --data {folder}` takes them over"
        raise UnknownObject(reason, path=str(folder))
    raise UnknownObject(
        f"no service has kept runs in {folder}; --data names another folder, and a recording's file ends with .rrd",
        path=str(folder),
    )


def owner_of(run: str) -> str:
    """Return the user of a named run: of ``user:id`` that user, of a plain id or a recording's file `PLAIN`."""
    owner, colon, _ = run.partition(":")
    return check_user(owner) if colon and owner != PLAIN and not run.endswith(".rrd") else PLAIN


def split_run_name(run: str, data: Path | None, name: str) -> tuple[UserRuns, str]:
    """Return the store and the id of a named run."""
    return open_runs(data, name, owner_of(run)), run.partition(":")[2] or run


def find_run(run: str, data: Path | None, name: str) -> FoundRun:
    """Find the run of an argument.

    Raises:
        UnknownObject: if there is no such run or file, or it has no reply.
        MalformedRequest: if the file is no whole recording of guidefield.
    """
    from guidefield.recorder.stored import read_recording
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
    """Find the plan of an argument, as `find_run`; raises MalformedRequest, too, if it is of a certify request."""
    reply = find_run(run, data, name).reply
    if not isinstance(reply, PlanReply):
        raise MalformedRequest(f"run {run!r} is no plan: it judged a motion that was given", run_id=run)
    return reply


@contextlib.contextmanager
def recording_file(run: str, data: Path | None, name: str) -> Iterator[Path]:
    """Yield the file of a run's or stream's self-contained recording, a temporary one unless the argument is a file."""
    if run.endswith(".rrd"):
        file = Path(run)
        if not file.is_file():
            raise UnknownObject(f"there is no recording {run!r}", path=run)
        yield file
        return
    from guidefield.rendering import render_recording

    with tempfile.TemporaryDirectory(prefix="guidefield-") as folder:
        if files := stream_files(run, data_folder(data, name)):
            file = Path(folder) / f"{files[-1].stem}.rrd"
            record_stream(files, data_folder(data, name), (), file)
        else:
            runs, run_id = split_run_name(run, data, name)
            file = Path(folder) / f"{run_id}.rrd"
            runs.require(run_id)
            file.write_bytes(render_recording(runs.recordings, run_id))
        yield file
