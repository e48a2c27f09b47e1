"""Work under way, by name and by client: waiting, running, or cancelled before it arrives; and keeping a run's answer.

The answer of a run is given once the run is stored; if it can't be stored, that becomes a warning in the answer.
"""

from __future__ import annotations

import contextlib
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

from guidefield.errors import GuidefieldError
from guidefield.messages import codec
from guidefield.messages.identities import Asker
from guidefield.messages.replies import CertifyReply, ErrorReply, MotionReply, PlanReply, make_error_reply
from guidefield.pool.pool import Pool
from guidefield.pool.waiting import Answer, Task
from guidefield.stores.files import decode_if_whole
from guidefield.stores.run_rows import NewRun
from guidefield.stores.runs import UserRuns, name_taken

_log = logging.getLogger(__name__)


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
    words: object  # what identifies the query that asked for it
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
