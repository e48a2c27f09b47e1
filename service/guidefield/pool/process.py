"""Worker processes: one that answers job after job, and one for a single conversation; both end with their parent.

Theory of operation of a worker. Jobs and answers go through one pair of sockets, each as a frame: a head of fixed size,
and bytes. `Numbers`, in shared memory, are what must be known while a worker works, or after it died. `slot.py` is the
other end of the sockets, with the same heads of frames; `pool.py` reads their kinds.

Theory of operation of a conversation. One thread starts the process, which ends with this thread at the latest, and
hears its messages; another thread sends messages, so that no caller waits for a process that takes none. The messages
that wait are bounded. The first thread checks every `CHECK_INTERVAL_S` that the process lives, keeps to its memory, and
acknowledges messages by `Taken`, which the conversation must send.
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
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from guidefield.errors import GuidefieldError, WorkerCrashed
from guidefield.pool.waiting import Answer
from guidefield.system import resident

DATA_LIMIT_FACTOR = 2  # limit of a process's data segment as a multiple of its memory limit: huge allocations fail
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


CHECK_INTERVAL_S = 0.1  # period at which a process is checked [s]
MAX_WAITING_MESSAGES = 1_000  # maximum number of messages that wait to be sent
MAX_WAITING_BYTES = 64 << 20  # their maximum size together [bytes]
MAX_SILENCE_S = 10.0  # time without an acknowledgement, while messages wait, after which a process is ended [s]
# this and the number of messages are in docs/wire.md by endpoint/rules.py: after a change, `tools/wire_page`

_spawn = multiprocessing.get_context("spawn")

Conversation = Callable[[Connection], None]
"""The work of a process, given the line to its parent; it must pickle."""


@dataclass(frozen=True)
class Taken:
    """The process's acknowledgement of messages that it took."""

    count: int


class Companion:
    """A process for one conversation.

    Args:
        conversation: Its work.
        memory: Limit of its memory [bytes]; beyond that it is ended.
        hear: Called with each of its messages but `Taken`, in a thread of its own.
        over: Called at each check, in that thread; returns the reason if the conversation is to end.
        ended: Called once, in that thread, with the reason, when the process is gone.
    """

    def __init__(
        self,
        conversation: Conversation,
        memory: int,
        hear: Callable[[Any], None],
        over: Callable[[], GuidefieldError | None],
        ended: Callable[[GuidefieldError], None],
    ) -> None:
        self._conversation, self._memory = conversation, memory
        self._hear, self._over, self._ended = hear, over, ended
        self._pid: int | None = None
        self._waiting: deque[tuple[Any, int]] = deque()
        self._size = self._unfinished = 0
        self._got_on = time.monotonic()
        self._closed = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._attend, name="guidefield-companion", daemon=True)

    def start(self) -> None:
        """Begin to start the process."""
        self._thread.start()

    @property
    def memory(self) -> int:
        """Its resident memory [bytes]; 0 without a process."""
        return 0 if self._pid is None else resident(self._pid)

    @property
    def pid(self) -> int | None:
        """The process, once there is one."""
        return self._pid

    def tell(self, what: Any, size: int) -> bool:
        """Send the process a message of a size [bytes] soon; return False if too much waits, or it is over."""
        with self._changed:
            full = len(self._waiting) >= MAX_WAITING_MESSAGES or self._size + size > MAX_WAITING_BYTES
            if self._closed or (full and self._waiting):
                return False
            if not self._unfinished:
                self._got_on = time.monotonic()
            self._waiting.append((what, size))
            self._size += size
            self._unfinished += 1
            self._changed.notify()
            return True

    def join(self, timeout: float) -> bool:
        """Return whether it is over within a time [s]."""
        self._thread.join(max(0.0, timeout))
        return not self._thread.is_alive()

    def _attend(self) -> None:
        here, there = _spawn.Pipe()
        process = _spawn.Process(
            target=_converse, args=(self._conversation, there, self._memory), name="guidefield-companion", daemon=True
        )
        sender = threading.Thread(target=self._send, args=(here,), name="guidefield-companion-line", daemon=True)
        error: GuidefieldError
        try:
            process.start()
            there.close()
            assert process.pid is not None, "it is started"
            self._pid = process.pid
            sender.start()
            error = self._listen(here, process)
        except Exception as failure:  # the caller must hear of it
            _log.exception("a process for a conversation failed")
            error = WorkerCrashed(f"the process could not be started or heard: {failure}")
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        with contextlib.suppress(OSError, ValueError, AttributeError):
            process.kill()
            process.join()
        if sender.ident is not None:
            sender.join()  # nothing is at the other end, so it holds on to nothing
        here.close()
        self._ended(error)

    def _listen(self, line: Connection, process: BaseProcess) -> GuidefieldError:
        looked, death = time.monotonic(), WorkerCrashed("the process that worked on it died; the service lives on")
        while True:
            try:
                if line.poll(CHECK_INTERVAL_S):
                    what = line.recv()
                    if isinstance(what, Taken):
                        with self._changed:
                            self._unfinished -= what.count
                            self._got_on = time.monotonic()
                    else:
                        self._hear(what)
            except (EOFError, OSError):
                return death
            now = time.monotonic()
            if now - looked < CHECK_INTERVAL_S:
                continue
            looked = now
            if (over := self._over()) is not None:
                return over
            if self.memory > self._memory:
                limit = self._memory // 2**20
                return WorkerCrashed(f"it took more than {limit} MiB of memory and was ended", mebibytes=limit)
            if self._unfinished > 0 and now - self._got_on > MAX_SILENCE_S:
                silent = f"it got on with nothing for {MAX_SILENCE_S:g} s and was ended"
                return WorkerCrashed(silent, seconds=MAX_SILENCE_S)
            if not process.is_alive() and not line.poll(0.0):
                return death

    def _send(self, line: Connection) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._waiting)
                if self._closed:
                    return
                what, size = self._waiting.popleft()
                self._size -= size
            try:
                line.send(what)
            except (OSError, ValueError):  # it is gone, as the listening thread finds, too
                return


def _converse(conversation: Conversation, line: Connection, memory: int) -> None:
    end_with_parent()
    limit_memory(memory)
    conversation(line)
