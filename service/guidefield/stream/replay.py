"""Replay a file of a stream's journal, and compare the answers with the recorded ones, to the last bit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from guidefield.errors import GuidefieldError, MalformedRequest
from guidefield.messages.replies import make_error_reply
from guidefield.messages.streams import Piece, StreamOpen, StreamState
from guidefield.stream.journal import Aimed, Begun, Entry, Halted, SoughtGoal, Updated, entries_of
from guidefield.stream.path_planner import AtRecordedTimes, TakeOver
from guidefield.stream.stream import CertifiedStream, GoalSearch

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
        """Whether everything is as it was."""
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
    sought: dict[int, GoalSearch] = {}
    updates = pieces = 0
    for entry in entries:
        if isinstance(entry, SoughtGoal):
            one = stream.seek(entry.goal)
            sought[one.number] = one
        elif isinstance(entry, Aimed):
            stream.take_goal(None if entry.number is None else sought.pop(entry.number))
        elif isinstance(entry, Halted):
            stream.stop()
        elif isinstance(entry, Updated):
            was = entry.piece or entry.state or (entry.refused.message if entry.refused else None)
            now = _updated(stream, entry)
            updates, pieces = updates + 1, pieces + isinstance(now, Piece)
            if now != was:
                return Replay(updates, pieces, entry.update.time, was, now)
    return Replay(updates, pieces)


def _updated(stream: CertifiedStream, entry: Updated) -> Piece | StreamState | str | None:
    try:
        return stream.note(entry.update) if entry.noted else stream.update(entry.update)
    except GuidefieldError as error:
        return make_error_reply(error).message
