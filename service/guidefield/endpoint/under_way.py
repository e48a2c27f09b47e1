"""Queries that wait for their one answer, work under way, by name and by client, and clients that are gone.

The answer of a run is given once the run is stored; if it can't be stored, that becomes a warning in the answer.
Clients count with `GRACE` (`client/stream_link.py` `LOST_SERVICE_S`). The wire page tells it, `LONGEST_CLIENT`,
`REMEMBERED` and `MOST_REMEMBERED` by `rules.py`: after a change, `tools/wire_page`.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import Any

import msgspec
import zenoh

from guidefield.errors import GuidefieldError, MalformedRequest, ServerBusy, convert_exception
from guidefield.messages import codec, keys
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN, USERS, Asker, split_owner, split_user
from guidefield.messages.replies import CertifyReply, ErrorReply, MotionReply, PlanReply, make_error_reply
from guidefield.pool.pool import Pool
from guidefield.pool.waiting import Answer, Task
from guidefield.stores.files import decode_if_whole
from guidefield.stores.run_rows import NewRun
from guidefield.stores.runs import UserRuns, name_taken

JSON_NAMES = ("", "zenoh/bytes", "zenoh/string", "application/json", "text/json")
"""Zenoh encodings that mean JSON: its own default ones too."""
FILE = "application/octet-stream"  # the Zenoh encoding of a recording or proof
RETRY_AFTER = 1.0  # time after which a client with too many unread answers may ask again [s]
LONGEST_CLIENT = 64  # length of a client's name; the rest is ignored [bytes]
REMEMBERED_KEYS = 1_000  # size of the caches of parsed keys

_log = logging.getLogger(__name__)

Post = Callable[[Asker, int, Callable[[], None]], bool]
"""Has an answer of a size [bytes] sent to a client; returns whether it will be: `Outbox.post`."""


def encoding_of(declared: object) -> Encoding:
    """Return the encoding of a payload by Zenoh's name of it, None: the default; raises MalformedRequest if unknown."""
    name = str(declared or "").partition(";")[0]
    if name in JSON_NAMES:
        return Encoding.JSON
    if name == Encoding.MSGPACK:
        return Encoding.MSGPACK
    raise MalformedRequest(
        f"encoding {name!r} is not understood; use {' or '.join(Encoding)}", encoding=name, available=list(Encoding)
    )


@functools.lru_cache(REMEMBERED_KEYS)
def _split(key: str) -> tuple[str, tuple[str, ...]]:
    chunks = key.split("/")
    if "**" in chunks or any("*" in chunk for chunk in chunks[2:]):
        raise MalformedRequest(f"ask one key at a time: {key!r} has wildcards", key=key)
    return split_user(chunks[2:])


class PendingQuery:
    """A query that waits for its one answer; `count` takes the outcome: answered, refused or dropped."""

    def __init__(self, query: zenoh.Query, key: str, instance: str, count: Callable[[str], None], post: Post) -> None:
        self._query, self._key, self._instance, self._count, self._post = query, key, instance, count, post
        attachment = query.attachment
        client = "" if attachment is None else attachment.to_bytes()[:LONGEST_CLIENT].decode(errors="replace")
        self._asker = Asker(PLAIN, client)
        self._encoding = Encoding.JSON
        self._is_file = False
        self._open = threading.Lock()

    def read(self, let_in: Callable[[keys.Query, int], None]) -> keys.Query:
        """Read the query.

        Args:
            let_in: Takes the query without its payload, and the payload's size [bytes]; raises the error with which it
                is refused. The payload is copied only after that, because nothing else is answered in that time.

        Raises:
            MalformedRequest: if its encoding is unknown, or its key has wildcards or an invalid user.
            RequestTooLarge: if its payload is too large.
        """
        query = self._query
        self._encoding = encoding_of(query.encoding)
        user, below = _split(self._key)
        self._asker = asker = Asker(user, self._asker.client)
        owner, key = split_owner(user, below)
        parameters = dict(query.parameters)
        read = keys.Query(key, parameters, b"", self._encoding, user, owner, asker.client, key != below)
        self._is_file = keys.is_file(read)
        payload = query.payload
        size = 0 if payload is None else len(payload)
        let_in(read, size)
        codec.require_size(size)
        return read if payload is None else msgspec.structs.replace(read, payload=payload.to_bytes())

    def settle(self, future: Future[Answer]) -> None:
        """Answer with the result of a future, or its error."""
        try:
            answer = future.result()
        except Exception as error:
            self.fail(error)
        else:
            self.answer(answer)

    def answer(self, answer: Answer) -> None:
        """Have the answer sent, unless one was sent; an error instead if too many bytes wait for this client."""
        if not self._open.acquire(blocking=False):
            return
        outcome = "answered" if answer[0] else "refused"
        if not self._post(self._asker, len(answer[1]), partial(self._send, answer)):
            outcome, busy = "refused", "too much waits to be read by this client already; read that first"
            unread = self._encode_error(ServerBusy(busy, retry_after=RETRY_AFTER))
            if not self._post(self._asker, 0, partial(self._send, unread)):
                outcome = "dropped"
                self._query.drop()
        self._count(outcome)

    def fail(self, error: Exception) -> None:
        """Answer with an error, which is logged unless it is one of ours."""
        converted = convert_exception(error)
        if converted is not error:
            _log.error("a query failed by itself", exc_info=error)
        try:
            self.answer(self._encode_error(converted))
        except Exception:  # Zenoh refuses to send: there is nobody to tell
            _log.exception("an error could not be sent")

    def _encode_error(self, error: GuidefieldError) -> Answer:
        return False, codec.encode(make_error_reply(error), self._encoding)

    def _send(self, answer: Answer) -> None:
        is_reply, payload = answer
        with self._query as query:
            if is_reply:
                key = f"guidefield/{self._instance}/{self._key.split('/', 2)[2]}"
                query.reply(key, payload, encoding=FILE if self._is_file else self._encoding.value)
            else:
                query.reply_err(payload, encoding=self._encoding.value)


GRACE = 6.0
"""Time after which a client whose token vanished is gone [s] (docs/stream.md).

Until then it can have its token back: its attempts to reconnect begin 0.2 s after it notices a cut link, and are at
most a second apart (`RETRY` of `client/session.py`). Of a silent cut it learns within `LEASE` of `link.py`, as does
the service.
"""


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


def keep_answer(runs: UserRuns, run: NewRun, task: Task) -> Future[Answer]:
    """Have the outcome of a task stored as that of its run.

    Returns:
        The same outcome, once the run is stored or can't be; without waiting for that if the task is overdue.
    """
    answer: Future[Answer] = Future()

    def keep(_: Future[Answer]) -> None:
        if task.is_overdue:
            hand_on(answer, task)
        error, refusal = task.exception(), None
        if error is None and task.result()[0]:
            written = runs.finish(run, task.result()[1])
        else:
            if error is None:
                refusal = decode_if_whole(task.result()[1], ErrorReply, run.encoding)
            elif isinstance(error, GuidefieldError):
                refusal = make_error_reply(error)
            written = runs.discard(run) if refusal is None else runs.fail(run, refusal)
        written.add_done_callback(hand_on_written)

    def hand_on_written(written: Future[Any]) -> None:
        fault = written.exception()
        if fault is not None:
            _log.warning("run %s: it is not kept: %s", run.run_id, fault)
            with contextlib.suppress(OSError, GuidefieldError):
                runs.recordings.drop(run.run_id)
        if answer.done():
            return
        if fault is None or task.exception() is not None or not task.result()[0]:
            hand_on(answer, task)
            return
        kind: type[MotionReply] = CertifyReply if run.kind == "certify" else PlanReply
        reply = decode_if_whole(task.result()[1], kind, run.encoding)
        assert isinstance(reply, MotionReply), "it was written by a worker"
        warnings = [*reply.warnings, f"the run is not kept: {fault}"]
        unkept = msgspec.structs.replace(reply, recording=None, proof=None, warnings=warnings)
        answer.set_result((True, codec.encode(unkept, run.encoding)))

    task.add_done_callback(keep)
    return answer


def hand_on(answer: Future[Answer], outcome: Future[Answer]) -> None:
    """Give a future the result or exception of another one, which is done."""
    error = outcome.exception()
    if error is not None:
        answer.set_exception(error)
    else:
        answer.set_result(outcome.result())


REMEMBERED = 10.0  # time for which a cancel that arrives before its run is remembered [s]
MOST_REMEMBERED = 1_000  # number of such cancels; the oldest are forgotten first

Name = tuple[str, str, str]
"""The user, the key below which work is cancelled, ``runs`` or ``requests``, and its id there."""


@dataclass(frozen=True)
class _Work:
    task: Task
    cancelled: Callable[[], Answer]
    words: object  # what identifies its query
    answer: Future[Answer]


class UnderWay:
    """The work under way."""

    def __init__(self, pool: Pool) -> None:
        self._pool = pool
        self._named: dict[Name, _Work] = {}
        self._all: dict[Task, _Work] = {}
        self._early: OrderedDict[Name, float] = OrderedDict()  # cancels that came before their work, and when
        self._lock = threading.Lock()

    def submit(
        self,
        name: Name | None,
        task: Task,
        cancelled: Callable[[], Answer],
        words: object,
        answer: Future[Answer] | None = None,
        kept: Callable[[], Future[Answer] | None] = lambda: None,
    ) -> Future[Answer]:
        """Have a task done, unless it was cancelled or answered already, or the same query has it under way.

        Args:
            cancelled: Makes the answer if it is cancelled before it begins.
            words: Equal for equal queries: a client whose link broke may ask again, and waits for the same work.
            answer: The answer that follows from the task; None: the task itself.
            kept: Returns the answer to come of an earlier run of this name; None: there is none.

        Returns:
            The answer to wait for: this one, or that of the work under way.

        Raises:
            MalformedRequest: if another run of that name is under way.
            ServerBusy: if too much waits already, or the pool is closed.
        """
        work = _Work(task, cancelled, words, task if answer is None else answer)
        is_cancelled = False
        with self._lock:
            if name is not None:
                self._forget_old()
                known = self._named.setdefault(name, work)
                if known is not work and known.words == words:
                    return known.answer
                if known is not work and name[1] == "runs":
                    raise name_taken(name[2])
                is_cancelled = self._early.pop(name, None) is not None
            self._all[task] = work
        work.answer.add_done_callback(partial(self._end, name, work))
        try:
            if (before := kept()) is not None:
                before.add_done_callback(partial(hand_on, work.answer))
            elif is_cancelled:
                task.set_result(cancelled())
            else:
                self._pool.submit(task)
        except Exception as error:  # other queries may wait for the same work
            work.answer.set_exception(error)
            raise
        return work.answer

    def cancel(self, name: Name) -> str:
        """End work early, now or when it arrives; return a sentence about it."""
        kind, own = name[1].removesuffix("s"), name[2]
        with self._lock:
            work = self._named.get(name)
            if work is None:
                self._forget_old()
                self._early[name] = time.monotonic()
                return f"no {kind} {own!r} is under way; if it arrives within {REMEMBERED:g} s, it ends at once"
        self._pool.cancel(work.task, work.cancelled)
        return f"{kind} {own!r} ends"

    def cancel_all_of(self, asker: Asker) -> int:
        """End all work of a client early; return its number."""
        with self._lock:
            found = [work for work in self._all.values() if work.task.asker == asker]
        for work in found:
            self._pool.cancel(work.task, work.cancelled)
        return len(found)

    def _end(self, name: Name | None, work: _Work, _: Future[Answer]) -> None:
        with self._lock:
            self._all.pop(work.task, None)
            if name is not None and self._named.get(name) is work:
                del self._named[name]

    def _forget_old(self) -> None:
        now = time.monotonic()
        while self._early and (
            len(self._early) >= MOST_REMEMBERED or now - next(iter(self._early.values())) > REMEMBERED
        ):
            self._early.popitem(last=False)
