"""A process of the service on its operating system: log lines, memory, processor time, and the lowest priority.

The pool ends workers that are too large by `resident`, and waits for the last ones by `processor_time`, until they have
used two seconds: hundredths of a second would do. Log lines are for a person, or one JSON object each, whose fields
operators' programs read (docs/service.md). If standard error is the system's journal, which records time and process of
each line, lines begin with their level as the journal reads it (sd-daemon(3)).
"""

from __future__ import annotations

import contextlib
import json as json_text
import logging
import mmap
import os
import sys
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


PLAIN = "%(asctime)s %(levelname)s %(process)d %(name)s: %(message)s"
IN_JOURNAL = "%(levelname)s %(name)s: %(message)s"  # without time and process, which the journal adds


class JsonLines(logging.Formatter):
    """One JSON object a line: time [s since 1970], level, process, logger, message, and the trace of an exception."""

    def format(self, record: logging.LogRecord) -> str:
        """Format a record as a line."""
        line = {
            "time": record.created,
            "level": record.levelname,
            "process": record.process,
            "logger": record.name,
            "message": record.getMessage(),
        }
        if record.exc_info:
            line["trace"] = self.formatException(record.exc_info)
        return json_text.dumps(line, ensure_ascii=False)


class Journal(logging.Formatter):
    """Lines for the system's journal, each with its level in front; all lines of an exception's trace, too."""

    def __init__(self, lines: logging.Formatter) -> None:
        super().__init__()
        self._lines = lines

    def format(self, record: logging.LogRecord) -> str:
        """Format a record as lines."""
        level = _syslog_level(record.levelno)
        return "\n".join(f"<{level}>{line}" for line in self._lines.format(record).splitlines())


def _syslog_level(level: int) -> int:
    """Return syslog's number of a level: 7 is debug, 6 informational, 4 warning, 3 error, 2 critical."""
    return next((number for least, number in ((50, 2), (40, 3), (30, 4), (20, 6)) if level >= least), 7)


def is_journal(descriptor: int, journal_stream: str) -> bool:
    """Return whether an open file is the journal's input.

    Args:
        descriptor: Descriptor of the file.
        journal_stream: The variable JOURNAL_STREAM of the environment: the input's device and inode, as "8:1234".
    """
    try:
        file = os.fstat(descriptor)
    except OSError:
        return False
    return journal_stream == f"{file.st_dev}:{file.st_ino}"


def configure_logging(level: int, *, json: bool) -> None:
    """Log messages from a level on to stderr."""
    handler = logging.StreamHandler()
    journal = is_journal(sys.__stderr__.fileno(), os.environ.get("JOURNAL_STREAM", "")) if sys.__stderr__ else False
    lines = JsonLines() if json else logging.Formatter(IN_JOURNAL if journal else PLAIN)
    handler.setFormatter(Journal(lines) if journal else lines)
    logging.basicConfig(level=level, handlers=[handler])
