"""This machine's own address, and a free port there."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator

LOOPBACK = "127.0.0.1"


@contextlib.contextmanager
def free_port() -> Iterator[int]:
    """A port of this machine that nobody listens on, and that nobody else is given while a block runs.

    Whoever binds to it with ``SO_REUSEADDR``, as servers do, can listen there.
    """
    with socket.socket() as held:
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind((LOOPBACK, 0))
        yield held.getsockname()[1]
