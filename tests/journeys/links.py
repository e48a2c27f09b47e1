"""A link between clients and a service that can be cut."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterable


class Link:
    """Carries bytes between clients and a service, until it is cut; new connections are taken again at once."""

    def __init__(self, endpoint: str) -> None:
        host, port = endpoint.removeprefix("tcp/").rsplit(":", 1)
        self._service = host, int(port)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self._ends: list[socket.socket] = []
        self.cuts = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> bool:
        """End every connection; return whether there was one."""
        ends, self._ends = self._ends, []
        _end(ends)
        self.cuts += bool(ends)
        return bool(ends)

    def close(self) -> None:
        """Take no more connections, and end those there are."""
        self._listener.close()
        ends, self._ends = self._ends, []
        _end(ends)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.create_connection(self._service)
                self._ends += [near, far]
                for one, other in ((near, far), (far, near)):
                    threading.Thread(target=_carry, args=(one, other), daemon=True).start()


def _carry(one: socket.socket, other: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := one.recv(1 << 16):
            other.sendall(data)
    _end((one, other))


def _end(ends: Iterable[socket.socket]) -> None:
    for end in ends:
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
