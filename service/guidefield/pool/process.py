"""What runs in a worker process: it is prepared once, says what it begins, and ends with its parent."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import multiprocessing
import os
import resource
import signal
import socket
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import connection
from typing import Any

from guidefield.errors import GuidefieldError
from guidefield.pool.waiting import Answer

DATA_ROOM = 2
"""How many times its memory limit a worker may ask the system for: one huge allocation fails at once."""

LONGEST_REASON = 4096
"""Longest reason that is told of a worker that can't be prepared [characters]."""

_PR_SET_PDEATHSIG = 1
"""Of Linux's `prctl`: which signal a process gets when the thread that started it ends."""


@dataclass(frozen=True)
class Line:
    """What a slot and its worker process share.

    Attributes:
        begun: Number of the job that was begun last, in shared memory.
        cancelled: Number of the job that is to be ended early, in shared memory.
        set_back: Number of the job that is to be ended early because it will be begun anew, in shared memory.
        prepared: Number of the job that a worker is done preparing for, in shared memory.
        owed: How much a worker still has to do after its answers, in shared memory.
        told: Where a worker sends what it tells, one packet each: a process that is killed leaves no half of one.
    """

    begun: Any
    cancelled: Any
    set_back: Any
    prepared: Any
    owed: Any
    told: socket.socket


@dataclass(frozen=True)
class Call:
    """A job's line to those who wait for it."""

    number: int
    line: Line

    def cancelled(self) -> bool:
        """Whether the job is to be ended early, whatever for."""
        return self.number in (self.line.cancelled.value, self.line.set_back.value)

    def set_back(self) -> bool:
        """Whether it is to be ended early and will be begun anew: then it leaves no trace."""
        return bool(self.line.set_back.value == self.number)

    def be_prepared(self) -> None:
        """Say that what the job needs is loaded: from now on it minds its time by itself."""
        self.line.prepared.value = self.number

    def owe(self, count: int) -> None:
        """Say how much is owed, after answers that were given: the worker lives until that is done, if it can."""
        self.line.owed.value = count

    def tell(self, what: bytes) -> None:
        """Tell something; it is lost if nobody listens, and never waits."""
        with contextlib.suppress(OSError):
            self.line.told.send(what)


Work = Callable[[Any, Call], Answer | None]
"""Answers one job; it must not raise. None: the job was set back, and ended early for that."""

Setup = Callable[[], Work]
"""Prepares a worker process and returns what answers there; it is sent there, so it must pickle."""

_answers: Work | None = None
"""In a worker process: what answers there."""
_line: Line | None = None
"""In a worker process: what it shares with its slot."""


def prepare(setup: Setup, line: Line, memory: int) -> None:
    """Make this process a worker that may have some memory [bytes]; where that is refused, tell why and end."""
    global _answers, _line
    end_with_parent()
    line.told.setblocking(False)
    try:
        _answers, _line = setup(), line
    except GuidefieldError as error:
        line.told.send(error.message[:LONGEST_REASON].encode())
        logging.disable()  # the reason is told: pebble would log where in our source it was found
        raise
    limit_memory(memory)


def limit_memory(memory: int) -> None:
    """Have huge allocations of this process fail at once, where it may have some memory [bytes]."""
    resource.setrlimit(resource.RLIMIT_DATA, (DATA_ROOM * memory, resource.RLIM_INFINITY))


def end_with_parent() -> None:
    """Have this process killed when the one that started it ends.

    On Linux by the system, even in the middle of a native call; elsewhere by a thread, as soon as it gets its turn.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None, "a worker is spawned"
    if sys.platform != "linux":
        end_after(parent.sentinel)
        return
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL)) != 0:
        raise OSError(ctypes.get_errno(), "a worker can't be made to end with its parent")
    if os.getppid() != parent.pid:  # it ended before
        os._exit(1)


def end_after(sentinel: int) -> None:
    """Kill this process once a sentinel is ready, as that of a parent is when it has ended; returns at once."""

    def wait() -> None:
        connection.wait([sentinel])
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=wait, name="guidefield-parent", daemon=True).start()


def work(number: int, job: Any) -> Answer | None:
    """Answer one job, after saying that it is begun; None if it was set back."""
    assert _answers is not None, "a worker is prepared before it works"
    assert _line is not None, "a worker is prepared before it works"
    _line.begun.value = number
    return _answers(job, Call(number, _line))
