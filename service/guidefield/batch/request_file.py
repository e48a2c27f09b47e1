"""The requests of a batch: a file with one JSON object on each line, read line by line."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from array import array
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from guidefield.errors import MalformedRequest

RECORDINGS = "recordings"
BLANK = 0
"""The fingerprint of a line without a request."""


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
        return f"{fingerprint(self.request):016x}"


class RequestFile:
    """The requests of a file, each on a line that isn't blank; a context manager.

    One line at a time is held in memory. What can be read only once, such as a pipe, is copied to a temporary file.

    Args:
        path: The file.

    Raises:
        MalformedRequest: if it can't be read.

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
        """Yield each line without its end; empty where it is blank."""
        self._file.seek(0)
        for line in self._file:
            yield line.rstrip(b"\r\n") if line.strip() else b""


def fingerprint(request: bytes) -> int:
    """Return a number for a request, which is never `BLANK`: 64 bits of SHA-256."""
    return int.from_bytes(hashlib.sha256(request).digest()[:8], "big") or 1
