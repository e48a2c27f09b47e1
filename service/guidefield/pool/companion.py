"""A process for one conversation, such as a stream: started with it, supervised while it lasts, ended with it.

Theory of operation. One thread starts the process, which ends with this thread at the latest, and hears its messages;
another thread sends messages, so that no caller waits for a process that takes none. The messages that wait are
bounded. The first thread checks every `CHECK_INTERVAL_S` that the process lives, keeps to its memory, and acknowledges
messages by `Taken`, which the conversation must send.
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

CHECK_INTERVAL_S = 0.1  # period at which a process is checked [s]
MAX_WAITING_MESSAGES = 1_000  # maximum number of messages that wait to be sent
MAX_WAITING_BYTES = 64 << 20  # their maximum size together [bytes]
MAX_SILENCE_S = 10.0  # time without an acknowledgement, while messages wait, after which a process is ended [s]

_log = logging.getLogger(__name__)
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
