"""Queries in, exactly one answer out to each of them.

Theory of operation. One queryable serves every key of the instance, so that a query on any key, known or not, has one
answerer. Its callback only sorts: what needs a robot, obstacle geometry or a kernel goes to the pool of workers; what
reads or deletes files goes to a few threads here; the rest is answered at once, or ends a run early. Whoever settles a
query does so through `Asked`, which answers once and only once, whatever happens; the answer goes out by a thread of
the `Outbox`, so that whoever doesn't read holds up nobody.
"""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import zenoh

from guidefield.endpoint.asked import Asked
from guidefield.endpoint.condition import Condition
from guidefield.endpoint.meter import Meter
from guidefield.endpoint.outbox import Outbox
from guidefield.endpoint.tracing import End, Trace, no_trace
from guidefield.endpoint.under_way import UnderWay
from guidefield.engine import Engine
from guidefield.errors import ServerBusy, WorkerCrashed
from guidefield.handlers.info import Figures, brief_info, disk_of, info
from guidefield.handlers.unbegun import (
    cancelled_before,
    cancelled_waiting,
    error_answer,
    time_up_loading,
    time_up_waiting,
    timed_out_loading,
    timed_out_waiting,
)
from guidefield.messages import codec, keys
from guidefield.messages.codec import Encoding
from guidefield.messages.replies import Done, Health, error_reply
from guidefield.pool.pool import Pool
from guidefield.pool.waiting import BACKSTOP, Answer, Deadline, Task
from guidefield.run import whole_recording
from guidefield.stores.files import checked_name
from guidefield.stores.runs import Runs
from guidefield.worker import Job

_log = logging.getLogger(__name__)

HEAVY_KEYS = ("plan", "certify", "kinematics", "robots")
"""What needs a worker; and so does any other query with a payload."""
KINDS = ("plan", "certify", "kinematics", "robots", "scenes", "runs", "info")
"""What queries are timed under, by the first chunk of their key."""
LATE, LATE_SHARE = 0.02, 0.03
"""How much later than its time a request is answered that is still loaded for [s], and by which share of its time."""
LAST_ANSWERS = 5.0
"""How long the last answers may take to be read at the end [s]."""
MOST_READS = 64
"""How many queries for files may wait."""


class Endpoint:
    """Sorts queries and answers them.

    Args:
        instance: Name of the service.
        engine: Answers what needs no worker.
        runs: Where recordings are read.
        pool: Answers the rest; jobs are `worker.Job`.
        publish: Publishes JSON on a key.
        trace: Begins the trace of each query.
        condition: How the service is; None: ready.
        data: Folder whose disk is told of.
    """

    def __init__(
        self,
        instance: str,
        engine: Engine,
        runs: Runs,
        pool: Pool,
        publish: Callable[[str, bytes], None],
        trace: Trace = no_trace,
        condition: Condition | None = None,
        data: Path | None = None,
    ) -> None:
        self._instance = instance
        self._engine = engine
        self._runs = runs
        self._pool = pool
        self._publish = publish
        self._trace = trace
        self._condition = condition
        self._data = data
        self._under_way = UnderWay(pool)
        self._outbox = Outbox()
        self._readers = ThreadPoolExecutor(2, thread_name_prefix="guidefield-reader")
        self._closed = False
        self._free_reads = threading.Semaphore(MOST_READS)
        self._meter = Meter()
        self._began = time.monotonic()

    def receive(self, query: zenoh.Query) -> None:
        """Take a query; returns at once, and whatever happens the query is answered."""
        received = time.monotonic()
        key = str(query.key_expr)
        end = self._trace(_kind(key), key)
        count = partial(self._count_answer, _kind(key), received, end)
        asked = Asked(query, self._instance, count, self._outbox.post)
        self._meter.count("asked")
        with asked.answering_failures():
            read = asked.read()
            keys.check(read)
            if read.key == ("info",):
                reply = (brief_info if keys.is_brief(read) else info)(self._figures())
                asked.answer((True, codec.encode(reply, read.encoding)))
            elif keys.is_cancel(read):
                asked.answer((True, codec.encode(Done(done=self._cancel(read)), read.encoding)))
            elif read.key[0] in HEAVY_KEYS or read.payload:
                self._hand_over(asked, read, received)
            else:
                self._look_up(asked, read)

    def forget(self, client: str) -> None:
        """End whatever a client asked for that is gone."""
        ended = self._under_way.cancel_all_of(client)
        if ended:
            self._meter.count("forgotten")
            _log.info("client %s is gone: %d requests of it end", client, ended)

    def close(self) -> None:
        """Answer what is being read, refuse what waits to be, and send what waits to be sent."""
        self._closed = True
        self._readers.shutdown(wait=True)
        self._outbox.close(LAST_ANSWERS)

    def _count_answer(self, kind: str, received: float, end: End, what: str) -> None:
        end(what)
        self._meter.count(what)
        self._meter.time(kind, time.monotonic() - received)

    def _figures(self) -> Figures:
        return Figures(
            counters={**self._meter.counters(), "crashes": self._pool.crashes},
            uptime=time.monotonic() - self._began,
            workers=self._pool.workers,
            busy=self._pool.busy,
            queue=self._pool.queue,
            memory=self._pool.memory,
            latency=self._meter.latency(),
            health=Health() if self._condition is None else self._condition.now,
            disk=None if self._data is None else disk_of(self._data),
        )

    def _cancel(self, read: keys.Query) -> str:
        self._meter.count("cancels")
        kind, own = read.key[:2]
        return self._under_way.cancel((kind, checked_name(own, f"{kind[:-1]}_id")))

    def _look_up(self, asked: Asked, read: keys.Query) -> None:
        if self._closed:
            raise ServerBusy("the service is shutting down")
        if not self._free_reads.acquire(blocking=False):
            raise ServerBusy(f"{MOST_READS} queries wait for the disk already; ask again later", limit=MOST_READS)
        self._readers.submit(self._read_files, asked, read)

    def _read_files(self, asked: Asked, read: keys.Query) -> None:
        with asked.answering_failures():
            try:
                if self._closed:
                    raise ServerBusy("the service is shutting down")
                if keys.is_recording(read):
                    asked.answer((True, whole_recording(self._runs, read.key[1])), "application/octet-stream")
                else:
                    asked.answer((True, codec.encode(self._engine.answer(keys.request_of(read)), read.encoding)))
            finally:
                self._free_reads.release()

    def _hand_over(self, asked: Asked, read: keys.Query, received: float) -> None:
        if self._condition is not None:
            self._condition.require_ready()
        head = keys.run_head(read)
        size = len(read.payload)
        if head is None:
            self._hand_work_over(asked, read, received)
            return
        run_id = head.run_id or uuid.uuid4().hex
        task = Task(
            Job(read, received, run_id),
            head.allowed + BACKSTOP,
            deadline=Deadline(received + head.allowed, partial(_timed_out, run_id, head, read.encoding)),
            late=Deadline(_late(received, head.allowed), partial(_timed_out_loading, run_id, head, read.encoding)),
            client=read.client,
            size=size,
            hear=partial(self._publish, f"guidefield/{self._instance}/runs/{run_id}/progress"),
        )
        cancelled = partial(_cancelled, run_id, head, read.encoding, received)
        task = self._under_way.submit(("runs", run_id), task, cancelled, (read.encoding, read.payload))
        task.add_done_callback(partial(self._end_run, run_id))
        task.add_done_callback(asked.settle)

    def _hand_work_over(self, asked: Asked, read: keys.Query, received: float) -> None:
        """Have something done that makes no run."""
        head = keys.work_head(read)
        told = partial(error_answer, read.encoding)
        late = Deadline(_late(received, head.allowed), partial(told, time_up_loading(head.allowed)))
        task = Task(
            Job(read, received),
            head.allowed + BACKSTOP,
            deadline=Deadline(received + head.allowed, partial(told, time_up_waiting(head.allowed))),
            late=None if keys.changes_store(read) else late,
            client=read.client,
            size=len(read.payload),
        )
        name = None if head.request_id is None else ("requests", checked_name(head.request_id, "request_id"))
        words = (read.key, read.encoding, read.payload)
        task = self._under_way.submit(name, task, partial(told, cancelled_before()), words)
        task.add_done_callback(asked.settle)

    def _end_run(self, run_id: str, future: Future[Answer]) -> None:
        error = future.exception()
        if isinstance(error, WorkerCrashed):
            try:
                self._runs.fail(run_id, error_reply(error))
            except OSError:
                _log.exception("the end of run %s is not kept", run_id)


def _kind(key: str) -> str:
    """What a query's time is counted under."""
    _, _, kind = f"{key}///".split("/")[:3]
    return kind if kind in KINDS else "other"


def _cancelled(run_id: str, head: keys.RunHead, encoding: Encoding, received: float) -> Answer:
    return True, codec.encode(cancelled_waiting(run_id, head, time.monotonic() - received), encoding)


def _late(received: float, allowed: float) -> float:
    """When a request is answered that a worker still loads things for, by `time.monotonic()` [s]."""
    return received + allowed + LATE + LATE_SHARE * allowed


def _timed_out_loading(run_id: str, head: keys.RunHead, encoding: Encoding) -> Answer:
    return True, codec.encode(timed_out_loading(run_id, head), encoding)


def _timed_out(run_id: str, head: keys.RunHead, encoding: Encoding) -> Answer:
    return True, codec.encode(timed_out_waiting(run_id, head), encoding)
