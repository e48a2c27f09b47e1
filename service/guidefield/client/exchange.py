"""Questions out, exactly one answer back to each of them.

Theory of operation. A question goes to one instance at a time: one for work to the freest, of those that have what this
client stored and the question names; any other to the one that was the freest when the client came. Zenoh tells when it
has brought all that there is: an answer, or none, which means that the instance is gone. Where the client named no
instance, the question then goes to another one; so it does where an instance is too busy to take it. Where there is no
other one, and the link was only cut for a moment, the same instance is asked again: a plan goes under its name, so that
the run that was under way, or has ended meanwhile, is what answers; so it goes on, however often the link is cut, until
the question's time is up. A question is never with two at once, so there is never a second answer to it.
"""

from __future__ import annotations

import contextlib
import threading
import time
import uuid
from collections import OrderedDict
from concurrent.futures import Future, InvalidStateError, wait
from typing import Any

import zenoh

from guidefield.client.instances import Instances
from guidefield.client.questions import Question, refusal
from guidefield.errors import GuidefieldError, MalformedRequest, NoService, QuotaExceeded, ServerBusy
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN, base_key

RETURN_WITHIN = 3.0
"""How long another instance is waited for when the one that was asked is gone [s]."""
MOST_RETURNS = 5
"""How often a question goes to the same instance again that was there all the time: it has no right to an answer."""
PAUSE = 0.1
"""How long it waits before it goes there again, twice as long each time: Zenoh may not know yet that it is gone [s]."""
LOOK_UP = 0.2
"""Period at which a waiting caller handles signals [s]."""
ASKS = "guidefield-ask"
"""The name of a thread that asks another instance."""
MOST_RUNS = 1_000
"""For how many runs it is remembered which instance has them."""


class Exchange:
    """Asks the instances of a session.

    Args:
        session: An open session; closed with this.
        instance: The only instance to ask; None takes the freest, and another one when that is gone.
        user: On whose keys they are asked.
    """

    def __init__(self, session: zenoh.Session, instance: str | None, user: str = PLAIN) -> None:
        self.session = session
        self.user = user
        self.named = instance
        self.client = uuid.uuid4().hex
        self._instances = Instances(session, user)
        self._current = instance
        self._runs: OrderedDict[str, str] = OrderedDict()
        self._stored: dict[str, str] = {}
        self._present: dict[str, zenoh.LivelinessToken] = {}
        self._lock = threading.Lock()

    def close(self) -> None:
        """Close the session."""
        self._instances.close()
        self.session.close()

    def await_instance(self, wait: float) -> str:
        """The instance that is asked, once it lives.

        Raises:
            NoService: if there is none in that time [s].
        """
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
        """The instance that is asked now."""
        if self._current is None:
            return self.await_instance(RETURN_WITHIN)
        return self._current

    def alive(self) -> bool:
        """Return whether the instance that is asked lives."""
        return self._current in self._instances.living()

    def is_there(self, instance: str) -> bool:
        """Return whether an instance lives."""
        return instance in self._instances.living()

    def ask(self, question: Question[Any]) -> Future[bytes]:
        """Ask, and return the future payload of the answer, or the exception that the service's error names.

        Raises:
            MalformedRequest: if its key can't be asked for.
        """
        asking = _Asking(self, question)
        asking.answer.set_running_or_notify_cancel()  # a caller may give up, the question stays on its way
        asking.send(self._asked_for(question))
        return asking.answer

    def departures(self, instance: str) -> int:
        """How often an instance was seen to go, or the link to it."""
        return self._instances.departures(instance)

    def has_other(self, tried: frozenset[str]) -> bool:
        """Return whether a question may go to another instance than those where it was."""
        return self.named is None and bool(self._instances.living() - tried)

    def leave(self, instance: str, tried: frozenset[str], *, back: bool) -> str | None:
        """Where to go from an instance that gave no answer; None if there is no such place.

        Args:
            instance: Where the question was.
            tried: Where it was by now: another instance than these is taken, if there is one and any will do.
            back: Whether the same instance will do too, once it lives again.
        """
        if self.named is not None:
            return instance if back and self._instances.returns(instance, RETURN_WITHIN) else None
        with self._lock:
            if self._current not in tried and self._current in self._instances.living():
                return self._current  # another question has moved already
            wait = RETURN_WITHIN if instance not in self._instances.living() else 0.0
            found = self._instances.freest(tried, 0.0)
            found = found or self._instances.freest(tried - {instance} if back else tried, wait)
            if found is not None:
                self._current = found
            return found

    def be_present(self, instance: str) -> None:
        """Let an instance know that this client is there, from its first question on until it is closed."""
        with self._lock:
            if instance not in self._present:
                key = f"{base_key(instance, self.user)}/clients/{self.client}"
                self._present[instance] = self.session.liveliness().declare_token(key)

    def instance_of(self, own_id: str) -> str:
        """The instance that has what was asked for under a name."""
        with self._lock:
            return self._runs[own_id]

    def remember(self, run_id: str, instance: str) -> None:
        """Ask this instance about a run from now on."""
        with self._lock:
            self._runs[run_id] = instance
            if len(self._runs) > MOST_RUNS:
                self._runs.popitem(last=False)

    def begin(self, question: Question[Any], instance: str) -> None:
        """A question goes to an instance."""
        if question.work:
            self._instances.loads.begin(instance)
            if question.own_id is not None:
                self.remember(question.own_id, instance)

    def end(self, question: Question[Any], instance: str, *, well: bool) -> None:
        """Zenoh has brought all that there is of its answer; what it stored or forgot there, is remembered."""
        if question.work:
            self._instances.loads.end(instance)
        with self._lock:
            if well and question.stores is not None:
                self._stored[question.stores] = instance
            if well and question.forgets is not None:
                self._stored.pop(question.forgets, None)

    def _asked_for(self, question: Question[Any]) -> str:
        """Which instance to ask: the one that was asked before; for work the freest that has what it needs."""
        if question.own_id is not None and (kept := self._runs.get(question.own_id)) is not None:
            return kept
        if self.named is not None or not question.work:
            return self.instance
        living = self._instances.living()
        with self._lock:
            holders = {self._stored[name] for name in question.needs if name in self._stored} & living
        self._instances.refresh()
        return self._instances.loads.least(holders or living, self._current) or self.instance


class _Asking:
    """One question on its way."""

    def __init__(self, exchange: Exchange, question: Question[Any]) -> None:
        self.answer: Future[bytes] = Future()
        self._exchange = exchange
        self._question = question
        self._deadline = time.monotonic() + question.timeout
        self._tried: frozenset[str] = frozenset()
        self._returns = self._departures = 0
        self._instance = ""
        self._brought: list[zenoh.Reply] = []

    def send(self, instance: str) -> None:
        """Ask one instance."""
        self._instance, self._brought = instance, []
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
            zenoh.handlers.Callback(self._brought.append, self._end, indirect=False),  # without a thread of its own
            payload=question.payload,
            encoding=Encoding.MSGPACK.value,
            attachment=self._exchange.client,
            timeout=max(0.001, self._deadline - time.monotonic()),
        )

    def _end(self) -> None:
        """Zenoh has brought all that there is."""
        well = bool(self._brought) and self._brought[0].ok is not None
        self._exchange.end(self._question, self._instance, well=well)
        if self._brought and self._brought[0].ok is not None:
            self.answer.set_result(bytes(self._brought[0].ok.payload.to_bytes()))
            return
        error = self._refusal() if self._brought else self._explain_silence()
        refused = isinstance(error, ServerBusy | QuotaExceeded) and self._exchange.has_other(self._tried)
        if not self._brought or refused:
            # Not in Zenoh's own thread: to look for another instance takes its answers.
            threading.Thread(target=self._ask_another, args=(error,), name=ASKS, daemon=True).start()
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
                time.sleep(PAUSE * 2**self._returns)
                self._returns += 1
            self.send(other)
        except Exception as failure:  # the waiting caller must get it
            with contextlib.suppress(InvalidStateError):  # a closing session may set it, too
                self.answer.set_exception(failure)

    def _may_return(self) -> bool:
        """Return whether to ask the same instance again: it went since the last time, or it wasn't asked too often."""
        departures = self._exchange.departures(self._instance)
        if departures != self._departures:
            self._departures, self._returns = departures, 0
        return self._returns < MOST_RETURNS

    def _explain_silence(self) -> NoService:
        """Zenoh brings no answer where the instance is gone, and where this client has no right to the key."""
        name, key = self._instance, self._question.key
        if self._exchange.is_there(name):
            words = f"service {name!r} is there, but {key!r} gets no answer: this user may have no right to ask it"
        else:
            words = f"no service named {name!r} answers any more"
        return NoService(words, instance=name, key=key)

    def _refusal(self) -> GuidefieldError:
        """Return the exception of an error reply; Zenoh itself replies in words when the time is up."""
        payload = self._brought[0].err.payload.to_bytes()
        timeout, words = self._question.timeout, payload.decode(errors="replace")
        return refusal(payload) or NoService(f"no answer within {timeout:g} s ({words})", timeout=timeout)


def await_answer(answer: Future[bytes]) -> bytes:
    """Wait for an answer and return its payload, or raise its exception.

    The wait is periodic, because a Ctrl-C that the system hands to a thread of Zenoh doesn't wake the waiting thread.
    """
    while not wait([answer], LOOK_UP).done:
        pass
    return answer.result()
