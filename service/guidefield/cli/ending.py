"""A process that a signal tells to end: it hears of it whichever thread takes the signal, and ends in bounded time.

Theory of operation. The system may hand a signal to any thread; Python's handlers run in the main thread, which nothing
wakes where a thread of Zenoh took it, so that a service that waits would never hear of it. What runs in the thread that
took it is the interpreter's own handler, which writes the signal's number into a pipe (`signal.set_wakeup_fd`): a
thread that does nothing else reads it there. Should the process not be gone in time, the same thread ends it by force.
Should that thread be stuck as well, because another one keeps the interpreter's lock or nobody reads the log, the
system's alarm ends it: nothing of ours has to run for that. Workers end with their parent (`pool.process`).
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
"""Exit code of a process that had to be ended by force."""
DUMP_TIME_S = 5.0
"""How long a process that is ended by force may take to say where it stood; then the system's alarm ends it [s]."""

_log = logging.getLogger(__name__)


def end_on_signal(stop: threading.Event, within: float) -> None:
    """Have SIGTERM and Ctrl-C set an event; a second one, or the end of a time, ends the process whatever it does.

    To be called once, in the main thread.

    Args:
        stop: Set by the first signal; the process is to end by itself then.
        within: How long it may take for that [s]; one that is stuck beyond help lasts `DUMP_TIME_S` longer.
    """
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # whoever started us may have had it ignored
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _ignore_signal)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=_await_end, args=(reading, stop, within), name="guidefield-signal", daemon=True).start()


def leave() -> NoReturn:
    """End the process with code 0 now that all is done, and without the interpreter's own end.

    A thread of Zenoh that still waits to call Python would abort the process there, after an orderly end.
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
