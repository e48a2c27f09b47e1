"""A stream's journal: all its queries and answers, in files that can each be replayed to the last bit; and the replay.

A file begins with what the stream was opened with and a snapshot that it goes on from, and has one entry after the
other: so the oldest files can be dropped. The stream's own thread hands entries over and waits for nothing; another
thread, which gives way to it, writes them. If that one can't keep up, or the disk refuses, the file ends, and the next
one begins when there is memory or disk again. Names and tags of fields are in the files.
"""

from __future__ import annotations

import logging
import queue
import shutil
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from guidefield.errors import GuidefieldError, MalformedRequest, UnknownObject
from guidefield.messages.replies import ErrorReply, make_error_reply
from guidefield.messages.streams import Piece, StreamGoal, StreamOpen, StreamState, StreamUpdate
from guidefield.stores.files import checked_name
from guidefield.stream.path_planner import AtRecordedTimes, TakeOver, lower_priority
from guidefield.stream.state import Snapshot, StreamWatcher, decode_part, encode_part
from guidefield.stream.stream import CertifiedStream, GoalSearch

ENDING = ".stream"  # of the files, of those on disk, too: with another one they aren't found; again in cli/found_run.py
FILE_BYTES = 8 << 20  # entries' size at which a file ends [bytes] (docs/stream.md); at twice it a path is planned anew
MOST_FILES = 16  # newest files kept of a stream (docs/stream.md); it and `MOST_KEPT` divide a user's quota
MOST_WAITING = 2_000  # entries that may wait to be written; with more the file ends. 0 would be no bound
RETRY_AFTER = 10.0  # time from a refusal of the disk to the begin of another file [s]
LONGEST_ENTRY = 1 << 30  # a length beyond this means that the file is damaged [bytes]
_LENGTH = struct.Struct("<I")

_log = logging.getLogger(__name__)


class Begun(msgspec.Struct, frozen=True, tag="begun"):
    """The first entry of a file."""

    request: StreamOpen
    user: str
    index: int
    wall: float  # when it began [s since 1970]
    versions: dict[str, str]
    snapshot: Snapshot


class Updated(msgspec.Struct, frozen=True, tag="updated"):
    """An update, and its outcome."""

    update: StreamUpdate
    noted: bool  # whether it was taken without an answer, because a newer one was there
    took: bool  # whether a planned path was taken over by it
    wall: float  # its arrival, since the file's beginning [s]
    seconds: float  # time of work on it [s]
    piece: Piece | None = None
    state: StreamState | None = None
    refused: ErrorReply | None = None

    @classmethod
    def of(
        cls,
        update: StreamUpdate,
        answer: Piece | StreamState | None,
        refused: GuidefieldError | None,
        *,
        noted: bool,
        took: bool,
        wall: float,
        seconds: float,
    ) -> Updated:
        """The report of an update to a watcher, with its arrival and the time of work on it [s]."""
        piece = answer if isinstance(answer, Piece) else None
        state = answer if isinstance(answer, StreamState) else None
        error = None if refused is None else make_error_reply(refused)
        return cls(update, noted, took, wall, seconds, piece, state, error)


class GoalSearchBegun(msgspec.Struct, frozen=True, tag="sought"):
    """A search for configurations of a goal begins."""

    goal: StreamGoal


class Aimed(msgspec.Struct, frozen=True, tag="aimed"):
    """The goal is that of the n-th search; null: to stand."""

    number: int | None


class Halted(msgspec.Struct, frozen=True, tag="halted"):
    """A client requested a stop."""


Entry = Begun | Updated | GoalSearchBegun | Aimed | Halted

_encoder = msgspec.msgpack.Encoder(enc_hook=encode_part)
_decoder = msgspec.msgpack.Decoder(Entry, dec_hook=decode_part)


class Journal(StreamWatcher):
    """A watcher of a stream that writes its journal.

    Args:
        file_bytes: As `FILE_BYTES`.
        most_files: As `MOST_FILES`; together they have at most as many times `file_bytes` when another one begins.
    """

    def __init__(
        self,
        folder: Path,
        request: StreamOpen,
        user: str,
        versions: dict[str, str],
        file_bytes: int = FILE_BYTES,
        most_files: int = MOST_FILES,
    ) -> None:
        self._folder, self._request, self._user, self._versions = folder, request, user, versions
        self._file_bytes, self._most_files = file_bytes, most_files
        self._entries: queue.Queue[Any] = queue.Queue(MOST_WAITING)
        self._index = 0
        self._began = self._updated_at = time.monotonic()
        self._written = 0, 0  # index of the file, and bytes of its entries; set by the writing thread alone
        self._broken = True  # no file is begun
        self._again = self._began
        self._thread = threading.Thread(target=self._write_all, name="guidefield-journal", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write what waits, and end."""
        self._entries.put(None)
        self._thread.join()

    def begin_update(self) -> None:
        """An update came."""
        self._updated_at = time.monotonic()

    def end_update(
        self,
        update: StreamUpdate,
        answer: Piece | StreamState | None,
        refused: GuidefieldError | None,
        *,
        noted: bool,
        took: bool,
    ) -> None:
        """Take the outcome of an update."""
        now = time.monotonic()
        wall, seconds = self._updated_at - self._began, now - self._updated_at
        self._hand_over(Updated.of(update, answer, refused, noted=noted, took=took, wall=wall, seconds=seconds))

    def seek(self, goal: StreamGoal) -> None:
        """Record that a search for a goal begins."""
        self._hand_over(GoalSearchBegun(goal))

    def change_goal(self, number: int | None) -> None:
        """Record the number of another goal."""
        self._hand_over(Aimed(number))

    def halt(self) -> None:
        """Record a request to stop."""
        self._hand_over(Halted())

    def may_rest(self, snapshot: Callable[[], Snapshot], *, planning: bool) -> None:
        """Begin another file, if this one is large enough, or can't go on."""
        index, written = self._written
        full = index == self._index and written > self._file_bytes * (2 if planning else 1)
        mended = self._broken and self._entries.empty() and time.monotonic() >= self._again
        if not (mended or (full and not self._broken)):
            return
        self._broken = False
        self._index += 1
        self._began = time.monotonic()
        self._hand_over(Begun(self._request, self._user, self._index, time.time(), self._versions, snapshot()))

    def _hand_over(self, entry: Entry) -> None:
        if self._broken:
            return
        try:
            self._entries.put_nowait(entry)
        except queue.Full:
            self._broken = True
            _log.warning("a stream's journal can't keep up: it goes on in another file")

    def _write_all(self) -> None:
        lower_priority()
        file = None
        try:
            while (entry := self._entries.get()) is not None:
                try:
                    if isinstance(entry, Begun):
                        if file is not None:
                            file.close()
                        file = self._path(entry.index).open("xb")
                        self._drop_old()
                    if file is not None:
                        written = _encoder.encode(entry)
                        file.write(_LENGTH.pack(len(written)) + written)
                        if isinstance(entry, Begun):
                            self._written = entry.index, 0
                        else:
                            self._written = self._written[0], self._written[1] + len(written) + _LENGTH.size
                        if self._entries.empty():
                            file.flush()
                except Exception as error:  # the stream goes on, and so does this thread
                    _log.warning(
                        "a stream's journal can't be written: %s", error, exc_info=not isinstance(error, OSError)
                    )
                    self._broken, self._again = True, time.monotonic() + RETRY_AFTER
                    if file is not None:
                        _close(file)
                    file = None
        finally:
            if file is not None:
                _close(file)

    def _path(self, index: int) -> Path:
        self._folder.mkdir(parents=True, exist_ok=True)
        return self._folder / f"{index:06}{ENDING}"

    def _drop_old(self) -> None:
        """Drop the oldest files, those that are too many, or too large together; the newest one stays."""
        files = files_of(self._folder)
        sizes = [file.stat().st_size for file in files]
        most = self._most_files * self._file_bytes
        while len(files) > 1 and (len(files) > self._most_files or sum(sizes) > most):
            files.pop(0).unlink(missing_ok=True)
            sizes.pop(0)


def _close(file: Any) -> None:
    try:
        file.close()
    except OSError as error:
        _log.warning("a stream's journal can't be written: %s", error.strerror)


def files_of(folder: Path) -> list[Path]:
    """The files of a stream's journal, the oldest first."""
    return sorted(folder.glob(f"*{ENDING}"))


def entries_of(file: Path) -> Iterator[Entry]:
    """The entries of a file, up to the last whole one: the process that wrote it may have died.

    Raises:
        OSError: if it can't be read.
        msgspec.DecodeError: if it isn't such a file.
    """
    with file.open("rb") as read:
        while len(head := read.read(_LENGTH.size)) == _LENGTH.size:
            (length,) = _LENGTH.unpack(head)
            if length > LONGEST_ENTRY:
                raise msgspec.DecodeError("it has an entry that is too long")
            payload = read.read(length)
            if len(payload) < length:
                return
            yield _decoder.decode(payload)


MOST_KEPT = 8  # streams kept of a user (docs/stream.md): no fewer than one has open, or journals of open ones go


def file_bytes(most: int | None) -> int:
    """The size of a journal's files [bytes], given that of all journals of a user; None: unlimited."""
    return FILE_BYTES if most is None else min(FILE_BYTES, most // (MOST_KEPT * MOST_FILES))


def begin(streams: Path, name: str) -> Path:
    """The folder for the journal of a new stream; an earlier one of its name makes room, and so do the oldest.

    Raises:
        OSError: if the disk refuses.
    """
    streams.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(streams / name, ignore_errors=True)
    kept = sorted((_last_change(folder), folder) for folder in streams.iterdir() if folder.is_dir())
    for _, folder in kept[: max(0, len(kept) + 1 - MOST_KEPT)]:
        shutil.rmtree(folder, ignore_errors=True)
    (streams / name).mkdir()
    return streams / name


def kept_files(streams: Path, name: str) -> list[Path]:
    """The files of a stream's journal, the oldest first.

    Raises:
        MalformedRequest: if that can't be the name of a stream.
        UnknownObject: if nothing is kept of it.
    """
    files = files_of(streams / checked_name(name, "stream_id"))
    if not files:
        raise none_kept(name)
    return files


def none_kept(name: str) -> UnknownObject:
    """Make the error that nothing is kept of a stream."""
    return UnknownObject(f"nothing is kept of a stream {name!r}", stream=name)


def _last_change(folder: Path) -> float:
    try:
        return max((file.stat().st_mtime for file in files_of(folder)), default=folder.stat().st_mtime)
    except OSError:  # it was removed since
        return 0.0


Opens = Callable[[StreamOpen, TakeOver], CertifiedStream]  # opens a stream in this process


@dataclass(frozen=True)
class Replay:
    """The result of a replay."""

    updates: int
    pieces: int
    first: float | None = None  # time of the first update that is answered otherwise [s]; None: all are as they were
    was: Piece | StreamState | str | None = None  # that answer as it was recorded; of a refusal its message
    now: Piece | StreamState | str | None = None  # and as it is now

    @property
    def same(self) -> bool:
        """True if everything is as it was."""
        return self.first is None


def read(file: Path) -> tuple[Begun, list[Entry]]:
    """The first entry of a journal's file, and the others.

    Raises:
        MalformedRequest: if it isn't one, or one of another version.
    """
    try:
        first, *entries = entries_of(file)
    except msgspec.ValidationError as error:
        raise MalformedRequest(
            f"{file.name} hasn't the fields that files of streams have in this version: {error}", file=file.name
        ) from None
    except (msgspec.DecodeError, ValueError) as error:
        raise MalformedRequest(f"{file.name} is no file of a stream: {error}", file=file.name) from None
    if not isinstance(first, Begun):
        raise MalformedRequest(f"{file.name} is no file of a stream: it has no beginning", file=file.name)
    return first, entries


def replay(file: Path, opens: Opens) -> Replay:
    """Replay a file of a journal.

    Raises:
        MalformedRequest: if it isn't one.
        GuidefieldError: if the request of its stream is refused now.
    """
    begun, entries = read(file)
    times = [one.update.time for one in entries if isinstance(one, Updated) and one.took]
    request = msgspec.structs.replace(begun.request, goal=None, obstacles=[])
    with opens(request, AtRecordedTimes(times)) as stream:
        stream.resume(begun.snapshot)
        return _replay_entries(stream, entries)


def _replay_entries(stream: CertifiedStream, entries: Sequence[Entry]) -> Replay:
    searches: dict[int, GoalSearch] = {}
    updates = pieces = 0
    for entry in entries:
        if isinstance(entry, GoalSearchBegun):
            one = stream.seek(entry.goal)
            searches[one.number] = one
        elif isinstance(entry, Aimed):
            stream.take_goal(None if entry.number is None else searches.pop(entry.number))
        elif isinstance(entry, Halted):
            stream.stop()
        elif isinstance(entry, Updated):
            was = entry.piece or entry.state or (entry.refused.message if entry.refused else None)
            now = _replay_update(stream, entry)
            updates, pieces = updates + 1, pieces + isinstance(now, Piece)
            if now != was:
                return Replay(updates, pieces, entry.update.time, was, now)
    return Replay(updates, pieces)


def _replay_update(stream: CertifiedStream, entry: Updated) -> Piece | StreamState | str | None:
    try:
        return stream.note(entry.update) if entry.noted else stream.update(entry.update)
    except GuidefieldError as error:
        return make_error_reply(error).message
