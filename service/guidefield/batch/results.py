"""The requests of a batch, a file read line by line, and its results, a file with a line for each answer.

Users read `results.jsonl`, and a batch that was ended goes on from it: fields and fingerprints have to stay.
"""

from __future__ import annotations

import fcntl
import hashlib
import shutil
import tempfile
from array import array
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

import msgspec

from guidefield.errors import MalformedRequest, Status, WorkerCrashed
from guidefield.messages import codec
from guidefield.messages.replies import make_error_reply

RECORDINGS = "recordings"  # folder of recordings, named by the line of the request
BLANK = 0  # the fingerprint of a line without a request


@dataclass(frozen=True)
class Item:
    """One request of a batch: its line from 1, its text, and its recording's file, if any."""

    line: int
    request: bytes
    recording: Path | None

    @property
    def content(self) -> str:
        """The request's fingerprint in hexadecimal, as results have it: a request that was edited is asked anew."""
        return f"{fingerprint(self.request):016x}"


class RequestFile:
    """The requests of a file, each on a line that isn't blank; a context manager.

    One line at a time is held in memory. What can be read only once, such as a pipe, is copied to a temporary file.

    Attributes:
        fingerprints: A number for the request on each line from 1, or `BLANK`; 8 bytes a line.
    """

    def __init__(self, path: Path) -> None:
        with ExitStack() as opened:
            try:
                self._file: BinaryIO = opened.enter_context(path.open("rb"))
                if not self._file.seekable():
                    copy = opened.enter_context(tempfile.TemporaryFile())
                    shutil.copyfileobj(self._file, copy)
                    self._file = copy
                self.fingerprints = array("Q", [BLANK])
                self.fingerprints.extend(fingerprint(request) if request else BLANK for request in self._lines())
            except OSError as error:
                raise MalformedRequest(
                    f"the requests can't be read: {path.name}: {error.strerror}", path=str(path)
                ) from None
            self._opened = opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    def __len__(self) -> int:
        """Count the requests."""
        return len(self.fingerprints) - self.fingerprints.count(BLANK)

    def items(self, folder: Path, *, recordings: bool) -> Iterator[Item]:
        """Yield the requests in their order; their recordings go to a folder."""
        for number, request in enumerate(self._lines(), 1):
            if request:
                yield Item(number, request, folder / RECORDINGS / f"{number}.rrd" if recordings else None)

    def _lines(self) -> Iterator[bytes]:
        self._file.seek(0)
        for line in self._file:
            yield line.rstrip(b"\r\n") if line.strip() else b""


def fingerprint(request: bytes) -> int:
    """Return a number for a request, which is never `BLANK`: 64 bits of SHA-256."""
    return int.from_bytes(hashlib.sha256(request).digest()[:8], "big") or 1


RESULTS = "results.jsonl"
LINE_BEGIN = b'{"line":'  # the first field of `_ResultRecord`: so begins a torn line, too
READ_AT_ONCE = 1 << 20  # buffer for the file that is read [bytes]


@dataclass(frozen=True)
class ItemAnswer:
    """The outcome of one request: JSON of its reply, or else of its error."""

    item: Item
    is_reply: bool
    payload: bytes


class _ResultRecord(msgspec.Struct, omit_defaults=True):
    line: int
    request: str
    reply: msgspec.Raw = msgspec.Raw()
    error: msgspec.Raw = msgspec.Raw()


class _Answer(msgspec.Struct):
    code: int = Status.SUCCESS
    status: _Answer | None = None

    def outcome(self) -> int:
        """Return the code of a reply's status, or of an error; a reply without a status is a success."""
        return self.code if self.status is None else self.status.code


class _Result(msgspec.Struct):
    line: int
    request: str
    reply: _Answer | None = None
    error: _Answer | None = None


class Results:
    """The results of a batch in a folder; a context manager.

    A line is written whole after the request's recording. What a killed process left of a line is cut off, and that
    request is asked again; so is one whose worker crashed, which then has a second line. Nothing is rewritten, and
    nothing is held in memory but 9 bytes for each line of the requests. Results of other requests, such as of a line
    before it was edited, don't count.

    Raises:
        MalformedRequest: if its results can't be understood, or another process adds to them.

    Attributes:
        codes: How often each code was answered, without crashes; a reply without a status counts as a success.
    """

    def __init__(self, folder: Path, requests: RequestFile) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / RESULTS
        self._wanted = requests.fingerprints
        self._answered = bytearray(len(self._wanted))
        self.codes: Counter[int] = Counter()
        self._file = self._path.open("ab")
        try:
            self._lock()
            end = self._read()
            if end < self._file.tell():
                self._file.truncate(end)
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def has(self, item: Item) -> bool:
        """Tell if a request is answered."""
        return bool(self._answered[item.line])

    def add(self, outcome: ItemAnswer) -> None:
        """Write the outcome of a request."""
        item, raw = outcome.item, msgspec.Raw(outcome.payload)
        line = _ResultRecord(item.line, item.content, **{"reply" if outcome.is_reply else "error": raw})
        self._file.write(msgspec.json.encode(line) + b"\n")
        self._file.flush()
        self._note(item.line, msgspec.json.decode(outcome.payload, type=_Answer).outcome())

    def _lock(self) -> None:
        """Keep other processes out, where the file system has locks."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise MalformedRequest(
                f"another process adds to {str(self._path)!r}; wait for it, or choose another folder"
            ) from None
        except OSError:
            return

    def _read(self) -> int:
        """Read all whole lines; return where they end [bytes]."""
        end = 0
        with self._path.open("rb", READ_AT_ONCE) as file:
            for text in file:
                if not text.endswith(b"\n") and text.startswith(LINE_BEGIN[: len(text)]):
                    break  # a killed process was writing it
                end += len(text)
                result = self._decode(text)
                known = 0 < result.line < len(self._wanted) and self._wanted[result.line] != BLANK
                if known and f"{self._wanted[result.line]:016x}" == result.request:
                    self._note(result.line, (result.reply or result.error or _Answer()).outcome())
        return end

    def _decode(self, text: bytes) -> _Result:
        try:
            return msgspec.json.decode(text, type=_Result)
        except msgspec.DecodeError as error:
            raise MalformedRequest(
                f"{str(self._path)!r} holds something else than the results of a batch ({error}); choose another folder"
            ) from None

    def _note(self, line: int, code: int) -> None:
        if code != Status.CRASH and not self._answered[line]:
            self._answered[line] = True
            self.codes[code] += 1


def make_crash_answer(item: Item, error: WorkerCrashed) -> ItemAnswer:
    """Return the outcome of a request whose worker died."""
    return ItemAnswer(item, False, codec.encode(make_error_reply(error)))
