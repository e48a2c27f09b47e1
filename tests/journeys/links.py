"""A link between clients and a service that can be cut, or is slow."""

import contextlib
import socket
import threading
import time
from collections.abc import Iterable

STEP_S = 0.05  # time between two portions over a slow link [s]


class Link:
    """Carries bytes between clients and a service, until it is cut; new connections are taken again at once.

    Args:
        endpoint: Where the service listens.
        rate: What a client gets of the service in a second [bytes]; 0: all at once.
    """

    def __init__(self, endpoint: str, rate: int = 0) -> None:
        host, port = endpoint.removeprefix("tcp/").rsplit(":", 1)
        self._service, self._rate = (host, int(port)), rate
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
                if self._rate:
                    far.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self._rate // 4)
                self._ends += [near, far]
                for one, other, rate in ((near, far, 0), (far, near, self._rate)):
                    threading.Thread(target=_carry, args=(one, other, rate), daemon=True).start()


def _carry(one: socket.socket, other: socket.socket, rate: int) -> None:
    with contextlib.suppress(OSError):
        while data := one.recv(int(rate * STEP_S) or 1 << 16):
            other.sendall(data)
            if rate:
                time.sleep(STEP_S)
    _end((one, other))


def _end(ends: Iterable[socket.socket]) -> None:
    for end in ends:
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
