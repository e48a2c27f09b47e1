"""End a process on a signal, in any thread and in bounded time.

Theory of operation. The system may deliver a signal to any thread. Python's handlers run in the main thread, which
stays asleep if a thread of Zenoh got the signal, so that a waiting service would never notice it. The interpreter's own
handler runs in the thread that got the signal and writes the signal's number into a pipe (`signal.set_wakeup_fd`); a
thread of its own reads it there. If the process doesn't end in time, the same thread ends it by force. If that thread
is stuck as well, because another one holds the interpreter's lock or nobody reads the log, the system's alarm ends the
process without any code of ours. Workers end with their parent (`pool.process`).
"""

from __future__ import annotations

import atexit
import contextlib
import faulthandler
import logging
import os
import select
import signal
import sys
import threading
from types import FrameType
from typing import NoReturn

FORCED_EXIT_CODE = os.EX_SOFTWARE
"""Exit code of a process that was ended by force."""
DUMP_TIME_S = 5.0
"""Time to dump the traces of all threads before the system's alarm ends the process [s]."""

_log = logging.getLogger(__name__)


def end_on_signal(stop: threading.Event, within: float) -> None:
    """Make SIGTERM and Ctrl-C set an event; a second signal, or a timeout, ends the process by force.

    To be called once, in the main thread.

    Args:
        stop: Set by the first signal; the process should then end by itself.
        within: Time for that [s]; a process that can't even dump its traces lasts `DUMP_TIME_S` longer.
    """
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # the parent process may have ignored it
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _ignore_signal)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=_await_end, args=(reading, stop, within), name="guidefield-signal", daemon=True).start()


def leave() -> NoReturn:
    """End the process with code 0 without the interpreter's finalization.

    A thread of Zenoh that still waits to call Python would abort the process during finalization.
    """
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # nobody reads it any more
            stream.flush()
    os._exit(0)


def _ignore_signal(_number: int, _frame: FrameType | None) -> None:
    pass


def _await_end(reading: int, stop: threading.Event, within: float) -> None:
    os.read(reading, 1)
    signal.setitimer(signal.ITIMER_REAL, within + DUMP_TIME_S)
    stop.set()
    if select.select([reading], [], [], within)[0]:
        os._exit(128 + os.read(reading, 1)[0])  # as a shell tells of a process that a signal ended
    _log.error("not ended %g s after it was told to, and ended by force; where its threads stood:", within)
    faulthandler.dump_traceback()
    os._exit(FORCED_EXIT_CODE)
