"""Track the living instances of the service, and find the least busy one."""

from __future__ import annotations

import random
import threading
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import msgspec
import zenoh

from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN, base_key
from guidefield.messages.replies import InfoReply


@dataclass(frozen=True)
class _Load:
    workers: int
    others: int


class Loads:
    """The load of each instance; thread-safe."""

    def __init__(self) -> None:
        self._own = Counter[str]()
        self._reported: dict[str, _Load] = {}
        self._lock = threading.Lock()

    def begin(self, instance: str) -> None:
        """Count a question of this client to an instance."""
        with self._lock:
            self._own[instance] += 1

    def end(self, instance: str) -> None:
        """Count the end of a question."""
        with self._lock:
            self._own[instance] -= 1

    def report(self, instance: str, workers: int, work: int) -> None:
        """Take an instance's report: its number of workers, and its queries, running and waiting."""
        with self._lock:
            self._reported[instance] = _Load(max(workers, 1), max(0, work - self._own[instance]))

    def forget(self, instance: str) -> None:
        """Remove an instance; if it returns, its load counts as zero."""
        with self._lock:
            self._reported.pop(instance, None)

    def least(self, instances: Iterable[str], preferred: str | None) -> str | None:
        """Return the instance with the least load per worker; among equals the preferred one."""
        with self._lock:
            shares = {name: self._share(name) for name in sorted(instances)}
        return min(shares, key=lambda name: (shares[name], name != preferred), default=None)

    def _share(self, instance: str) -> float:
        reported = self._reported.get(instance, _Load(1, 0))
        return (self._own[instance] + reported.others) / reported.workers


REFRESHED_EVERY = 0.5
"""Largest age of a report about other clients' questions [s]; this client's own are counted at once."""
ASK_WITHIN = 1.0  # time that an instance has to report its load [s]


class Instances:
    """Follows the liveliness tokens of all instances."""

    def __init__(self, session: zenoh.Session, user: str = PLAIN) -> None:
        self._session = session
        self._briefly = f"{base_key('*', user)}/info?brief"
        self.loads = Loads()
        self._living: set[str] = set()
        self._departures: Counter[str] = Counter()
        self._refreshed = -REFRESHED_EVERY
        self._changed = threading.Condition()
        self._tokens = session.liveliness().declare_subscriber("guidefield/*/alive", self._heard, history=True)

    def refresh(self) -> None:
        """Request reports of all instances unless that was done just now; don't wait for them."""
        with self._changed:
            now = time.monotonic()
            if len(self._living) < 2 or now - self._refreshed < REFRESHED_EVERY:
                return
            self._refreshed = now
        self._session.get(
            self._briefly,
            zenoh.handlers.Callback(self._take_report, indirect=False),
            encoding=Encoding.MSGPACK.value,
            timeout=ASK_WITHIN,
        )

    def _take_report(self, reply: zenoh.Reply) -> InfoReply | None:
        """Read the info of an instance; None if it doesn't answer."""
        if reply.ok is None:
            return None
        info = msgspec.msgpack.decode(reply.ok.payload.to_bytes(), type=InfoReply)
        self.loads.report(_instance(reply.ok.key_expr), info.workers, info.busy + info.queue)
        return info

    def close(self) -> None:
        """Unsubscribe."""
        self._tokens.undeclare()

    def living(self) -> set[str]:
        """Return the names of the living instances."""
        with self._changed:
            return set(self._living)

    def departures(self, name: str) -> int:
        """Return how often an instance ended, or the link to it was cut."""
        with self._changed:
            return self._departures[name]

    def freest(self, but: frozenset[str], wait: float) -> str | None:
        """Return the living instance with the least load per worker; any among equals."""
        with self._changed:
            self._changed.wait_for(lambda: self._living - but, wait)
            candidates = self._living - but
        if len(candidates) < 2:
            return next(iter(candidates), None)
        loads = {name: load for name, load in self._loads().items() if name in candidates}
        if not loads:
            return random.choice(sorted(candidates))  # noqa: S311 - no secret
        least = min(loads.values())
        return random.choice(sorted(name for name, load in loads.items() if load == least))  # noqa: S311 - no secret

    def returns(self, name: str, wait: float) -> bool:
        """Return whether an instance lives, or lives again within a time [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: name in self._living, wait)

    def starting(self) -> dict[str, str]:
        """Return the present work of starting instances by name."""
        return {name: info.health.doing for name, info in self._infos().items() if info.health.state == "starting"}

    def _loads(self) -> dict[str, float]:
        return {name: (info.busy + info.queue) / max(info.workers, 1) for name, info in self._infos().items()}

    def _infos(self) -> dict[str, InfoReply]:
        infos = {}
        encoding = Encoding.MSGPACK.value
        for reply in self._session.get(self._briefly, encoding=encoding, timeout=ASK_WITHIN):
            if (report := self._take_report(reply)) is not None:
                infos[_instance(reply.ok.key_expr)] = report
        return infos

    def _heard(self, token: zenoh.Sample) -> None:
        with self._changed:
            if token.kind == zenoh.SampleKind.PUT:
                self._living.add(_instance(token.key_expr))
            else:
                self._living.discard(_instance(token.key_expr))
                self._departures[_instance(token.key_expr)] += 1
                self.loads.forget(_instance(token.key_expr))
            self._changed.notify_all()


def _instance(key: zenoh.KeyExpr) -> str:
    return str(key).split("/")[1]
