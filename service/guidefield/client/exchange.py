"""Send questions to instances of the service, and return exactly one answer to each.

Theory of operation. A question goes to one instance at a time. A question with work goes to the least busy instance
that has the stored things it names; any other goes to the instance that was the least busy when the client connected.
Zenoh signals the end of the replies: without a reply the instance is gone. If the client named no instance, the
question then goes to another one, as it does if an instance is too busy. If there is no other one, and the link was
cut only for a moment, the question goes to the same instance again. A plan has its run's name, so that the running or
finished run answers. This repeats within the question's time, as long as some instance is back within
`RETURN_TIME_S`. A question is never at two instances at once, so that it has never a second answer.
"""

from __future__ import annotations

import contextlib
import random
import threading
import time
import uuid
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, InvalidStateError, wait
from dataclasses import dataclass
from typing import Any, TypeVar

import msgspec
import zenoh

from guidefield.client.questions import Question, refusal
from guidefield.errors import GuidefieldError, MalformedRequest, NoService, QuotaExceeded, ServerBusy
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN, base_key, shared_key
from guidefield.messages.replies import InfoReply, Progress
from guidefield.messages.scene_changes import SceneChanged


@dataclass(frozen=True)
class _Load:
    workers: int
    others: int  # number of other clients' questions


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


MAX_REPORT_AGE_S = 0.5
"""Largest age of a report about other clients' questions [s]; this client's own are counted at once."""
REPORT_TIMEOUT_S = 1.0  # time that an instance has to report its load [s]


class Instances:
    """Follows the liveliness tokens of all instances."""

    def __init__(self, session: zenoh.Session, user: str = PLAIN) -> None:
        self._session = session
        self._briefly = f"{base_key('*', user)}/info?brief"
        self.loads = Loads()
        self._living: set[str] = set()
        self._departures: Counter[str] = Counter()
        self._refreshed = -MAX_REPORT_AGE_S
        self._changed = threading.Condition()
        self._tokens = session.liveliness().declare_subscriber("guidefield/*/alive", self._heard, history=True)

    def refresh(self) -> None:
        """Request reports of all instances unless that was done just now; don't wait for them."""
        with self._changed:
            now = time.monotonic()
            if len(self._living) < 2 or now - self._refreshed < MAX_REPORT_AGE_S:
                return
            self._refreshed = now
        self._session.get(
            self._briefly,
            zenoh.handlers.Callback(self._take_report, indirect=False),
            encoding=Encoding.MSGPACK.value,
            timeout=REPORT_TIMEOUT_S,
        )

    def _take_report(self, reply: zenoh.Reply) -> InfoReply | None:
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
        """Return the living instance, `but` some, with the least load per worker; any among equals."""
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
        for reply in self._session.get(self._briefly, encoding=encoding, timeout=REPORT_TIMEOUT_S):
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


RETURN_TIME_S = 3.0  # time to wait for another instance when the present one is gone [s]
MAX_RETURNS = 5  # further attempts at an instance that is alive and silent: then the client has no right to an answer
RETRY_PAUSE_S = 0.1
"""Pause before the next attempt, doubled each time, since Zenoh may not know yet that the instance is gone [s]."""
SIGNAL_PERIOD_S = 0.2  # period at which a waiting caller handles signals [s]
THREAD_NAME = "guidefield-ask"  # name of the threads that ask another instance
MAX_REMEMBERED_RUNS = 1_000  # of runs, requests and streams that are over: instances of older ones are forgotten

_M = TypeVar("_M", Progress, SceneChanged)


class Exchange:
    """Asks the instances of a session.

    Args:
        session: An open session; closed with this.
        instance: The only instance to ask; None takes the freest, and another one when that is gone.
        user: The user whose keys are queried.
    """

    def __init__(self, session: zenoh.Session, instance: str | None, user: str = PLAIN) -> None:
        self.session = session
        self.user = user
        self.named = instance
        self.client = uuid.uuid4().hex
        self._instances = Instances(session, user)
        self._current = instance
        self._runs: OrderedDict[str, str] = OrderedDict()  # instances by the id of a run, request or stream
        self._held = Counter[str]()  # for how many questions under way and open streams such an id is kept
        self._stored: dict[str, str] = {}  # instances by the key of a scene or robot that this client stored
        self._present: dict[str, zenoh.LivelinessToken] = {}
        self._lock = threading.Lock()

    def close(self) -> None:
        """Close the session."""
        self._instances.close()
        self.session.close()

    def await_instance(self, wait: float) -> str:
        """Wait until the instance lives, and return its name; raises NoService if there is none in that time [s]."""
        deadline = time.monotonic() + wait
        while True:
            living = self._instances.living()
            if self.named in living:
                return self.named or ""
            if self.named is None and (freest := self._instances.freest(frozenset(), 0.0)) is not None:
                self._current = freest
                return freest
            if time.monotonic() > deadline:
                what = "no service" if self.named is None else f"no service named {self.named!r}"
                for name, doing in self._instances.starting().items():
                    if self.named in (None, name):
                        raise NoService(f"service {name!r} is starting: {doing}; wait for it longer", instance=name)
                others = f"; there is {', '.join(map(repr, sorted(living)))}" if living else ""
                raise NoService(f"{what} is there{others}", instance=self.named, available=sorted(living))
            time.sleep(0.01)

    @property
    def instance(self) -> str:
        """Return the present instance."""
        if self._current is None:
            return self.await_instance(RETURN_TIME_S)
        return self._current

    def alive(self) -> bool:
        """Return whether the present instance lives."""
        return self._current in self._instances.living()

    def is_there(self, instance: str) -> bool:
        """Return whether an instance lives."""
        return instance in self._instances.living()

    def ask(self, question: Question[Any]) -> Future[bytes]:
        """Ask, and return the future payload of the answer, or the exception that the service's error names.

        Raises:
            MalformedRequest: if its key can't be queried.
            NoService: if the session is closed.
        """
        if self.session.is_closed():
            raise NoService("the client is closed: connect another one")
        asking = _PendingQuestion(self, question)
        asking.answer.set_running_or_notify_cancel()  # a caller that gives up doesn't withdraw the question
        asking.send(self._choose_instance(question))
        return asking.answer

    def watching_run(
        self, run_id: str, hear: Callable[[Progress], None] | None
    ) -> contextlib.AbstractContextManager[None]:
        """Subscribe a listener to the progress of a run, at any instance, in a thread of the session; None: none.

        A shared run of another user has the user before its name.
        """
        if hear is None:
            return contextlib.nullcontext()
        base = shared_key("*") if ":" in run_id else base_key("*", self.user)
        return self._hearing(f"{base}/runs/{run_id}/progress", Progress, hear)

    def watching_scene(
        self, name: str, hear: Callable[[SceneChanged], None]
    ) -> contextlib.AbstractContextManager[None]:
        """Subscribe a listener to the changes of a stored scene, at any instance, in a thread of the session."""
        return self._hearing(f"{base_key('*', self.user)}/scenes/{name}/changes", SceneChanged, hear)

    @contextlib.contextmanager
    def _hearing(self, key: str, kind: type[_M], hear: Callable[[_M], None]) -> Iterator[None]:
        def heard(sample: zenoh.Sample) -> None:
            hear(msgspec.json.decode(sample.payload.to_bytes(), type=kind))

        subscriber = self.session.declare_subscriber(key, heard)
        try:
            yield
        finally:
            subscriber.undeclare()

    def departures(self, instance: str) -> int:
        """Return how often an instance, or the link to it, was lost."""
        return self._instances.departures(instance)

    def has_other(self, tried: frozenset[str]) -> bool:
        """Return whether a question may go to an instance that wasn't tried."""
        return self.named is None and bool(self._instances.living() - tried)

    def leave(self, instance: str, tried: frozenset[str], *, back: bool) -> str | None:
        """Return the next instance after one that gave no answer; None if there is none."""
        if self.named is not None:
            return instance if back and self._instances.returns(instance, RETURN_TIME_S) else None
        with self._lock:
            if self._current not in tried and self._current in self._instances.living():
                return self._current  # another question has moved already
            wait = RETURN_TIME_S if instance not in self._instances.living() else 0.0
            found = self._instances.freest(tried, 0.0)
            found = found or self._instances.freest(tried - {instance} if back else tried, wait)
            if found is not None:
                self._current = found
            return found

    def be_present(self, instance: str) -> None:
        """Declare this client's liveliness to an instance, from its first question on until it is closed."""
        with self._lock:
            if instance not in self._present:
                key = f"{base_key(instance, self.user)}/clients/{self.client}"
                self._present[instance] = self.session.liveliness().declare_token(key)

    def instance_of(self, own_id: str) -> str:
        """Return the instance of a run, request or stream."""
        with self._lock:
            return self._runs[own_id]

    def remember(self, run_id: str, instance: str) -> None:
        """Remember the instance of a run."""
        with self._lock:
            self._runs[run_id] = instance
            while len(self._runs) - len(self._held) > MAX_REMEMBERED_RUNS:
                del self._runs[next(oldest for oldest in self._runs if oldest not in self._held)]

    def hold(self, own_id: str, instance: str) -> None:
        """Remember the instance of a run, request or stream at least until it is released."""
        with self._lock:
            self._held[own_id] += 1
        self.remember(own_id, instance)

    def release(self, own_id: str) -> None:
        """Let an instance that was held be forgotten after further ones."""
        with self._lock:
            self._held[own_id] -= 1
            if not self._held[own_id]:
                del self._held[own_id]
            self._runs.move_to_end(own_id)

    def begin(self, question: Question[Any], instance: str) -> None:
        """Take note that a question goes to an instance."""
        if question.work:
            self._instances.loads.begin(instance)
            if question.own_id is not None:
                self.hold(question.own_id, instance)

    def end(self, question: Question[Any], instance: str, *, well: bool) -> None:
        """Take note of the end of a question, and of the things that it stored or deleted at the instance."""
        if question.work:
            self._instances.loads.end(instance)
            if question.own_id is not None:
                self.release(question.own_id)
        with self._lock:
            if well and question.stores is not None:
                self._stored[question.stores] = instance
            if well and question.forgets is not None:
                self._stored.pop(question.forgets, None)

    def _choose_instance(self, question: Question[Any]) -> str:
        if question.own_id is not None and (kept := self._runs.get(question.own_id)) is not None:
            return kept
        if self.named is not None or not question.work:
            return self.instance
        living = self._instances.living()
        with self._lock:
            holders = {self._stored[name] for name in question.needs if name in self._stored} & living
        self._instances.refresh()
        return self._instances.loads.least(holders or living, self._current) or self.instance


class _PendingQuestion:
    """A question on its way, until its one answer."""

    def __init__(self, exchange: Exchange, question: Question[Any]) -> None:
        self.answer: Future[bytes] = Future()
        self._exchange = exchange
        self._question = question
        self._deadline = time.monotonic() + question.timeout
        self._tried: frozenset[str] = frozenset()
        self._returns = self._departures = 0  # attempts at the same instance, and losses of it that were counted
        self._instance = ""
        self._replies: list[zenoh.Reply] = []

    def send(self, instance: str) -> None:
        self._instance, self._replies = instance, []
        self._tried |= {instance}
        question = self._question
        try:
            selector = zenoh.Selector(f"{base_key(instance, self._exchange.user)}/{question.key}")
        except zenoh.ZError as error:
            raise MalformedRequest(f"{question.key!r} can't be asked for: {error}", key=question.key) from None
        self._exchange.be_present(instance)
        self._exchange.begin(question, instance)
        self._exchange.session.get(
            selector,
            zenoh.handlers.Callback(self._replies.append, self._end, indirect=False),  # without a thread of its own
            payload=question.payload,
            encoding=Encoding.MSGPACK.value,
            attachment=self._exchange.client,
            timeout=max(0.001, self._deadline - time.monotonic()),
        )

    def _end(self) -> None:
        well = bool(self._replies) and self._replies[0].ok is not None
        self._exchange.end(self._question, self._instance, well=well)
        if self._replies and self._replies[0].ok is not None:
            self.answer.set_result(bytes(self._replies[0].ok.payload.to_bytes()))
            return
        error = self._refusal() if self._replies else self._explain_silence()
        refused = isinstance(error, ServerBusy | QuotaExceeded) and self._exchange.has_other(self._tried)
        if not self._replies or refused:
            # Not in Zenoh's own thread, which has to take other instances' reports.
            threading.Thread(target=self._ask_another, args=(error,), name=THREAD_NAME, daemon=True).start()
        else:
            self.answer.set_exception(error)

    def _ask_another(self, error: GuidefieldError) -> None:
        try:
            if self._exchange.session.is_closed():
                raise NoService("the client was closed before the answer came", instance=self._instance)
            lost = isinstance(error, NoService) and self._question.repeatable and self._may_return()
            other = self._exchange.leave(self._instance, self._tried, back=lost)
            if other is None:
                raise error
            if other == self._instance:
                time.sleep(RETRY_PAUSE_S * 2**self._returns)
                self._returns += 1
            self.send(other)
        except Exception as failure:  # the waiting caller must get it
            with contextlib.suppress(InvalidStateError):  # a closing session may set it, too
                self.answer.set_exception(failure)

    def _may_return(self) -> bool:
        departures = self._exchange.departures(self._instance)
        if departures != self._departures:
            self._departures, self._returns = departures, 0
        return self._returns < MAX_RETURNS

    def _explain_silence(self) -> NoService:
        name, key = self._instance, self._question.key
        if self._exchange.is_there(name):
            words = f"service {name!r} is there, but {key!r} gets no answer: this user may have no right to ask it"
        else:
            words = f"no service named {name!r} answers any more"
        return NoService(words, instance=name, key=key)

    def _refusal(self) -> GuidefieldError:
        payload = self._replies[0].err.payload.to_bytes()
        timeout, words = self._question.timeout, payload.decode(errors="replace")
        return refusal(payload) or NoService(f"no answer within {timeout:g} s ({words})", timeout=timeout)


def await_answer(answer: Future[bytes]) -> bytes:
    """Wait for an answer and return its payload, or raise its exception.

    The wait is periodic, because a Ctrl-C that the system hands to a thread of Zenoh doesn't wake the waiting thread.
    """
    while not wait([answer], SIGNAL_PERIOD_S).done:
        pass
    return answer.result()
