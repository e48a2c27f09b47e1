"""Run a service in this process until a signal, or in a child process for as long as a block runs."""

from __future__ import annotations

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

from guidefield import logs
from guidefield.cli.ending import FORCED_EXIT_CODE, end_on_signal
from guidefield.cli.loopback import LOOPBACK, free_port
from guidefield.endpoint.service import ServiceSettings, serve
from guidefield.errors import MalformedRequest
from guidefield.messages import codec
from guidefield.messages.quotas import Quotas

TRACE_SIGNAL = signal.SIGUSR1
"""On this signal a service writes the traces of all threads to stderr, and continues."""

END_TIME_S = 30.0
"""Time of a service to end after its work is finished, before it is ended by force [s]."""

CHILD_END_TIME_S = 60.0
"""Time of a child service to end, longer than that of a service that is ended by force [s]."""


def serve_until_signal(settings: ServiceSettings, announce: Callable[[str], None]) -> None:
    """Serve until SIGTERM or Ctrl-C asks for an orderly end; a second one ends the process at once.

    After a signal the process ends, at the latest after `settings.grace` and `END_TIME_S` by force, with the code
    `ending.FORCED_EXIT_CODE`, and its workers with it.

    Args:
        settings: Settings of the service.
        announce: Takes sentences about start and end, unless standard output would block.
    """
    logs.configure(logging.INFO, json=settings.json_logs)
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
    """Run a service in a child process on a free loopback port.

    Args:
        announce: Takes the service's messages during its start.
        workers: Number of its worker processes.
        name: Its instance's name.
        options: Further options of `guidefield serve`.
        within: Parent of its temporary data folder; None: the system's.
        data: A data folder that stays, instead.

    Yields:
        The service, ready for requests.

    Raises:
        RuntimeError: if it doesn't start; if it has to be ended by force.
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
        if line.startswith("ready"):
            return
    raise RuntimeError("the service ended before it was ready; its log is above")


READY, STOPPING = "ready", "stopping"
"""Beginnings of the sentences in which a service says that it takes requests, and that it ends."""


def notify_supervisor(sentence: str) -> None:
    """Send a sentence to the supervisor (`sd_notify`), if there is one, without blocking.

    Args:
        sentence: As `endpoint.service.serve` announces it.
    """
    where = os.environ.get("NOTIFY_SOCKET", "")
    if not where:
        return
    told = [f"STATUS={' '.join(sentence.split())}"]
    if sentence.startswith(READY):
        told.append("READY=1")
    if sentence.startswith(STOPPING):
        told.append("STOPPING=1")
    address = f"\0{where[1:]}" if where.startswith("@") else where
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.setblocking(False)
        try:
            sender.sendto("\n".join(told).encode(), address)
        except OSError:
            return  # it has ended, or doesn't read


def read_quotas(file: Path) -> Quotas:
    """Read quotas from a JSON file.

    Raises:
        MalformedRequest: if it holds none; names the place of the fault and the valid choices.
        OSError: if it can't be read.
    """
    try:
        quotas: Quotas = codec.decode(file.read_bytes(), Quotas)
    except MalformedRequest as error:
        raise MalformedRequest(f"{file}: {error.message}", **error.details) from None
    return quotas
