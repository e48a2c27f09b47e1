"""Sort queries to workers, reading threads and streams, and give each exactly one answer.

Theory of operation. One queryable serves every key of the instance, so that each query, on a known key or not, has one
answerer. Zenoh calls it in the thread of the query's link, so that a flood on one link delays no other. It only
sorts: queries that need a robot, obstacle geometry or a kernel go to the pool of workers; those that read or delete
files go to the few threads of `Readers`; the others are answered at once, or end a run early. Each query is settled
through `PendingQuery`, which answers exactly once; a thread of the `Outbox` sends the answer, so that a client that
doesn't read delays no other. What each key needs and does is declared in `messages/keys.py`, too.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import logging
import threading
import time
import uuid
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import get_args

import zenoh

from guidefield.endpoint.allowances import Allowances
from guidefield.endpoint.monitoring import Condition, End, Meter, Trace
from guidefield.endpoint.streams import Streams, require_own
from guidefield.endpoint.under_way import REMEMBERED_KEYS, PendingQuery, UnderWay, keep_answer
from guidefield.engines import Engines, EngineSetup, Job
from guidefield.errors import DiskRefused, GuidefieldError, MalformedRequest, NotAllowed, ServerBusy, convert_exception
from guidefield.handlers import expired
from guidefield.handlers.info import Figures, Rules, brief_info, disk_of, info
from guidefield.messages import codec, keys, stream_requests
from guidefield.messages.identities import PLAIN, USERS, Asker, base_key, shared_key
from guidefield.messages.replies import Done, Identity, UserFigures
from guidefield.messages.requests import MotionRequest
from guidefield.messages.scene_changes import SceneChanged
from guidefield.pool.pool import Pool
from guidefield.pool.waiting import BACKSTOP, Answer, Limits, Task, TimedAnswer, Waiting
from guidefield.rendering import whole_recording
from guidefield.stores.by_user import Kind
from guidefield.stores.files import checked_name
from guidefield.stores.run_rows import NewRun
from guidefield.stores.runs import RunDatabase, answered_before

THREADS = 2  # files that are read at once
MOST_READS = 64  # number of queries for files that may wait; in docs/wire.md by `rules.py`: then `tools/wire_page`
TASK_TIME_S = 600.0  # time that a task states; no thread is stopped after it [s]


class Readers:
    """Threads that answer queries which need files only."""

    def __init__(self) -> None:
        self._waiting = Waiting(Limits(tasks=MOST_READS, tasks_of_client=MOST_READS))
        self._come = threading.Semaphore(0)
        self._threads = [
            threading.Thread(target=self._read_all, name="guidefield-reader", daemon=True) for _ in range(THREADS)
        ]
        for thread in self._threads:
            thread.start()

    def submit(self, asker: Asker, read: Callable[[], Answer]) -> Task:
        """Have `read` called; return the future of its answer or error.

        Raises ServerBusy if too many queries wait already, or the threads end.
        """
        task = Task(read, TASK_TIME_S, asker=asker)
        for pushed in self._waiting.add(task):
            reason = "too many queries wait for the disk, and most of them are yours; ask again later"
            pushed.set_exception(ServerBusy(reason, retry_after=self._waiting.retry_after(pushed.asker.user)))
        self._come.release()
        return task

    def close(self) -> None:
        """Finish running reads, and refuse waiting ones."""
        for task in self._waiting.close():
            task.set_exception(ServerBusy("the service is shutting down"))
        self._come.release(THREADS)
        for thread in self._threads:
            thread.join()

    def _read_all(self) -> None:
        while self._come.acquire() and not self._waiting.closed:
            if (task := self._waiting.take()) is None:  # it was pushed out
                continue
            began = time.monotonic()
            try:
                outcome: Answer | GuidefieldError = task.job()
            except Exception as error:  # the thread must outlive it
                outcome = convert_exception(error)
                if outcome is not error:
                    _log.exception("a query failed by itself")
            seconds = time.monotonic() - began
            self._waiting.settle(task, seconds, seconds)
            if isinstance(outcome, GuidefieldError):
                task.set_exception(outcome)
            else:
                task.set_result(outcome)


_log = logging.getLogger(__name__)

HEAVY_KEYS = frozenset(key.key.partition("/")[0] for key in keys.KEYS if key.worker == "always")
"""First chunks of the keys whose queries always need a worker; by `_sort` those with a payload do, whatever their key.

`_read_files` alone sends proofs and tells of deleted scenes: `runs` and `scenes` can't be among them.
"""
KINDS = ("plan", "certify", "kinematics", "robots", "scenes", "runs", "streams", "info")
"""First chunks of keys under which queries are timed: the kinds in `info` and metrics."""
LATE, LATE_SHARE = 0.02, 0.03
"""Delay after a request's time [s], and as a share of it, at which it is answered for a worker that still loads.

The wire page tells them by `rules.py`: after a change, `tools/wire_page`.
"""
LATE_RESULT, LATE_RESULT_SHARE = 0.04, 0.045
"""The same for a worker that checks the deadline itself, and needs time to send its result.

docs/service.md promises answers within 50 ms and 5 % after their time: these stay below.
"""
MAX_BRIEF_BYTES = 1 << 14  # largest query of kinematics that counts as brief, and may be done twice (`Task`)
LAST_ANSWERS = 5.0  # time for the last answers to be read at the end [s]


class Endpoint:
    """Sorts queries and answers them.

    Args:
        setup: Of the engines.
        engines: Answer requests that need no worker.
        runs: All runs that are kept.
        pool: Answers the other requests; jobs are `engines.Job`.
        streams: All streams that are open.
        publish: Publishes JSON on a key.
        trace: Begins the trace of each query.
        condition: The state of the service.
        rules: The limits of the service, and its rules of delivery, for `info`.
        access_control: True if the configuration keeps users to their own keys.
        memory_of_renderer: Returns the resident memory of the process that renders recordings [bytes].
    """

    def __init__(
        self,
        setup: EngineSetup,
        engines: Engines,
        runs: RunDatabase,
        pool: Pool,
        streams: Streams,
        publish: Callable[[str, bytes], None],
        trace: Trace,
        condition: Condition,
        rules: Rules,
        access_control: bool,
        memory_of_renderer: Callable[[], int],
    ) -> None:
        self._setup, self._engines, self._runs, self._pool = setup, engines, runs, pool
        self._streams, self._publish, self._trace, self._condition = streams, publish, trace, condition
        self._rules, self._access_control, self._memory_of_renderer = rules, access_control, memory_of_renderer
        self._under_way, self._readers = UnderWay(pool), Readers()
        self._allowances = Allowances(setup.quotas, pool.waiting)
        self._meter = Meter()
        self._began = time.monotonic()

    def receive(self, query: zenoh.Query) -> None:
        """Take a query; returns at once, and whatever happens the query is answered."""
        received = time.monotonic()
        _keep_thread_state()
        key = str(query.key_expr)
        kind = _kind(key)
        count = partial(self._count_answer, kind, received, self._trace(kind, key))
        pending = PendingQuery(query, key, self._setup.instance, count, self._pool.outbox.post)
        self._meter.count("asked")
        try:
            self._sort(pending, pending.read(self._let_in), received)
        except Exception as error:
            pending.fail(error)

    def _sort(self, pending: PendingQuery, read: keys.Query, received: float) -> None:
        if stream_requests.is_stream(read):
            self._ask_stream(pending, read, received)
            return
        keys.check(read)
        self._require_right(read)
        if read.key == ("info",):
            figures = self.figures(read.user)
            reply = brief_info(figures) if keys.is_brief(read) else info(figures, self._rules)
            pending.answer((True, codec.encode(reply, read.encoding)))
        elif keys.is_cancel(read):
            pending.answer((True, codec.encode(Done(done=self._cancel(read)), read.encoding)))
        elif not keys.is_sharing(read) and (
            read.key[0] in HEAVY_KEYS
            or read.payload
            or (keys.is_recording(read) and self._runs.of(read.owner).recordings.is_owed(read.key[1]))
        ):
            self._hand_over(read, received).add_done_callback(pending.settle)
        else:
            self._readers.submit(read.asker, partial(self._read_files, read)).add_done_callback(pending.settle)

    def _let_in(self, read: keys.Query, size: int) -> None:
        """Refuse a user's query, with a payload of a size [bytes], if it exceeds the user's quota."""
        if read.user != PLAIN:
            self._pool.stand_by()
        if not keys.is_cancel(read):  # which reduces the work
            self._allowances.ask(read.user, size, lists=keys.is_list(read))

    def _ask_stream(self, pending: PendingQuery, read: keys.Query, received: float) -> None:
        if keys.is_recording(read):  # the stream itself may be over
            stream_requests.check(read)
            require_own(read)
            self._hand_over(read, received).add_done_callback(pending.settle)
            return
        self._condition.require_ready()
        self._streams.ask(read).add_done_callback(pending.settle)

    def hear_update(self, sample: zenoh.Sample) -> None:
        """Take an update that was put for a stream; returns at once."""
        if sample.kind != zenoh.SampleKind.PUT:
            return
        try:
            self._streams.update(str(sample.key_expr), sample.payload, sample.encoding, self._allowances.ask)
        except Exception:  # Zenoh's thread must outlive it, and nobody waits for an answer
            _log.exception("an update could not be taken")

    def _require_right(self, read: keys.Query) -> None:
        """Raise NotAllowed for a query that a user may not make about another's things.

        Other users may be permitted on keys that name an owner, so even the owner can only read with them.
        """
        reading = keys.is_reading(read)
        if read.owner != read.user:
            kind, name = _thing(read)
            self._engines.stores.require_right(read.user, read.owner, kind, name, read_only=reading)
        elif read.names_owner and not (reading or keys.is_cancel(read)):
            name = f"{read.user}:{read.key[1]}"[:128]
            raise NotAllowed(f"{name!r} is for reading; to change it, name it without its owner", user=read.owner)

    def ask(self, read: keys.Query, received: float) -> Future[Answer]:
        """Have work done for a request that came otherwise than as a query on one of the keys, such as from ROS.

        Raises GuidefieldError if it isn't served, or refused by quotas or the queue.
        """
        self._meter.count("asked")
        self._pool.stand_by()  # there is more than one user
        self._allowances.ask(read.user)
        keys.check(read)
        answer = self._hand_over(read, received)
        answer.add_done_callback(partial(self._count_outcome, read.key[0], received))
        return answer

    def forget(self, client: Asker) -> None:
        """End all requests of a client that is gone."""
        ended = self._under_way.cancel_all_of(client) + self._streams.forget(client)
        if ended:
            self._meter.count("forgotten")
            _log.info("client %s of %s is gone: %d requests of it end", client.client, client.user, ended)

    def close(self) -> None:
        """Finish files that are being read, refuse those that wait, and send the remaining answers."""
        self._readers.close()
        self._pool.outbox.close(LAST_ANSWERS)

    def _count_answer(self, kind: str, received: float, end: End, what: str) -> None:
        end(what)
        self._meter.count_answer(what, kind, time.monotonic() - received)

    def _count_outcome(self, kind: str, received: float, answer: Future[Answer]) -> None:
        is_reply = answer.exception() is None and answer.result()[0]
        self._meter.count_answer("answered" if is_reply else "refused", kind, time.monotonic() - received)

    def figures(self, user: str = PLAIN) -> Figures:
        """Return the service's present counts and measures, as far as a user may see them."""
        return Figures(
            counters={**self._meter.counters(), "crashes": self._pool.crashes, **self._streams.counters},
            uptime=time.monotonic() - self._began,
            workers=self._pool.workers,
            busy=self._pool.busy,
            queue=len(self._pool.waiting),
            memory=self._pool.memory + self._streams.memory + self._memory_of_renderer(),
            streams=self._streams.open,
            latency=self._meter.latency(),
            health=self._condition.now,
            disk=disk_of(self._setup.data),
            identity=Identity(user=user, access_control=self._access_control, quota=self._setup.quotas.of(user)),
            users=self._users(user),
        )

    def _users(self, asking: str) -> dict[str, UserFigures]:
        waiting = self._pool.waiting
        return {
            user: UserFigures(
                waiting=waiting.of_user(user), running=waiting.running(user), processor=round(waiting.used(user), 3)
            )
            for user in (sorted(waiting.users()) if asking == PLAIN else [asking])
        }

    def _cancel(self, read: keys.Query) -> str:
        self._meter.count("cancels")
        kind, own = read.key[:2]
        return self._under_way.cancel((read.owner, kind, checked_name(own, f"{kind[:-1]}_id")))

    def _read_files(self, read: keys.Query) -> Answer:
        if keys.is_file(read):
            runs = self._runs.of(read.owner)
            runs.require(read.key[1])
            if keys.is_proof(read):
                return True, runs.recordings.read_proof(read.key[1])
            return True, whole_recording(runs.recordings, read.key[1])
        if keys.is_sharing(read):
            kind, name = _thing(read)
            shared = self._engines.share(read.owner, kind, name, shared="unshare" not in read.parameters)
            return True, codec.encode(shared, read.encoding)
        reply = self._engines.answer(read.user, read.owner, keys.decode_query(read))
        answer = True, codec.encode(reply, read.encoding)
        if keys.is_scene(read) and "delete" in read.parameters:
            self._tell_changed(read, SceneChanged(name=read.key[1], version=None))
        return answer

    def _hand_over(self, read: keys.Query, received: float) -> Future[Answer]:
        self._condition.require_ready()
        self._allowances.work(read.user)
        head = keys.decode_run_head(read)
        if head is None:
            return self._hand_work_over(read, received)
        run_id, allowed, encoding = head.run_id or uuid.uuid4().hex, head.allowed, read.encoding
        runs = self._runs.of(read.user)
        run = NewRun(read.user, run_id, "certify" if read.key == ("certify",) else "plan", read.payload, encoding)

        def expire(stage: expired.Stage) -> Answer:
            return True, codec.encode(expired.expired_run(run_id, head, stage), encoding)

        def cancel() -> Answer:
            return True, codec.encode(expired.cancelled_run(run_id, head, time.monotonic() - received), encoding)

        task = Task(
            Job(read, received, run_id),
            allowed + BACKSTOP,
            deadline=TimedAnswer(received + allowed, partial(expire, "queue")),
            late=_late(received, allowed, partial(expire, "load")),
            asker=read.asker,
            size=len(read.payload),
            hear=partial(self._tell_progress, read.user, run_id),
            begin=partial(runs.begin, run),
            end_late=partial(runs.drop_recording, run_id),
        )
        return self._under_way.submit(
            (read.user, "runs", run_id),
            task,
            cancel,
            words=(encoding, read.payload),
            answer=keep_answer(runs, run, task),
            kept=partial(self._answered_before, read, run_id if head.run_id else None),
        )

    def _answered_before(self, read: keys.Query, run_id: str | None) -> Future[Answer] | None:
        runs = self._runs.of(read.user)

        def answer_again() -> Answer:
            request = keys.decode_query(read)
            assert isinstance(request, MotionRequest), "it makes a run"
            return True, codec.encode(answered_before(runs, request, str(run_id)), read.encoding)

        with contextlib.suppress(DiskRefused):  # nothing is known of it then
            if run_id is not None and runs.has(run_id):
                return self._readers.submit(read.asker, answer_again)
        return None

    def _hand_work_over(self, read: keys.Query, received: float) -> Future[Answer]:
        head, encoding = keys.decode_work_head(read), read.encoding
        allowed = head.allowed

        def expire(stage: expired.Stage) -> Answer:
            return expired.error_answer(encoding, expired.expired_work(allowed, stage))

        task = Task(
            Job(read, received),
            allowed + BACKSTOP,
            deadline=TimedAnswer(received + allowed, partial(expire, "queue")),
            late=None if keys.changes_store(read) else _late(received, allowed, partial(expire, "load")),
            asker=read.asker,
            size=len(read.payload),
            is_brief=read.key == ("kinematics",) and len(read.payload) <= MAX_BRIEF_BYTES,
        )
        own = head.request_id
        name = None if own is None else (read.user, "requests", checked_name(own, "request_id"))
        words = (read.key, encoding, read.payload)
        answer = self._under_way.submit(
            name, task, lambda: expired.error_answer(encoding, expired.cancelled_work()), words
        )
        if keys.is_scene(read):
            task.add_done_callback(partial(self._tell_change, read))
        return answer

    def _tell_progress(self, user: str, run_id: str, progress: bytes) -> None:
        self._publish(f"{base_key(self._setup.instance, user)}/runs/{run_id}/progress", progress)
        if self._runs.of(user).is_shared(run_id):
            self._publish(f"{shared_key(self._setup.instance)}/runs/{user}:{run_id}/progress", progress)

    def _tell_change(self, read: keys.Query, future: Future[Answer]) -> None:
        if future.cancelled() or future.exception() is not None or not future.result()[0]:
            return
        done = codec.decode(future.result()[1], Done, read.encoding)
        self._tell_changed(read, SceneChanged(name=read.key[1], version=done.version, diff=keys.decode_diff(read)))

    def _tell_changed(self, read: keys.Query, changed: SceneChanged) -> None:
        key = f"{base_key(self._setup.instance, read.owner)}/scenes/{read.key[1]}/changes"
        self._publish(key, codec.encode(changed))


_kept_states = threading.local()


def _keep_thread_state() -> None:
    """Keep the interpreter's state of this thread of Zenoh until the thread ends.

    Otherwise a thread that the interpreter didn't start gets a new state for each call, which maps and unmaps memory:
    0.05 ms if there are many threads.
    """
    if not hasattr(_kept_states, "count"):
        _kept_states.count = ctypes.pythonapi.PyGILState_Ensure()


def _thing(read: keys.Query) -> tuple[Kind, str]:
    kinds: dict[str, Kind] = {kind: kind for kind in get_args(Kind)}
    if len(read.key) < 2 or read.key[0] not in kinds:
        raise MalformedRequest(f"nobody has anything at {'/'.join(read.key)!r}", key="/".join(read.key))
    return kinds[read.key[0]], read.key[1]


@functools.lru_cache(REMEMBERED_KEYS)
def _kind(key: str) -> str:
    chunks = f"{key}/////".split("/")
    kind = chunks[4] if chunks[2] == USERS else chunks[2]
    return kind if kind in KINDS else "other"


def _late(received: float, allowed: float, answer: Callable[[], Answer]) -> TimedAnswer:
    at = received + allowed
    return TimedAnswer(at + LATE + LATE_SHARE * allowed, answer, at + LATE_RESULT + LATE_RESULT_SHARE * allowed)
