"""`guidefield replay` of a stream: replay its journal file by file, and compare the pieces bit for bit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from guidefield.engine import Engine
from guidefield.engines import Engines
from guidefield.errors import UnknownObject
from guidefield.messages.identities import PLAIN, check_user
from guidefield.messages.streams import Piece, StreamState
from guidefield.stores.by_user import StoresByUser

ENDING = ".stream"


def stream_files(name: str, folder: Path) -> list[Path]:
    """List the files of a stream's journal, the oldest first; none if the argument names something else.

    Args:
        name: A file, a folder of such files, or a kept stream, another user's as `user:id`.
        folder: The service's data folder.

    Raises:
        UnknownObject: if it names a file that doesn't exist.
    """
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
    """Replay the files of a journal, and print the result of each.

    Args:
        files: The files.
        folder: The service's data folder, with its users' robots and scenes.
        packages: Folders of packages with robots' meshes.
        say: Prints a line.
        made_by: Names the processor and version that made a stream, given its versions.

    Returns:
        Exit code: 0 if everything is the same to the last bit, else 1.

    Raises:
        MalformedRequest: if a file isn't one of a stream.
        GuidefieldError: if the request that opened it is refused now.
    """
    from guidefield.first_start import compile_kernels
    from guidefield.stream.replay import read, replayed

    compile_kernels(say)
    code = 0
    for file in files:
        begun, _ = read(file)
        if file is files[0] and begun.index > 1:
            now = begun.snapshot.state.now
            since = f"{now} s of its client's clock" if math.isfinite(now) else "its first update"
            say(f"{file.parent.name} is kept from {since} on: {begun.index - 1} files before made room")
        done = replayed(file, _make_engine(begun.user, folder, packages).stream)
        name = f"{file.parent.name}/{file.name}"
        if done.same:
            say(f"{name}: bit-identical: {done.updates} updates, {done.pieces} pieces")
            continue
        code = 1
        say(f"{name}: {made_by(begun.versions)}the answer to the update at {done.first} s differs")
        say(f"then: {_summarize(done.was)}\nnow:  {_summarize(done.now)}")
    return code


def record_stream(files: Sequence[Path], folder: Path, packages: Sequence[Path], recording: Path) -> None:
    """Write the recording of a journal's files, for a viewer.

    Args:
        files: The files of one stream, the oldest first.
        folder: The service's data folder.
        packages: Folders of packages with robots' meshes.
        recording: The recording.

    Raises:
        MalformedRequest: if one isn't such a file, or none holds an update.
    """
    from guidefield.stream.replay import read
    from guidefield.stream.shown import record

    begun, _ = read(files[-1])
    record(files, _make_engine(begun.user, folder, packages).stream, recording)


def _make_engine(user: str, folder: Path, packages: Sequence[Path]) -> Engine:
    """Make the engine of a user with the stores of a data folder, which isn't created."""
    if not folder.is_dir():
        return Engine(packages=packages)
    return Engines("local", StoresByUser(folder), packages).of(user)


def _summarize(answer: Piece | StreamState | str | None) -> str:
    if isinstance(answer, Piece):
        return f"piece {answer.number}, {answer.leads_to}, stops at {answer.stops} s"
    if isinstance(answer, StreamState):
        return f"no piece: {answer.reason}"
    return "nothing" if answer is None else f"refused: {answer}"
