"""Queries in, exactly one answer out to each of them.

Theory of operation. One queryable serves every key of the instance, so that a query on any key, known or not, has one
answerer. Its callback only sorts: what needs a robot, obstacle geometry or a kernel goes to the pool of workers; what
reads or deletes files goes to a few threads here; the rest is answered at once. Whoever settles a query does so through
`Asked`, which answers once and only once, whatever happens.
"""

from __future__ import annotations

import contextlib
import threading
import time
import uuid
from collections import Counter
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial

import zenoh

from guidefield.endpoint.asked import Asked
from guidefield.engine import Engine
from guidefield.errors import GuidefieldError, ServerBusy, WorkerCrashed
from guidefield.handlers.info import info
from guidefield.handlers.timed_out import timed_out_waiting
from guidefield.messages import codec, keys
from guidefield.messages.codec import Encoding
from guidefield.messages.replies import InfoReply, error_reply
from guidefield.pool.pool import Pool
from guidefield.pool.waiting import Answer, Deadline
from guidefield.stores.runs import Runs
from guidefield.worker import Job

HEAVY_KEYS = ("plan", "kinematics", "robots")
"""What needs a worker; and so does any other query with a payload."""
BACKSTOP = 60.0
"""A worker that plans longer than its request allows by this is stopped [s]."""
LONGEST_WORK = 600.0
"""A worker that works longer on anything but a plan is stopped [s]."""
MOST_READS = 64
"""How many queries for files may wait."""


class Endpoint:
    """Sorts queries and answers them.

    Args:
        instance: Name of the service.
        engine: Answers what needs no worker.
        runs: Where recordings are read.
        pool: Answers the rest; jobs are `worker.Job`.
    """

    def __init__(self, instance: str, engine: Engine, runs: Runs, pool: Pool) -> None:
        self._instance = instance
        self._engine = engine
        self._runs = runs
        self._pool = pool
        self._readers = ThreadPoolExecutor(2, thread_name_prefix="guidefield-reader")
        self._free_reads = threading.Semaphore(MOST_READS)
        self._counters = Counter(asked=0, answered=0, refused=0)
        self._counting = threading.Lock()
        self._began = time.monotonic()

    def receive(self, query: zenoh.Query) -> None:
        """Take a query; returns at once, and whatever happens the query is answered."""
        received = time.monotonic()
        asked = Asked(query, self._instance, self._count)
        self._count("asked")
        with asked.answering_failures():
            read = asked.read()
            keys.check(read)
            if read.key == ("info",):
                asked.answer((True, codec.encode(self._info(), read.encoding)))
            elif read.key[0] in HEAVY_KEYS or read.payload:
                self._hand_over(asked, read, received)
            else:
                self._look_up(asked, read)

    def close(self) -> None:
        """Answer what is being read, and no more."""
        self._readers.shutdown(wait=True)

    def _count(self, what: str) -> None:
        with self._counting:
            self._counters[what] += 1

    def _info(self) -> InfoReply:
        return info(
            workers=self._pool.workers,
            queue=self._pool.queue,
            counters={**self._counters, "crashes": self._pool.crashes},
            uptime=time.monotonic() - self._began,
        )

    def _look_up(self, asked: Asked, read: keys.Query) -> None:
        if not self._free_reads.acquire(blocking=False):
            raise ServerBusy(f"{MOST_READS} queries wait for the disk already; ask again later", limit=MOST_READS)
        self._readers.submit(self._read_files, asked, read)

    def _read_files(self, asked: Asked, read: keys.Query) -> None:
        with asked.answering_failures():
            try:
                if keys.is_recording(read):
                    asked.answer((True, self._runs.recording(read.key[1])), "application/octet-stream")
                else:
                    asked.answer((True, codec.encode(self._engine.answer(keys.request_of(read)), read.encoding)))
            finally:
                self._free_reads.release()

    def _hand_over(self, asked: Asked, read: keys.Query, received: float) -> None:
        head = keys.plan_head(read)
        if head is None:
            future = self._pool.submit(Job(read, received), seconds=LONGEST_WORK)
            future.add_done_callback(asked.settle)
            return
        run_id = head.run_id or uuid.uuid4().hex
        deadline = Deadline(received + head.allowed, partial(_timed_out, run_id, head, read.encoding))
        future = self._pool.submit(Job(read, received, run_id), seconds=head.allowed + BACKSTOP, deadline=deadline)
        future.add_done_callback(partial(self._end_run, run_id))
        future.add_done_callback(asked.settle)

    def _end_run(self, run_id: str, future: Future[Answer]) -> None:
        error = future.exception()
        if isinstance(error, WorkerCrashed):
            with contextlib.suppress(OSError, GuidefieldError):
                self._runs.fail(run_id, error_reply(error))


def _timed_out(run_id: str, head: keys.PlanHead, encoding: Encoding) -> Answer:
    return True, codec.encode(timed_out_waiting(run_id, head), encoding)
