"""One worker process as the service sees it: its jobs, and the frames that go to it (`process.py` is the other end).

Nothing here waits for the process. The pool's lock guards `Worker.current` and `Worker.held`.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import pickle
import socket
import threading
from collections.abc import Iterator
from typing import Any, NamedTuple

from guidefield.errors import WorkerCrashed
from guidefield.pool.process import FRAME, JOB, REQUIRED, Line, Numbers, Setup, be_worker
from guidefield.pool.waiting import Task
from guidefield.system import processor_time, resident

SOCKET_BUFFER_BYTES = 1 << 18  # size of the sockets' buffers, each way, and of one reading [bytes]
READ_AT_ONCE = 1 << 20  # read of one worker before others have their turn [bytes]; holds all of a dead one's last

spawn = multiprocessing.get_context("spawn")


class Frame(NamedTuple):
    """A message of a worker."""

    kind: int  # one of the kinds in `process.py`
    number: int  # of the job
    processor: float  # processor time that the job took [s]
    what: bytes  # a reply, a reason, or progress


class Current(NamedTuple):
    """A task that a worker works on: its number there, and when it was handed over, by `time.monotonic()` [s]."""

    task: Task
    number: int
    since: float


class Worker:
    """A worker process, from its start to its end.

    Attributes:
        current: What it works on.
        held: A brief job that it was sent besides, and will begin by itself.
        is_ready: Whether it is prepared.
        reason: Why it could not be prepared, or why it was stopped.
        awaits_room: Whether the pool waits until its socket takes the rest of a job.
    """

    def __init__(self, setup: Setup, memory: int, listened: Any) -> None:
        self.socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        for end in (self.socket, theirs):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER_BYTES)
        self.socket.setblocking(False)
        self.line = Line(spawn.RawValue(Numbers), listened, theirs)
        self.process = spawn.Process(
            target=be_worker, args=(setup, self.line, memory), name="guidefield-worker", daemon=True
        )
        self.current: Current | None = None
        self.held: Current | None = None
        self.is_ready = self.awaits_room = False
        self.reason: WorkerCrashed | str | None = None
        self._received = bytearray()  # the begin of a frame whose rest hasn't come
        self._buffer = bytearray(SOCKET_BUFFER_BYTES)
        self._rest: list[memoryview] = []  # of jobs, to be sent
        self._sending = threading.Lock()

    def start(self) -> None:
        """Start the process; it ends with the thread that calls this; raises OSError if the system refuses."""
        try:
            self.process.start()
        finally:
            self.line.socket.close()

    @property
    def is_idle(self) -> bool:
        """Return whether it could be given a job."""
        return self.is_ready and self.current is None

    def could_hold(self, since: float) -> bool:
        """Return whether it could be given a brief job beside the brief one that it works on, since a time [s]."""
        if self.held is not None or self._rest or self.current is None:
            return False
        return self.current.task.is_brief and self.current.since >= since

    @property
    def has_required_work(self) -> bool:
        """Return whether it has no job, but work after an answer that must be done."""
        return bool(self.line.numbers.remaining == REQUIRED) and self.current is None

    @property
    def is_working(self) -> bool:
        """Return whether it works, on a job or after an answer."""
        return self.current is not None or bool(self.line.numbers.remaining)

    @property
    def memory(self) -> int:
        """Resident memory [bytes]; 0 once it has ended."""
        return 0 if self.process.pid is None else resident(self.process.pid)

    @property
    def processor(self) -> float:
        """Processor time [s]; 0 once it has ended."""
        return 0.0 if self.process.pid is None else processor_time(self.process.pid)

    def kill(self) -> None:
        """End it at once."""
        with contextlib.suppress(OSError, AttributeError, ValueError):  # it has ended, or never began
            self.process.kill()

    def end(self, within: float) -> int | None:
        """Return the exit code, once it has ended; None if it hasn't within a time [s]."""
        with contextlib.suppress(OSError, AssertionError):  # it never began
            self.process.join(within)
        self.socket.close()
        return self.process.exitcode

    def done_with(self, number: int, now: float) -> Current | None:
        """Return the job of a number, which it is done with; from now on it works on the one that it holds."""
        if self.held is not None and self.held.number == number:
            held, self.held = self.held, None
            return held
        done = self.current
        if done is None or done.number != number:
            return None
        self.current, self.held = self.held, None
        if self.current is not None:
            self.current = self.current._replace(since=now)
            self.pass_on_cancel()
        return done

    def pass_on_cancel(self) -> None:
        """Let it know if its job is to be ended early."""
        current = self.current
        if current is not None and current.task.cancelled_by_client:
            self.line.numbers.cancelled = current.number

    def set_back(self) -> None:
        """Have it end its job early, to begin anew when it is its turn again."""
        if self.current is not None:
            self.line.numbers.set_back = self.current.number

    @property
    def late_at(self) -> float:
        """Time at which its job is answered without it, by `time.monotonic()` [s]; infinite: never."""
        current = self.current
        if current is None or current.task.late is None or current.task.done():
            return math.inf
        late = current.task.late
        return late.at_last if self.line.numbers.prepared == current.number else late.at

    def give(self, current: Current) -> bool:
        """Send it a job; return whether all of it went: `send_rest` sends the rest."""
        beside = list[pickle.PickleBuffer]()  # a large payload, which only the socket copies, without the interpreter

        def is_left_in(one: pickle.PickleBuffer) -> bool:
            if not beside:
                beside.append(one)
                return False
            return True

        job = pickle.dumps(current.task.job, 5, buffer_callback=is_left_in)
        payload = beside[0].raw() if beside else memoryview(b"")
        head = JOB.pack(current.number, len(job), len(payload))
        with self._sending:  # several threads may hand something over; each frame goes whole
            is_first = not self._rest
            self._rest += [memoryview(part) for part in (head, job, payload) if len(part)]
            return is_first and self._send_some()

    @property
    def has_rest(self) -> bool:
        """Return whether a part of a job is to be sent yet."""
        return bool(self._rest)

    def send_rest(self) -> bool:
        """Send more of the rest; return whether that was all."""
        with self._sending:
            return self._send_some()

    def _send_some(self) -> bool:
        try:
            sent = self.socket.sendmsg(self._rest) if self._rest else 0
        except BlockingIOError:
            sent = 0
        except OSError:  # it has ended, which its sentinel tells
            sent = sum(map(len, self._rest))
        while self._rest and sent >= len(self._rest[0]):
            sent -= len(self._rest.pop(0))
        if sent:
            self._rest[0] = self._rest[0][sent:]
        return not self._rest

    def read(self) -> Iterator[Frame]:
        """Yield the whole frames that have come; raises EOFError if the worker has ended."""
        count = 0
        while count < READ_AT_ONCE:
            try:
                size = self.socket.recv_into(self._buffer)
            except BlockingIOError:
                return
            except OSError:
                size = 0
            if not size:
                raise EOFError
            count += size
            self._received += memoryview(self._buffer)[:size]
            begin = 0
            while len(self._received) >= begin + FRAME.size:
                kind, number, processor, rest = FRAME.unpack_from(self._received, begin)
                end = begin + FRAME.size + rest
                if len(self._received) < end:
                    break
                yield Frame(kind, number, processor, bytes(memoryview(self._received)[begin + FRAME.size : end]))
                begin = end
            del self._received[:begin]
            if size < len(self._buffer):
                return
