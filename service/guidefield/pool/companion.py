"""A process of its own for one conversation: taken when that begins, looked after while it goes on, ended with it.

Theory of operation. One thread here starts the process, which ends with this thread at the latest, and hears what it
tells; another one sends what it is told, so that nobody waits for a process that takes nothing. What waits to be sent
is bounded. Every so often it is looked whether the process lives, how much memory it has, and whether it still gets on:
whoever is told something says so when it is done with it.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from guidefield.errors import GuidefieldError, WorkerCrashed
from guidefield.pool.process import end_with_parent, limit_memory
from guidefield.system import resident

LOOK_EVERY = 0.1  # how often it is looked after a process [s]
MOST_WAITING = 1_000  # so many things may wait to be sent to a process
MOST_BYTES_WAITING = 64 << 20  # how large they may be together [bytes]
STUCK = 10.0  # a process that has taken nothing for so long while something waited is ended [s]

_log = logging.getLogger(__name__)
_spawn = multiprocessing.get_context("spawn")

Conversation = Callable[[Connection], None]
"""What a process does, given the line to who started it; it is sent there, so it must pickle."""


@dataclass(frozen=True)
class Taken:
    """A process has come to the end of what it was told last."""

    count: int


class Companion:
    """A process for one conversation.

    Args:
        conversation: What it does.
        memory: It is ended where it takes more [bytes].
        hear: Is called with whatever it tells, but `Taken`, in a thread of its own.
        over: Is asked every so often, in that thread: why the conversation is to end, if it is.
        ended: Is called once, in that thread, when the process is gone: why.
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
        """Its resident memory [bytes]; 0 where there is none."""
        return 0 if self._pid is None else resident(self._pid)

    @property
    def pid(self) -> int | None:
        """The process, once there is one."""
        return self._pid

    def tell(self, what: Any, size: int) -> bool:
        """Have something told to the process; waits for nothing.

        Returns:
            Whether it will be; it isn't where too much waits already, or the conversation is over.
        """
        with self._changed:
            full = len(self._waiting) >= MOST_WAITING or self._size + size > MOST_BYTES_WAITING
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
        """Whether it is over within a time [s]."""
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
        except Exception as failure:  # whoever waits must hear of it
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
        """Hear what the process tells, until the conversation is over; return why it is."""
        looked, death = time.monotonic(), WorkerCrashed("the process that worked on it died; the service lives on")
        while True:
            try:
                if line.poll(LOOK_EVERY):
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
            if now - looked < LOOK_EVERY:
                continue
            looked = now
            if (over := self._over()) is not None:
                return over
            if self.memory > self._memory:
                limit = self._memory // 2**20
                return WorkerCrashed(f"it took more than {limit} MiB of memory and was ended", mebibytes=limit)
            if self._unfinished > 0 and now - self._got_on > STUCK:
                return WorkerCrashed(f"it got on with nothing for {STUCK:g} s and was ended", seconds=STUCK)
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
            except (OSError, ValueError):  # it is gone, which who listens finds out too
                return


def _converse(conversation: Conversation, line: Connection, memory: int) -> None:
    """What runs in the process."""
    end_with_parent()
    limit_memory(memory)
    conversation(line)
