"""Run a service in this process until a signal, which ends it in bounded time, or in a child process.

`guidefield serve` does the first; the demonstration, tests and benchmarks the second. A supervisor such as systemd is
notified, too.
"""

from __future__ import annotations

import atexit
import contextlib
import faulthandler
import logging
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType
from typing import NoReturn

from guidefield.endpoint.link import LOOPBACK
from guidefield.endpoint.service import ServiceSettings, serve
from guidefield.errors import MalformedRequest
from guidefield.messages import codec
from guidefield.messages.identities import Quotas
from guidefield.system import configure_logging

FORCED_EXIT_CODE = os.EX_SOFTWARE  # exit code of a process that was ended by force: 70 in docs/service.md
DUMP_TIME_S = 5.0
"""Time to dump the traces of all threads before the system's alarm ends the process [s].

With `END_TIME_S` and `DEFAULT_GRACE` of `endpoint/service.py` it is 45 s, as docs/service.md says, below the 50 s after
which `tools/deploy/guidefield.service` and containers (docs/operation.md) kill the process.
"""

_log = logging.getLogger(__name__)


def end_on_signal(stop: threading.Event, within: float) -> None:
    """Make SIGTERM and Ctrl-C set an event; a second signal, or a timeout [s], ends the process by force.

    To be called once, in the main thread. The system may deliver a signal to a thread of Zenoh, while Python's
    handlers run in the main thread, which sleeps on. So the interpreter's own handler writes the signal's number into
    a pipe (`signal.set_wakeup_fd`), which a thread of its own reads. If that is stuck too, because another one holds
    the interpreter's lock or nobody reads the log, the system's alarm ends the process `DUMP_TIME_S` later. Workers end
    with their parent (`pool.process`).
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
        os._exit(128 + os.read(reading, 1)[0])  # as a shell reports a process that a signal ended
    _log.error("not ended %g s after it was told to, and ended by force; where its threads stood:", within)
    faulthandler.dump_traceback()
    os._exit(FORCED_EXIT_CODE)


@contextlib.contextmanager
def free_port() -> Iterator[int]:
    """Reserve a free port while a block runs; servers with ``SO_REUSEADDR`` can listen there."""
    with socket.socket() as held:
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind((LOOPBACK, 0))
        yield held.getsockname()[1]


TRACE_SIGNAL = signal.SIGUSR1  # on this signal a service writes the traces of all threads to stderr, and continues
END_TIME_S = 30.0  # time of a service to end after its work is finished, before it is ended by force [s]
"""It is part of what `DUMP_TIME_S` tells, and not below the times of `pool/pool.py`."""
CHILD_END_TIME_S = 60.0
"""Time of a child service to end before it is killed [s].

It must be longer than the time in which a service ends itself by force, which writes where its threads stood.
"""


def serve_until_signal(settings: ServiceSettings, announce: Callable[[str], None]) -> None:
    """Serve until SIGTERM or Ctrl-C asks for an orderly end; a second one ends the process at once.

    After a signal the process ends, at the latest after `settings.grace` and `END_TIME_S` by force, with the code
    `FORCED_EXIT_CODE`, and its workers with it. Sentences about start and end are announced unless standard output
    would block.
    """
    configure_logging(logging.INFO, json=settings.json_logs)
    faulthandler.register(TRACE_SIGNAL)
    stop = threading.Event()
    end_on_signal(stop, settings.grace + END_TIME_S)
    serve(settings, stop, partial(_announce, announce))


def _announce(announce: Callable[[str], None], sentence: str) -> None:
    """Announce a sentence unless standard output would block; notify the supervisor, too."""
    notify_supervisor(sentence)
    output = select.poll()
    output.register(sys.stdout, select.POLLOUT)
    if output.poll(0) == [(sys.stdout.fileno(), select.POLLOUT)]:
        announce(sentence)


@dataclass(frozen=True)
class ChildService:
    """A service in a child process: its endpoint, and the process."""

    endpoint: str
    process: subprocess.Popen[str]


@contextlib.contextmanager
def service_in_child(
    announce: Callable[[str], None],
    *,
    workers: int = 1,
    name: str = "local",
    options: Sequence[str] = (),
    within: Path | None = None,
    data: Path | None = None,
) -> Iterator[ChildService]:
    """Run a service with options of `guidefield serve` in a child process on a free loopback port.

    Its data folder is a temporary one within another, unless one is named. Raises RuntimeError if the service doesn't
    start, or has to be ended by force.
    """
    serve_there = [sys.executable, "-m", "guidefield", "serve", "--workers", str(workers), "--name", name, *options]
    with (
        free_port() as port,
        tempfile.TemporaryDirectory(prefix="guidefield-", dir=within) as made,
        subprocess.Popen(  # noqa: S603 - ourselves
            [*serve_there, "--data", data or made, "--listen", f"tcp/{LOOPBACK}:{port}"],
            stdout=subprocess.PIPE,
            text=True,
        ) as child,
    ):
        assert child.stdout is not None, "it is piped"
        try:
            _await_ready(child.stdout, announce)
            yield ChildService(f"tcp/{LOOPBACK}:{port}", child)
        finally:
            _end_child(child)


def _end_child(child: subprocess.Popen[str]) -> None:
    child.terminate()
    try:
        forced = child.wait(CHILD_END_TIME_S) == FORCED_EXIT_CODE
    except subprocess.TimeoutExpired:
        child.kill()
        forced = True
    if forced:
        raise RuntimeError("the service did not end when it was told to; its log says where it stood")


def _await_ready(lines: Iterator[str], announce: Callable[[str], None]) -> None:
    for line in lines:
        announce(line.strip())
        if line.startswith(READY):
            return
    raise RuntimeError("the service ended before it was ready; its log is above")


READY, STOPPING = "ready", "stopping"
"""Beginnings of the sentences in which `endpoint/service.py` announces that it takes requests, and that it ends."""


def notify_supervisor(sentence: str) -> None:
    """Send a sentence of the service to the supervisor (`sd_notify`), if there is one, without blocking."""
    where = os.environ.get("NOTIFY_SOCKET", "")
    if not where:
        return
    lines = [f"STATUS={' '.join(sentence.split())}"]
    if sentence.startswith(READY):
        lines.append("READY=1")
    if sentence.startswith(STOPPING):
        lines.append("STOPPING=1")
    address = f"\0{where[1:]}" if where.startswith("@") else where
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.setblocking(False)
        try:
            sender.sendto("\n".join(lines).encode(), address)
        except OSError:
            return  # it has ended, or doesn't read


def read_quotas(file: Path) -> Quotas:
    """Read quotas from a JSON file; raises MalformedRequest with the place of the fault if it holds none."""
    try:
        quotas: Quotas = codec.decode(file.read_bytes(), Quotas)
    except MalformedRequest as error:
        raise MalformedRequest(f"{file}: {error.message}", **error.details) from None
    return quotas
