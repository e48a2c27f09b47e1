"""A service in this process until a signal ends it, or in a child process for as long as a block runs."""

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
"""A service that gets this signal writes to stderr where each of its threads stands, and goes on."""

END_TIME_S = 30.0
"""How long a service may take to end, beyond what it is given to finish its work; then it is ended by force [s]."""

CHILD_END_TIME_S = 60.0
"""How long a child service may take to end, longer than one takes that has to be ended by force [s]."""


def serve_until_signal(settings: ServiceSettings, announce: Callable[[str], None]) -> None:
    """Serve until SIGTERM or Ctrl-C asks for an orderly end; a second one ends the process at once.

    Once it is told to, the process ends: after `settings.grace` and `END_TIME_S` by force, with the code
    `ending.FORCED_EXIT_CODE`, and its workers with it.

    Args:
        settings: How to serve.
        announce: Is told how the start and the end go, unless standard output takes nothing more.
    """
    logs.configure(logging.INFO, json=settings.json_logs)
    faulthandler.register(TRACE_SIGNAL)
    stop = threading.Event()
    end_on_signal(stop, settings.grace + END_TIME_S)
    serve(settings, stop, partial(_announce, announce))


def _announce(announce: Callable[[str], None], sentence: str) -> None:
    """Announce a sentence, unless that would wait for whoever is to read standard output; tell the supervisor, too."""
    notify_supervisor(sentence)
    output = select.poll()
    output.register(sys.stdout, select.POLLOUT)
    if output.poll(0) == [(sys.stdout.fileno(), select.POLLOUT)]:
        announce(sentence)


@dataclass(frozen=True)
class ChildService:
    """A service in a child process: where to connect to, and the process that answers there."""

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
    """A service of its own, in a child process on a free loopback port.

    Args:
        announce: Is told what the service tells while it starts.
        workers: Its worker processes.
        name: Its instance's name.
        options: More of `guidefield serve`.
        within: Where its data folder is made, which goes with it; None: where temporary ones are.
        data: Its data folder in place of that; it stays.

    Yields:
        The service, ready for requests.

    Raises:
        RuntimeError: if it doesn't start; if it doesn't end when it is told to, and has to be ended by force.
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
"""How the sentences begin by which a service says that it takes requests, and that it ends."""


def notify_supervisor(sentence: str) -> None:
    """Tell a sentence, if there is anybody to be told; a supervisor that doesn't listen keeps nobody waiting.

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
            return  # it has gone, or reads nothing; the service is none the worse


def read_quotas(file: Path) -> Quotas:
    """The quotas that a JSON file holds.

    Raises:
        MalformedRequest: if it holds none; says where it is wrong and what would be right.
        OSError: if it can't be read.
    """
    try:
        quotas: Quotas = codec.decode(file.read_bytes(), Quotas)
    except MalformedRequest as error:
        raise MalformedRequest(f"{file}: {error.message}", **error.details) from None
    return quotas
