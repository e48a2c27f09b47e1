"""Capture what C++ libraries write to the process's stderr, to quote their reason in errors."""

from __future__ import annotations

import fcntl
import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager

MAX_CAUGHT_BYTES = 64 * 1024
"""Only so much of what was written is kept, from its beginning."""

_STDERR = 2
_FIRST_ORDINARY = 3
_ONE_AT_A_TIME = threading.RLock()
_SOURCE_LINE = re.compile(r"\s*at line \d+ in \S+")


class CapturedStderr:
    """What has been written to stderr so far; readable within the capture and after it."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor: int | None = descriptor
        self._kept = b""

    def text(self) -> str:
        """Everything that was written, as it was."""
        return self._bytes().decode(errors="replace")

    def reason(self) -> str:
        """The same on one line: without severities, places in the library's source, and repetitions."""
        lines = (line.strip().removeprefix("Error:").strip() for line in self.text().splitlines())
        stated = dict.fromkeys(line for line in lines if line and not _SOURCE_LINE.fullmatch(line))
        return "; ".join(stated)

    def _bytes(self) -> bytes:
        if self._descriptor is None:
            return self._kept
        return os.pread(self._descriptor, MAX_CAUGHT_BYTES, 0)

    def _finish(self) -> None:
        self._kept = self._bytes()
        self._descriptor = None


@contextmanager
def captured_stderr() -> Iterator[CapturedStderr]:
    """Redirect file descriptor 2 to a temporary file while the block runs.

    This is process-wide: whatever any thread or library writes to stderr meanwhile is caught too, and is not written
    anywhere else. So keep the block short, and use it where one thread does the work. Captures of several threads wait
    for each other; they may be nested. If the process has no stderr, it has none afterwards either.
    """
    with _ONE_AT_A_TIME:
        _flush()
        saved = _duplicate(_STDERR)
        sink = _temporary_file()
        os.dup2(sink, _STDERR)
        captured = CapturedStderr(sink)
        try:
            yield captured
        finally:
            _flush()
            captured._finish()
            if saved is None:
                os.close(_STDERR)
            else:
                os.dup2(saved, _STDERR)
                os.close(saved)
            os.close(sink)


def _duplicate(descriptor: int) -> int | None:
    """Another descriptor of the same file, never one of the three standard ones; None if it is closed."""
    try:
        return fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, _FIRST_ORDINARY)
    except OSError:
        return None


def _temporary_file() -> int:
    with tempfile.TemporaryFile() as file:  # where stderr is closed, this one may have got its number
        descriptor = _duplicate(file.fileno())
    assert descriptor is not None, "an open file can be duplicated"
    return descriptor


def _flush() -> None:
    if sys.stderr is not None and not sys.stderr.closed:
        try:
            sys.stderr.flush()
        except OSError:  # nobody reads it any more
            return
