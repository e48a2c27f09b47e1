"""Follow clients' liveliness tokens, and report a client that is gone, whose requests and streams end then."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable

import zenoh

from guidefield.errors import MalformedRequest
from guidefield.messages.identities import USERS, Asker, split_user

GRACE = 6.0
"""Time after which a client whose token vanished is gone [s]; it notices a cut link in 2 s, and reconnects in 3 s."""


class Clients:
    """Follows the liveliness tokens of clients; calls `gone` with each client that is gone, in a thread of its own."""

    def __init__(self, session: zenoh.Session, instance: str, gone: Callable[[Asker], object]) -> None:
        self._gone = gone
        self._left: OrderedDict[Asker, float] = OrderedDict()
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._tell_gone, name="guidefield-clients", daemon=True)
        self._thread.start()
        keys = (f"guidefield/{instance}/clients/*", f"guidefield/{instance}/{USERS}/*/clients/*")
        self._tokens = [session.liveliness().declare_subscriber(key, self._heard) for key in keys]

    def close(self) -> None:
        """Stop."""
        for tokens in self._tokens:
            tokens.undeclare()
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _heard(self, token: zenoh.Sample) -> None:
        try:
            user, key = split_user(str(token.key_expr).split("/")[2:])
        except MalformedRequest:  # an invalid user, who can't ask either
            return
        client = Asker(user, key[-1])
        with self._changed:
            self._left.pop(client, None)
            if token.kind == zenoh.SampleKind.DELETE:
                self._left[client] = time.monotonic()
                self._changed.notify()

    def _tell_gone(self) -> None:
        while True:
            with self._changed:
                while not self._closed:
                    rest = next(iter(self._left.values())) + GRACE - time.monotonic() if self._left else None
                    if rest is not None and rest <= 0.0:
                        break
                    self._changed.wait(rest)
                if self._closed:
                    return
                client, _ = self._left.popitem(last=False)
            self._gone(client)
