"""A worker process: it is prepared once, answers one job after the other, and ends with its parent.

Theory of operation. Jobs and answers go through one pair of sockets, each as a frame: a head of fixed size, and bytes.
`Numbers`, in shared memory, are what must be known while a worker works, or after it died. `slot.py` is the other end
of the sockets; heads and kinds of frames are those of both.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import multiprocessing
import os
import pickle
import resource
import signal
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing import connection
from typing import Any

from guidefield.errors import GuidefieldError
from guidefield.pool.waiting import Answer

DATA_LIMIT_FACTOR = 2  # limit of a worker's data segment as a multiple of its memory limit, so huge allocations fail
LONGEST_REASON = 4096  # maximum length of the reason why a worker can't be prepared [characters]
JOB = struct.Struct("<QQQ")
"""Head of a job's frame: its number, its size when pickled, and that of the buffer behind it, if it has one."""
FRAME = struct.Struct("<BQdQ")
"""Head of what a worker sends: kind, number of the job, processor time that it took [s], how many bytes follow."""
READY, UNPREPARED, PROGRESS, REPLY, REFUSAL, SET_BACK, FAILED = range(7)
"""Kinds of what a worker sends: it is prepared; it can't be, and why; progress; outcomes of a job."""
NOTHING, OPTIONAL, REQUIRED = range(3)
"""Work that remains after an answer: none; work that ends early for the next job; work to be done before that."""
_PR_SET_PDEATHSIG = 1  # option of Linux's `prctl`: the signal that a process gets when the thread that started it ends

_log = logging.getLogger(__name__)


class Numbers(ctypes.Structure):
    """The numbers that a worker and its process share in memory.

    Attributes:
        begun: The job that was begun last.
        cancelled: The job that is to be ended early.
        set_back: The job that is to be ended early because it will be begun anew.
        prepared: The job that a worker is done preparing for.
        remaining: The work that remains after an answer: `NOTHING`, `OPTIONAL` or `REQUIRED`.
    """

    _fields_ = [(name, ctypes.c_uint64) for name in ("begun", "cancelled", "set_back", "prepared", "remaining")]


@dataclass(frozen=True)
class Line:
    """A worker's side of what it shares with its parent."""

    numbers: Any  # `Numbers`
    listened: Any  # whether anybody listens to progress, in shared memory of all workers
    socket: socket.socket  # the worker's end of their pair of sockets

    def tell(self, kind: int, number: int = 0, processor: float = 0.0, what: bytes = b"") -> None:
        """Send one frame, whole though several threads do; return once it is on its way."""
        with _telling:
            sent = self.socket.sendmsg([FRAME.pack(kind, number, processor, len(what)), what])
            if sent < FRAME.size + len(what):  # the head is sent: it is shorter than any buffer's room
                self.socket.sendall(memoryview(what)[sent - FRAME.size :])


_telling = threading.Lock()


@dataclass(frozen=True)
class Call:
    """The connection of a job, in its worker, to the service and the client; the `Watcher` of a run."""

    number: int
    line: Line
    later: list[Callable[[], None]] = field(default_factory=list)

    def is_cancelled(self) -> bool:
        """Return whether the job is to end early, for any reason."""
        return self.number in (self.line.numbers.cancelled, self.line.numbers.set_back)

    def set_back(self) -> bool:
        """Return whether it is to be ended early and will be begun anew: then it leaves no trace."""
        return bool(self.line.numbers.set_back == self.number)

    def be_prepared(self) -> None:
        """Say that what the job needs is loaded: from now on it checks its deadline itself."""
        self.line.numbers.prepared = self.number

    def defer_optional(self, work: Callable[[], None]) -> None:
        """Have work done after the answer; it must end early once `is_awaited` is true."""
        self.line.numbers.remaining = max(OPTIONAL, self.line.numbers.remaining)
        self.later.append(work)

    def defer_required(self, work: Callable[[], None]) -> None:
        """Have work done after the answer, and before the next job; the worker lives until then, if it can."""
        self.line.numbers.remaining = REQUIRED
        self.later.append(work)

    def is_awaited(self) -> bool:
        """Return whether the next job has come."""
        return bool(connection.wait([self.line.socket], 0.0))

    def finish(self) -> None:
        """Do the work that remains after the answer."""
        for work in self.later:
            try:
                work()
            except Exception:  # the worker outlives it
                _log.exception("what a worker does after an answer failed")
        self.line.numbers.remaining = NOTHING

    def is_listened_to(self) -> bool:
        """Return whether anybody listens to progress."""
        return bool(self.line.listened.value)

    def tell(self, what: bytes) -> None:
        """Send the client progress, as `Watcher.tell`; it is lost if nobody listens."""
        with contextlib.suppress(OSError):
            self.line.tell(PROGRESS, self.number, what=what)


Work = Callable[[Any, Call], Answer | None]
"""Answers one job; it must not raise. None: the job was set back, and ended early for that."""
Setup = Callable[[], Work]
"""Prepares a worker process and returns what answers there; it is sent there, so it must pickle."""


def be_worker(setup: Setup, line: Line, memory: int) -> None:
    """Make this process a worker that may have some memory [bytes], and answer jobs until its parent ends it.

    If it can't be prepared, it tells why and ends.
    """
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all; the parent ends its workers
    try:
        answer = setup()
    except GuidefieldError as error:
        line.tell(UNPREPARED, what=error.message[:LONGEST_REASON].encode())
        sys.exit(1)
    limit_memory(memory)
    line.tell(READY)
    with contextlib.suppress(EOFError, ConnectionError):  # the parent has ended
        while True:
            number, size, beside = JOB.unpack(_read(line.socket, JOB.size))
            line.numbers.begun = number
            began = time.process_time()
            call = Call(number, line)
            kind, what = _outcome(answer, _read(line.socket, size), _read(line.socket, beside), call)
            line.tell(kind, number, time.process_time() - began, what)
            call.finish()


def _outcome(answer: Work, job: bytearray, beside: bytearray, call: Call) -> tuple[int, bytes]:
    try:
        found = answer(pickle.loads(job, buffers=[beside]), call)  # noqa: S301 - our own parent's
    except Exception as error:
        _log.exception("a job failed in its worker")
        return FAILED, f"{type(error).__name__}: {error}"[:LONGEST_REASON].encode()
    if found is None:
        return SET_BACK, b""
    return REPLY if found[0] else REFUSAL, found[1]


def _read(source: socket.socket, size: int) -> bytearray:
    read = bytearray(size)
    left = memoryview(read)
    while left:
        count = source.recv_into(left)
        if not count:
            raise EOFError
        left = left[count:]
    return read


def limit_memory(memory: int) -> None:
    """Have huge allocations fail at once in this process, which may have some memory [bytes]."""
    resource.setrlimit(resource.RLIMIT_DATA, (DATA_LIMIT_FACTOR * memory, resource.RLIM_INFINITY))


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
    """Kill this process once a sentinel is ready, as that of a parent is when it has ended; return at once."""

    def wait() -> None:
        connection.wait([sentinel])
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=wait, name="guidefield-parent", daemon=True).start()
