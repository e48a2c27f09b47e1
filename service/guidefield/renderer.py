"""A process at the lowest priority that renders recordings from the logs of runs, the newest first.

Theory of operation. The service names runs; one thread here hands one after the other to a pool of one worker process.
`rendering.py` deletes a log only once its recording is there, so a service that was killed continues at its next start.
A run that ends the process `MAX_ATTEMPTS` times is given up, for want of memory at once.
"""

from __future__ import annotations

import gc
import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import partial

from guidefield.engines import Engines, EngineSetup
from guidefield.errors import GuidefieldError, strip_path
from guidefield.pool.pool import Pool
from guidefield.pool.process import Call, Work
from guidefield.pool.waiting import Answer, Task
from guidefield.stores.recordings import Recordings
from guidefield.system import become_idle, configure_logging

POLL_INTERVAL_S = 0.1  # time between two checks whether a worker has rendered a recording that is left to it [s]
RETRY_INTERVAL_S = 5.0  # pause after a disk has refused, or a process has died [s]
MAX_ATTEMPTS = 5  # number of processes that may die with one run before it is given up
Named = tuple[str, str]  # a run by its owner and id

_log = logging.getLogger(__name__)


class Renderer:
    """Renders the recordings of runs, the run that was added last first.

    Args:
        setup: Prepares the engines of the process.
        memory: The process is ended where it takes more [bytes].
        recordings: Finds a user's recordings.
        note: Called with each run whose log was rendered or given up.
        patience: Time for which a run is left to the worker that answered it, if workers render their own [s].
    """

    def __init__(
        self,
        setup: EngineSetup,
        memory: int,
        recordings: Callable[[str], Recordings],
        note: Callable[[str, str], None],
        patience: float = 0.0,
    ) -> None:
        self._pool = Pool(partial(_prepare, setup), workers=1, memory=memory)
        self._recordings, self._note, self._patience, self._memory = recordings, note, patience, memory
        self._waiting: list[Named] = []
        self._deaths = Counter[Named]()
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
        return self._pool.memory

    def close(self) -> None:
        """End the process; logs that aren't rendered stay."""
        self._closed.set()
        self._added.release()
        self._pool.close(0.0)
        self._pool.outbox.close(0.0)
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        while self._added.acquire() and not self._closed.is_set():
            self._pool.start()  # with the first run
            named = self._waiting.pop()
            try:
                self._settle(named)
            except Exception:  # the thread must outlive it
                _log.exception("a recording could not be rendered")

    def _settle(self, named: Named) -> None:
        try:
            is_waiting = self._wait_for_worker(named)
            done, refusal = self._pool.submit(Task(named, math.inf)).result() if is_waiting else (True, b"")
        except GuidefieldError as death:
            if self._closed.is_set():
                return
            self._deaths[named] += 1
            cause = death.message.partition(";")[0]
            if "mebibytes" in death.details or "MemoryError" in cause:  # as `pool/pool.py` and `process.py` say
                self._give_up(named, f"rendering it takes more than {self._memory >> 20} MiB of memory")
            elif self._deaths[named] < MAX_ATTEMPTS:
                self._postpone(named, cause)
                return
            else:
                self._give_up(named, f"it can't be rendered: {cause}, {MAX_ATTEMPTS} times")
        else:
            if not done:
                self._postpone(named, refusal.decode())
                return
        self._deaths.pop(named, None)
        self._note(*named)

    def _wait_for_worker(self, named: Named) -> bool:
        """Wait until a worker has rendered a run, at most for `patience`; return whether it still has to be."""
        recordings, until = self._recordings(named[0]), time.monotonic() + self._patience
        while recordings.is_owed(named[1]) and time.monotonic() < until and not self._closed.is_set():
            self._closed.wait(POLL_INTERVAL_S)
        return recordings.is_owed(named[1])

    def _postpone(self, named: Named, why: str) -> None:
        _log.warning("the recording of run %s is tried again: %s", named[1], why)
        self._closed.wait(RETRY_INTERVAL_S)
        self._waiting.insert(0, named)
        self._added.release()

    def _give_up(self, named: Named, why: str) -> None:
        _log.error("the recording of run %s is lost: %s", named[1], why)
        self._recordings(named[0]).give_up(named[1], why)


def _prepare(setup: EngineSetup) -> Work:
    become_idle()
    configure_logging(setup.log_level, json=setup.json_logs)
    return partial(_render, setup.engines())


def _render(engines: Engines, named: Named, _call: Call) -> Answer:
    try:
        engines.render(*named)
    except OSError as error:
        return False, strip_path(error).encode()
    if not gc.get_freeze_count():  # what the first one loaded stays: to look through it takes 0.2 s each time
        gc.freeze()
    return True, b""
