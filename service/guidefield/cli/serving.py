"""A service in this process until a signal ends it, or in a child process for as long as a block runs."""

from __future__ import annotations

import contextlib
import faulthandler
import logging
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType

from guidefield import logs
from guidefield.cli.loopback import LOOPBACK, free_port
from guidefield.endpoint.service import ServiceSettings, serve

WHERE = signal.SIGUSR1
"""A service that gets this signal writes to stderr where each of its threads stands, and goes on."""

ENDS_WITHIN = 60.0
"""How long a child service may take to end, longer than what it is given to finish its work [s]."""


def serve_until_signal(settings: ServiceSettings, announce: Callable[[str], None]) -> None:
    """Serve until SIGTERM or Ctrl-C asks for an orderly end; a second one ends the process at once."""
    logs.configure(logging.INFO, json=settings.json_logs)
    faulthandler.register(WHERE)
    stop = threading.Event()
    reading, writing = os.pipe()
    threading.Thread(target=_set_when_told, args=(stop, reading), name="guidefield-signal", daemon=True).start()

    def end(number: int, _frame: FrameType | None) -> None:
        os.write(writing, b"\0")  # takes no lock: the thread that is interrupted may hold that of the event
        signal.signal(number, signal.SIG_DFL)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    serve(settings, stop, announce)


def _set_when_told(event: threading.Event, reading: int) -> None:
    os.read(reading, 1)
    event.set()


@dataclass(frozen=True)
class ChildService:
    """A service in a child process: where to connect to, and the process that answers there."""

    endpoint: str
    process: subprocess.Popen[str]


@contextlib.contextmanager
def service_in_child(
    announce: Callable[[str], None], *, workers: int = 1, name: str = "local"
) -> Iterator[ChildService]:
    """A service of its own, in a child process on a free loopback port, with a data folder that goes with it.

    Args:
        announce: Is told what the service tells while it starts.
        workers: Its worker processes.
        name: Its instance's name.

    Yields:
        The service, ready for requests.

    Raises:
        RuntimeError: if it doesn't start; if it doesn't end when it is told to, and has to be killed.
    """
    endpoint = f"tcp/{LOOPBACK}:{free_port()}"
    serve_there = [sys.executable, "-m", "guidefield", "serve", "--listen", endpoint, "--workers", str(workers)]
    serve_there += ["--name", name]
    with (
        tempfile.TemporaryDirectory(prefix="guidefield-") as data,
        subprocess.Popen([*serve_there, "--data", data], stdout=subprocess.PIPE, text=True) as child,  # noqa: S603
    ):
        assert child.stdout is not None, "it is piped"
        try:
            _await_ready(child.stdout, announce)
            yield ChildService(endpoint, child)
        finally:
            _end(child)


def _end(child: subprocess.Popen[str]) -> None:
    child.terminate()
    try:
        child.wait(ENDS_WITHIN)
    except subprocess.TimeoutExpired:
        child.send_signal(WHERE)
        time.sleep(1.0)  # to write it
        child.kill()
        raise RuntimeError(f"the service did not end within {ENDS_WITHIN:g} s; its log says where it stood") from None


def _await_ready(lines: Iterator[str], announce: Callable[[str], None]) -> None:
    for line in lines:
        announce(line.strip())
        if line.startswith("ready"):
            return
    raise RuntimeError("the service ended before it was ready; its log is above")
