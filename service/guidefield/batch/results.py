"""What has come of a batch by now: one line for each request in a file that is only added to."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec

from guidefield.errors import MalformedRequest, Status, WorkerCrashed
from guidefield.messages import codec
from guidefield.messages.replies import error_reply
from guidefield.whole_file import write_whole

RESULTS, RECORDINGS = "results.jsonl", "recordings"


@dataclass(frozen=True)
class Item:
    """One request of a batch.

    Attributes:
        line: Its line in the file, from 1.
        request: As it is written there.
        recording: Where its recording goes, if anywhere.
    """

    line: int
    request: bytes
    recording: Path | None

    @property
    def content(self) -> str:
        """A name for what is asked: a request that was edited is asked anew."""
        return hashlib.sha256(self.request).hexdigest()[:16]


@dataclass(frozen=True)
class Outcome:
    """What came of one request: JSON of its reply, or else of its error."""

    item: Item
    is_reply: bool
    payload: bytes


class _Line(msgspec.Struct, omit_defaults=True):
    """One line of the results."""

    line: int
    request: str
    reply: msgspec.Raw = msgspec.Raw()
    error: msgspec.Raw = msgspec.Raw()


class _Named(msgspec.Struct):
    code: int = 1
    status: _Named | None = None


class Results:
    """The results in a folder; a context manager.

    A line is written whole after the request's recording. What a killed process left of a line is cut off, and that
    request is asked again; so is one whose worker crashed.

    Args:
        folder: Made if it isn't there.

    Raises:
        MalformedRequest: if its results can't be understood.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / RESULTS
        self._done: dict[tuple[int, str], int] = {}
        whole = b""
        for line in self._path.read_bytes().splitlines(keepends=True) if self._path.exists() else ():
            if line.endswith(b"\n") and self._keep(line):
                whole += line
        write_whole(self._path, whole)
        self._file = self._path.open("ab")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def has(self, item: Item) -> bool:
        """Whether a request is answered."""
        return (item.line, item.content) in self._done

    def add(self, outcome: Outcome) -> None:
        """Keep what came of a request."""
        raw = msgspec.Raw(outcome.payload)
        line = _Line(outcome.item.line, outcome.item.content, **{"reply" if outcome.is_reply else "error": raw})
        self._file.write(msgspec.json.encode(line) + b"\n")
        self._file.flush()
        self._note(line)

    def codes(self) -> list[int]:
        """The codes of all replies and errors; a reply without a status counts as a success."""
        return list(self._done.values())

    def _keep(self, text: bytes) -> bool:
        try:
            return self._note(msgspec.json.decode(text, type=_Line)) != Status.CRASH
        except msgspec.DecodeError as error:
            raise MalformedRequest(
                f"{str(self._path)!r} holds something else than the results of a batch ({error}); choose another folder"
            ) from None

    def _note(self, line: _Line) -> int:
        named = msgspec.json.decode(line.reply or line.error or b"{}", type=_Named)
        code = named.code if named.status is None else named.status.code
        if code != Status.CRASH:
            self._done[line.line, line.request] = code
        return code


def items(requests: Path, folder: Path, *, recordings: bool) -> Iterator[Item]:
    """The requests of a file, one JSON object on each line that isn't blank; their recordings go to a folder.

    Raises:
        MalformedRequest: if the file can't be read.
    """
    try:
        lines = requests.read_bytes().splitlines()
    except OSError as error:
        raise MalformedRequest(
            f"the requests can't be read: {requests.name}: {error.strerror}", path=str(requests)
        ) from None
    for number, line in enumerate(lines, 1):
        if line.strip():
            yield Item(number, line, folder / RECORDINGS / f"{number}.rrd" if recordings else None)


def crashed(item: Item, error: WorkerCrashed) -> Outcome:
    """The outcome of a request whose worker died."""
    return Outcome(item, False, codec.encode(error_reply(error)))
