"""The answer of a run, which is given once the run is kept; what can't be kept becomes a warning in it."""

from __future__ import annotations

import contextlib
import logging
from concurrent.futures import Future
from functools import partial
from typing import Any

import msgspec

from guidefield.errors import GuidefieldError
from guidefield.messages import codec
from guidefield.messages.replies import CertifyReply, ErrorReply, MotionReply, PlanReply, error_reply
from guidefield.pool.waiting import Answer, Task
from guidefield.stores.files import decoded
from guidefield.stores.run_rows import NewRun
from guidefield.stores.runs import UserRuns

_log = logging.getLogger(__name__)


def keep_answer(runs: UserRuns, run: NewRun, task: Task) -> Future[Answer]:
    """Have the outcome of a task kept as that of its run.

    Args:
        runs: The runs of its user.
        run: The run.
        task: Comes to the answer, or to the error in its place.

    Returns:
        The same, once the run is kept or can't be; at once where time is up, whether it will be kept or not.
    """
    answer: Future[Answer] = Future()
    task.add_done_callback(lambda _: _keep(runs, run, answer, task))
    return answer


def hand_on(answer: Future[Answer], outcome: Future[Answer]) -> None:
    """Have a future come to the same as one that is done."""
    error = outcome.exception()
    if error is not None:
        answer.set_exception(error)
    else:
        answer.set_result(outcome.result())


def _keep(runs: UserRuns, run: NewRun, answer: Future[Answer], task: Task) -> None:
    if task.is_overdue:
        hand_on(answer, task)
    error = task.exception()
    if error is None and task.result()[0]:
        written = runs.finish(run, task.result()[1])
    elif error is None:
        refusal = decoded(task.result()[1], ErrorReply, run.encoding)
        written = runs.discard(run) if refusal is None else runs.fail(run, refusal)
    else:
        written = runs.fail(run, error_reply(error)) if isinstance(error, GuidefieldError) else runs.discard(run)
    written.add_done_callback(partial(_answer, runs, run, answer, task))


def _answer(runs: UserRuns, run: NewRun, answer: Future[Answer], task: Future[Answer], written: Future[Any]) -> None:
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
    reply = decoded(task.result()[1], kind, run.encoding)
    assert isinstance(reply, MotionReply), "it was written by a worker"
    warnings = [*reply.warnings, f"the run is not kept: {fault}"]
    told = msgspec.structs.replace(reply, recording=None, warnings=warnings)
    answer.set_result((True, codec.encode(told, run.encoding)))
