"""Queries in, exactly one answer out to each of them.

Theory of operation. One queryable serves every key of the instance, so that a query on any key, known or not, has one
answerer. Zenoh calls it in the thread of the link that a query came by, so that a flood on one link holds up no other.
It only sorts: what needs a robot, obstacle geometry or a kernel goes to the pool of workers; what reads or deletes
files goes to a few threads here; the rest is answered at once, or ends a run early. Whoever settles a query does so
through `Asked`, which answers once and only once, whatever happens; the answer goes out by a thread of the `Outbox`, so
that whoever doesn't read holds up nobody.
"""

from __future__ import annotations

import contextlib
import logging
import time
import uuid
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import get_args

import zenoh

from guidefield.endpoint.allowances import Allowances
from guidefield.endpoint.asked import Asked
from guidefield.endpoint.condition import Condition
from guidefield.endpoint.kept_answers import keep_answer
from guidefield.endpoint.meter import Meter
from guidefield.endpoint.promised import Promised, Settled
from guidefield.endpoint.readers import Readers
from guidefield.endpoint.streams import Streams, require_own
from guidefield.endpoint.tracing import End, Trace, no_trace
from guidefield.endpoint.under_way import UnderWay
from guidefield.engines import Engines
from guidefield.errors import DiskRefused, MalformedRequest, NotAllowed, ServerBusy
from guidefield.handlers.expired import (
    Stage,
    cancelled_run,
    cancelled_work,
    error_answer,
    expired_run,
    expired_work,
)
from guidefield.handlers.info import Figures, Rules, brief_info, disk_of, info
from guidefield.messages import codec, keys, stream_keys
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN, USERS, Asker, base_key, shared_key
from guidefield.messages.quotas import DEFAULT_QUOTAS, Quotas
from guidefield.messages.replies import Done, Health, Identity, UserFigures
from guidefield.messages.requests import MotionRequest
from guidefield.messages.scene_changes import SceneChanged
from guidefield.pool.pool import Pool
from guidefield.pool.waiting import BACKSTOP, Answer, Task, TimedAnswer
from guidefield.run import whole_recording
from guidefield.stores.files import checked_name
from guidefield.stores.run_rows import NewRun
from guidefield.stores.runs import RunDatabase, UserRuns, answered_before
from guidefield.stores.shared import Kind
from guidefield.worker import Job

_log = logging.getLogger(__name__)

HEAVY_KEYS = ("plan", "certify", "kinematics", "robots")
"""What needs a worker; and so does any other query with a payload."""
KINDS = ("plan", "certify", "kinematics", "robots", "scenes", "runs", "streams", "info")
"""What queries are timed under, by the first chunk of their key."""
LATE, LATE_SHARE = 0.02, 0.03
"""How much later than its time a request is answered that is still loaded for [s], and by which share of its time."""
LAST, LAST_SHARE = 0.04, 0.045
"""The same for any request: a worker that minds its time by itself gets so much to say what it has found."""
BRIEF = 1 << 14
"""A query of kinematics that is longer may take long [bytes]."""
LAST_ANSWERS = 5.0
"""How long the last answers may take to be read at the end [s]."""


class Endpoint:
    """Sorts queries and answers them.

    Args:
        instance: Name of the service.
        engines: Answer what needs no worker.
        runs: Where runs are kept.
        pool: Answers the rest; jobs are `worker.Job`.
        publish: Publishes JSON on a key.
        trace: Begins the trace of each query.
        condition: How the service is; None: ready.
        data: Folder whose disk is told of.
        rules: What the service keeps to, as `info` tells it.
        quotas: What each user may have.
        access_control: Whether the configuration keeps users to their own keys.
        streams: Where streams are kept; None: there are none.
    """

    def __init__(
        self,
        instance: str,
        engines: Engines,
        runs: RunDatabase,
        pool: Pool,
        publish: Callable[[str, bytes], None],
        trace: Trace = no_trace,
        condition: Condition | None = None,
        data: Path | None = None,
        rules: Rules | None = None,
        quotas: Quotas = DEFAULT_QUOTAS,
        access_control: bool = False,
        streams: Streams | None = None,
    ) -> None:
        self._instance = instance
        self._engines, self._runs = engines, runs
        self._pool = pool
        self._streams = streams
        self._publish = publish
        self._trace = trace
        self._condition = condition
        self._data = data
        self._rules = rules or Rules()
        self._under_way = UnderWay(pool)
        self._readers = Readers()
        self._quotas, self._access_control = quotas, access_control
        self._allowances = Allowances(quotas, pool.waiting)
        self._meter = Meter()
        self._began = time.monotonic()

    def receive(self, query: zenoh.Query) -> None:
        """Take a query; returns at once, and whatever happens the query is answered."""
        received = time.monotonic()
        key = str(query.key_expr)
        end = self._trace(_kind(key), key)
        count = partial(self._count_answer, _kind(key), received, end)
        asked = Asked(query, self._instance, count, self._pool.outbox.post)
        self._meter.count("asked")
        with asked.answering_failures():
            read = asked.read(self._let_in)
            if stream_keys.is_stream(read):
                self._ask_stream(asked, read, received)
                return
            keys.check(read)
            self._require_right(read)
            if read.key == ("info",):
                figures = self.figures(read.user)
                reply = brief_info(figures) if keys.is_brief(read) else info(figures, self._rules)
                asked.answer((True, codec.encode(reply, read.encoding)))
            elif keys.is_cancel(read):
                asked.answer((True, codec.encode(Done(done=self._cancel(read)), read.encoding)))
            elif not keys.is_sharing(read) and (read.key[0] in HEAVY_KEYS or read.payload or self._is_owed(read)):
                self._hand_over(asked, read, received)
            else:
                self._look_up(asked, read)

    def _is_owed(self, read: keys.Query) -> bool:
        """Whether a query asks for a run's recording that isn't rendered yet: a worker does it."""
        if not keys.is_recording(read):
            return False
        return self._runs.of(read.owner).recordings.is_owed(read.key[1])

    def _let_in(self, told: keys.Query, size: int) -> None:
        """Refuse a user's query, with a payload of a size [bytes], if the user has no more of its quota."""
        if told.user != PLAIN:
            self._pool.stand_by()
        if not keys.is_cancel(told):  # that gives something back
            self._allowances.ask(told.user, size, lists=keys.is_list(told))

    def _ask_stream(self, asked: Asked, read: keys.Query, received: float) -> None:
        if keys.is_recording(read):  # the stream itself may be over
            stream_keys.check(read)
            require_own(read)
            self._hand_over(asked, read, received)
            return
        if self._streams is None:
            raise ServerBusy("this service takes no streams")
        if self._condition is not None:
            self._condition.require_ready()
        self._streams.ask(read).add_done_callback(asked.settle)

    def hear_update(self, sample: zenoh.Sample) -> None:
        """Take what somebody put for a stream; returns at once."""
        if self._streams is None or sample.kind != zenoh.SampleKind.PUT:
            return
        try:
            self._streams.update(str(sample.key_expr), sample.payload, sample.encoding, self._allowances.ask)
        except Exception:  # Zenoh's thread must outlive it, and nobody waits for an answer
            _log.exception("an update could not be taken")

    def _require_right(self, read: keys.Query) -> None:
        """Refuse what a user may not do with what is another's.

        Keys that name an owner are open to onlookers, too, so there its own things are for reading alone.
        """
        reading = keys.is_reading(read)
        if read.owner != read.user:
            kind, name = _thing(read)
            self._engines.stores.require_right(read.user, read.owner, kind, name, read_only=reading)
        elif read.names_owner and not (reading or keys.is_cancel(read)):
            told = f"{read.user}:{read.key[1]}"[:128]
            raise NotAllowed(f"{told!r} is for reading; to change it, name it without its owner", user=read.owner)

    def ask(self, read: keys.Query, received: float) -> Future[Answer]:
        """Have work done that was asked for in another way than by a query on one of the keys.

        Args:
            read: What a query would say.
            received: When it was asked, by `time.monotonic()` [s].

        Raises:
            GuidefieldError: if nothing such is served, or it can't wait its turn.
        """
        self._meter.count("asked")
        self._pool.stand_by()  # there are others beside the keys
        self._allowances.ask(read.user)
        keys.check(read)
        promised = Promised(partial(self._count_answer, read.key[0], received, _untraced))
        self._hand_over(promised, read, received)
        return promised.answer

    def forget(self, client: Asker) -> None:
        """End whatever a client asked for that is gone."""
        ended = self._under_way.cancel_all_of(client)
        ended += 0 if self._streams is None else self._streams.forget(client)
        if ended:
            self._meter.count("forgotten")
            _log.info("client %s of %s is gone: %d requests of it end", client.client, client.user, ended)

    def close(self) -> None:
        """Answer what is being read, refuse what waits to be, and send what waits to be sent."""
        self._readers.close()
        self._pool.outbox.close(LAST_ANSWERS)

    def _count_answer(self, kind: str, received: float, end: End, what: str) -> None:
        end(what)
        self._meter.count(what)
        self._meter.time(kind, time.monotonic() - received)

    def figures(self, user: str = PLAIN) -> Figures:
        """What it counts and measures, as it stands now, and as a user may see it."""
        return Figures(
            counters={
                **self._meter.counters(),
                "crashes": self._pool.crashes,
                **({} if self._streams is None else self._streams.counters),
            },
            uptime=time.monotonic() - self._began,
            workers=self._pool.workers,
            busy=self._pool.busy,
            queue=self._pool.queue,
            memory=self._pool.memory + (0 if self._streams is None else self._streams.memory),
            streams=0 if self._streams is None else self._streams.open,
            latency=self._meter.latency(),
            health=Health() if self._condition is None else self._condition.now,
            disk=None if self._data is None else disk_of(self._data),
            identity=Identity(user=user, access_control=self._access_control, quota=self._quotas.of(user)),
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

    def _look_up(self, asked: Asked, read: keys.Query) -> None:
        task = self._readers.submit(read.asker, partial(self._read_files, read))
        task.add_done_callback(asked.settle)

    def _read_files(self, read: keys.Query) -> Answer:
        if keys.is_recording(read):
            runs = self._runs.of(read.owner)
            runs.require(read.key[1])
            return True, whole_recording(runs.recordings, read.key[1])
        if keys.is_sharing(read):
            kind, name = _thing(read)
            shared = self._engines.share(read.owner, kind, name, shared="unshare" not in read.parameters)
            return True, codec.encode(shared, read.encoding)
        reply = self._engines.answer(read.user, read.owner, keys.request_of(read))
        answer = True, codec.encode(reply, read.encoding)
        if keys.is_scene(read) and "delete" in read.parameters:
            self._tell_changed(read, SceneChanged(name=read.key[1], version=None))
        return answer

    def _hand_over(self, asked: Settled, read: keys.Query, received: float) -> None:
        if self._condition is not None:
            self._condition.require_ready()
        self._allowances.work(read.user)
        head = keys.run_head(read)
        size = len(read.payload)
        if head is None:
            self._hand_work_over(asked, read, received)
            return
        run_id = head.run_id or uuid.uuid4().hex
        runs = self._runs.of(read.user)
        run = NewRun(read.user, run_id, "certify" if read.key == ("certify",) else "plan", read.payload, read.encoding)
        task = Task(
            Job(read, received, run_id),
            head.allowed + BACKSTOP,
            deadline=TimedAnswer(received + head.allowed, partial(_expired, run_id, head, "queue", read.encoding)),
            late=_late(received, head.allowed, partial(_expired, run_id, head, "load", read.encoding)),
            asker=read.asker,
            size=size,
            hear=partial(self._tell_progress, read.user, run_id),
            begin=partial(runs.begin, run),
        )
        self._under_way.submit(
            (read.user, "runs", run_id),
            task,
            cancelled=partial(_cancelled, run_id, head, read.encoding, received),
            words=(read.encoding, read.payload),
            answer=keep_answer(runs, run, task),
            kept=partial(self._answered_before, read, run_id if head.run_id else None),
        ).add_done_callback(asked.settle)

    def _answered_before(self, read: keys.Query, run_id: str | None) -> Future[Answer] | None:
        """The answer to come of a run that has ended, if there is one of that name."""
        runs = self._runs.of(read.user)
        with contextlib.suppress(DiskRefused):  # nothing is known of it then
            if run_id is not None and runs.has(run_id):
                return self._readers.submit(read.asker, partial(_answer_again, runs, run_id, read))
        return None

    def _hand_work_over(self, asked: Settled, read: keys.Query, received: float) -> None:
        """Have something done that makes no run."""
        head = keys.work_head(read)
        told = partial(error_answer, read.encoding)
        late = _late(received, head.allowed, partial(told, expired_work(head.allowed, "load")))
        task = Task(
            Job(read, received),
            head.allowed + BACKSTOP,
            deadline=TimedAnswer(received + head.allowed, partial(told, expired_work(head.allowed, "queue"))),
            late=None if keys.changes_store(read) else late,
            asker=read.asker,
            size=len(read.payload),
            is_brief=read.key == ("kinematics",) and len(read.payload) <= BRIEF,
        )
        own = head.request_id
        name = None if own is None else (read.user, "requests", checked_name(own, "request_id"))
        words = (read.key, read.encoding, read.payload)
        self._under_way.submit(name, task, partial(told, cancelled_work()), words).add_done_callback(asked.settle)
        if keys.is_scene(read):
            task.add_done_callback(partial(self._tell_change, read))

    def _tell_progress(self, user: str, run_id: str, told: bytes) -> None:
        """Publish how far a run is, for everybody if its user shares it."""
        self._publish(f"{base_key(self._instance, user)}/runs/{run_id}/progress", told)
        if self._runs.of(user).is_shared(run_id):
            self._publish(f"{shared_key(self._instance)}/runs/{user}:{run_id}/progress", told)

    def _tell_change(self, read: keys.Query, future: Future[Answer]) -> None:
        """Publish that a scene was stored or changed."""
        if future.cancelled() or future.exception() is not None or not future.result()[0]:
            return
        done = codec.decode(future.result()[1], Done, read.encoding)
        self._tell_changed(read, SceneChanged(name=read.key[1], version=done.version, diff=keys.diff_of(read)))

    def _tell_changed(self, read: keys.Query, told: SceneChanged) -> None:
        self._publish(f"{base_key(self._instance, read.owner)}/scenes/{read.key[1]}/changes", codec.encode(told))


def _thing(read: keys.Query) -> tuple[Kind, str]:
    """What a query is about that somebody may have.

    Raises:
        MalformedRequest: if its key names nothing of that kind.
    """
    kinds: dict[str, Kind] = {kind: kind for kind in get_args(Kind)}
    if len(read.key) < 2 or read.key[0] not in kinds:
        raise MalformedRequest(f"nobody has anything at {'/'.join(read.key)!r}", key="/".join(read.key))
    return kinds[read.key[0]], read.key[1]


def _untraced(_what: str) -> None:
    pass


def _kind(key: str) -> str:
    """What a query's time is counted under."""
    chunks = f"{key}/////".split("/")
    kind = chunks[4] if chunks[2] == USERS else chunks[2]
    return kind if kind in KINDS else "other"


def _answer_again(runs: UserRuns, run_id: str, read: keys.Query) -> Answer:
    """What a run was answered that has ended; MalformedRequest if its request was another one."""
    request = keys.request_of(read)
    assert isinstance(request, MotionRequest), "it makes a run"
    return True, codec.encode(answered_before(runs, request, run_id), read.encoding)


def _cancelled(run_id: str, head: keys.RunHead, encoding: Encoding, received: float) -> Answer:
    return True, codec.encode(cancelled_run(run_id, head, time.monotonic() - received), encoding)


def _late(received: float, allowed: float, answer: Callable[[], Answer]) -> TimedAnswer:
    """What is answered in place of a worker that is late, and when."""
    at, at_last = (later + share * allowed for later, share in ((LATE, LATE_SHARE), (LAST, LAST_SHARE)))
    return TimedAnswer(received + allowed + at, answer, received + allowed + at_last)


def _expired(run_id: str, head: keys.RunHead, stage: Stage, encoding: Encoding) -> Answer:
    return True, codec.encode(expired_run(run_id, head, stage), encoding)
