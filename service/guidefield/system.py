"""Memory and processor time of processes, and the lowest priority for this one, on Linux and macOS.

The pool ends workers that are too large by `resident`, and waits for the last ones by `processor_time`, until they have
used two seconds: hundredths of a second would do.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import time
from pathlib import Path

import psutil

_PROCESSOR_TIME = 2  # CPUCLOCK_SCHED of <linux/posix-timers.h>


def resident(pid: int) -> int:
    """Return the resident memory of a process [bytes]; 0 once it has ended.

    On Linux without psutil, which reads the process's begin each time: a reply with memory took twice as long.
    """
    if psutil.LINUX:
        try:
            return int(Path(f"/proc/{pid}/statm").read_bytes().split()[1]) * mmap.PAGESIZE
        except OSError:
            return 0
    return psutil_resident(pid)


def psutil_resident(pid: int) -> int:
    """Return the resident memory of a process by psutil [bytes]."""
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.Error:
        return 0


def processor_time(pid: int) -> float:
    """Return the processor time of a process [s]; 0 once it has ended.

    Precise to a nanosecond on Linux; elsewhere as psutil, a microsecond on macOS.
    """
    if psutil.LINUX:
        try:
            return time.clock_gettime(~pid << 3 | _PROCESSOR_TIME)
        except OSError:
            return 0.0
    return psutil_processor_time(pid)


def psutil_processor_time(pid: int) -> float:
    """Return the processor time of a process by psutil [s]: on Linux in hundredths of a second."""
    try:
        spent = psutil.Process(pid).cpu_times()
    except psutil.Error:
        return 0.0
    return float(spent.user + spent.system)


def become_idle() -> None:
    """Let this process, and threads that it starts from now on, run only on idle processors."""
    if hasattr(os, "SCHED_IDLE"):
        with contextlib.suppress(OSError):  # a container may forbid it
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    os.nice(19)
