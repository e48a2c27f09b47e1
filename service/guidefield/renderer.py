"""A process at the lowest priority that renders recordings from the logs of runs, the newest first.

Theory of operation. The service names runs; one thread here hands one after the other to the process, and looks after
it: it is started with the first run, and again when it dies. A log is deleted only once its recording is there, so that
the next start goes on, whatever ended when. A run that ends the process again and again is given up.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import threading
import time
from collections import Counter
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess

from guidefield import logs
from guidefield.errors import strip_path
from guidefield.pool.process import end_with_parent, limit_memory
from guidefield.stores.recordings import Recordings
from guidefield.system import become_idle, resident
from guidefield.worker import EngineSetup

LOOK_INTERVAL_S = 0.1
"""Time between two looks at the process while it renders [s]."""
RETRY_INTERVAL_S = 5.0
"""Pause after a disk has refused, or a process has died [s]."""
MAX_ATTEMPTS = 5
"""Number of processes that may die with one run before it is given up."""

Named = tuple[str, str]
"""A run by its owner and id."""

_log = logging.getLogger(__name__)
_spawn = multiprocessing.get_context("spawn")


class _DiedError(Exception):
    """The process has died."""


class Renderer:
    """Renders the recordings of the runs that it is told, the one told last first.

    Args:
        setup: Prepares the engines of the process.
        memory: The process is ended where it takes more [bytes].
        recordings: The recordings of a user.
        note: Is told of each run whose log was rendered or given up.
        patience: Time for which a run is left to the worker that answered it [s].
    """

    def __init__(
        self,
        setup: EngineSetup,
        memory: int,
        recordings: Callable[[str], Recordings],
        note: Callable[[str, str], None],
        patience: float = 0.0,
    ) -> None:
        self._setup, self._memory = setup, memory
        self._recordings, self._note, self._patience = recordings, note, patience
        self._waiting: list[Named] = []
        self._deaths = Counter[Named]()
        self._process: SpawnProcess | None = None
        self._line: Connection | None = None
        self._closed = threading.Event()
        self._added = threading.Semaphore(0)
        self._thread = threading.Thread(target=self._run, name="guidefield-renderer", daemon=True)

    def add(self, owner: str, run_id: str) -> None:
        """Have a recording rendered; returns at once."""
        self._waiting.append((owner, run_id))
        self._added.release()

    def start(self) -> None:
        """Begin to render."""
        self._thread.start()

    @property
    def memory(self) -> int:
        """Resident memory of its process [bytes]; 0 where there is none."""
        process = self._process
        return 0 if process is None or process.pid is None else resident(process.pid)

    def close(self) -> None:
        """End the process; logs that aren't rendered stay."""
        self._closed.set()
        self._added.release()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        while True:
            self._added.acquire()
            if self._closed.is_set():
                break
            named = self._waiting.pop()
            try:
                self._settle(named)
            except Exception:  # the thread must outlive it
                _log.exception("a recording could not be rendered")
        self._end_process()

    def _settle(self, named: Named) -> None:
        """Have a recording rendered, tried again later, or given up."""
        try:
            refusal = self._rendered(named) if self._is_left(named) else None
        except _DiedError as death:
            self._end_process()
            if self._closed.is_set():
                return
            self._deaths[named] += 1
            if self._deaths[named] < MAX_ATTEMPTS:
                self._postpone(named, f"{death}")
                return
            self._give_up(named, f"it can't be rendered: {death}, {MAX_ATTEMPTS} times")
        except MemoryError:
            self._end_process()
            self._give_up(named, f"rendering it takes more than {self._memory >> 20} MiB of memory")
        else:
            if refusal is not None:
                self._postpone(named, refusal)
                return
        self._deaths.pop(named, None)
        self._note(*named)

    def _is_left(self, named: Named) -> bool:
        """Return whether nobody else has rendered a recording."""
        recordings, until = self._recordings(named[0]), time.monotonic() + self._patience
        while recordings.is_owed(named[1]) and time.monotonic() < until and not self._closed.is_set():
            self._closed.wait(LOOK_INTERVAL_S)
        return recordings.is_owed(named[1])

    def _rendered(self, named: Named) -> str | None:
        """Have the process render a recording; why the disk refuses, if it does.

        Raises:
            _DiedError: if the process died meanwhile, or can't be started.
            MemoryError: if it took too much memory.
        """
        process, line = self._prepared()
        with contextlib.suppress(OSError, EOFError):
            line.send(named)
            while not line.poll(LOOK_INTERVAL_S):
                if self._closed.is_set():
                    raise _DiedError("the service has ended")
                if self.memory > self._memory:
                    raise MemoryError
            refusal: str | None = line.recv()
            return refusal
        process.join(LOOK_INTERVAL_S)
        raise _DiedError(f"the process that rendered it died with code {process.exitcode}")

    def _prepared(self) -> tuple[SpawnProcess, Connection]:
        """The process and the line to it, started where there is none."""
        if self._process is None or self._line is None or not self._process.is_alive():
            self._end_process()
            here, there = _spawn.Pipe()
            arguments = (there, self._setup, self._memory)
            process = _spawn.Process(target=_render, args=arguments, name="guidefield-renderer", daemon=True)
            process.start()
            there.close()
            self._process, self._line = process, here
        return self._process, self._line

    def _postpone(self, named: Named, why: str) -> None:
        """Try a recording again after all others."""
        _log.warning("the recording of run %s is tried again: %s", named[1], why)
        self._closed.wait(RETRY_INTERVAL_S)
        self._waiting.insert(0, named)
        self._added.release()

    def _give_up(self, named: Named, why: str) -> None:
        _log.error("the recording of run %s is lost: %s", named[1], why)
        self._recordings(named[0]).give_up(named[1], why)

    def _end_process(self) -> None:
        if self._line is not None:
            self._line.close()
        if self._process is not None:
            self._process.kill()
            self._process.join()
        self._process = self._line = None


def _render(line: Connection, setup: EngineSetup, memory: int) -> None:
    """Render what is asked for, in a process of its own; tells after each why the disk refuses, if it does."""
    end_with_parent()
    become_idle()
    limit_memory(memory)
    logs.configure(setup.log_level, json=setup.json_logs)
    engines = setup.engines()
    while True:
        try:
            owner, run_id = line.recv()
        except EOFError:
            return
        try:
            engines.render(owner, run_id)
        except OSError as error:
            line.send(strip_path(error))
        else:
            line.send(None)
