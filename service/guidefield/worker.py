"""The engine in a worker process, which answers queries: bytes in, bytes out.

The service pickles `EngineSetup` and jobs to its workers: a new field of `Job` needs its place in `__reduce__`.
`ServiceSettings` of `endpoint/service.py` inherits the fields of `EngineSetup`.
"""

from __future__ import annotations

import contextlib
import logging
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from guidefield import logs
from guidefield.deadline import Deadline, DeadlineExpired
from guidefield.engine import Engine
from guidefield.engines import Engines
from guidefield.errors import GuidefieldError, Preempted, Status, convert_exception
from guidefield.messages import codec, keys
from guidefield.messages.identities import DEFAULT_QUOTAS, PLAIN, Quotas
from guidefield.messages.replies import MotionReply, make_error_reply
from guidefield.messages.requests import ChangeScene, MotionRequest, PlanRequest, Request, StoreRobot, StoreScene
from guidefield.pool.process import Call
from guidefield.stores.by_user import StoresByUser
from guidefield.stores.runs import RunDatabase

MAX_PREPARATION_S = 120.0  # longest time for which a robot is prepared further after a reply [s]

_log = logging.getLogger(__name__)


class Job(msgspec.Struct, frozen=True):
    """A query for a worker."""

    query: keys.Query  # as it came
    received: float  # when, by `time.monotonic()`, which all processes of a machine share [s]
    run_id: str | None = None  # what to call the run, if the query asks for one and names none

    def __reduce__(self) -> tuple[Any, ...]:
        return Job, (self.query, self.received, self.run_id)


@dataclass(frozen=True)
class EngineSetup:
    """Prepares the engine of a service, or of one of its workers."""

    data: Path  # folder of its runs, scenes and robots
    instance: str = "local"  # name of the service, the second chunk of its keys
    log_level: int = logging.INFO  # how much a worker logs, to stderr
    json_logs: bool = False  # whether as JSON
    packages: tuple[Path, ...] = ()  # folders of packages from which a robot that is sent may take meshes
    prepare: tuple[str, ...] = ()  # robots that each worker prepares for their first plan before it is ready
    quotas: Quotas = DEFAULT_QUOTAS  # what each user may have
    eager_recordings: bool = False  # whether a worker renders each recording after its reply; else `renderer.py` does
    viewer: str | None = None  # address of a running Rerun viewer that shows runs and streams; None: none

    def engines(self, database: RunDatabase | None = None) -> Engines:
        """Return the engines on the data folder; commands that read runs give their database."""
        return Engines(self.instance, StoresByUser(self.data, self.quotas, database), self.packages, self.viewer)

    def __call__(self) -> EngineWorker:
        """In a worker process: log, and warm an engine up."""
        logs.configure(self.log_level, json=self.json_logs)
        engines = self.engines()
        engines.of(PLAIN).warm_up(self.prepare, self.eager_recordings)
        return EngineWorker(engines, self.eager_recordings)


@dataclass(frozen=True)
class EngineWorker:
    """Answers jobs with the engine of their users."""

    engines: Engines
    eager: bool = False

    def __call__(self, job: Job, call: Call) -> tuple[bool, bytes] | None:
        """Return whether it is a reply, not an error, and its bytes; None if the job was set back and ended early."""
        encoding = job.query.encoding
        try:
            return self._reply(job, call)
        except Exception as error:
            converted = convert_exception(error)
            if converted is not error:
                _log.exception("an answer could not be written")
            if isinstance(converted, Preempted) and call.set_back():
                return None
            return False, codec.encode(make_error_reply(converted), encoding)

    def _reply(self, job: Job, call: Call) -> tuple[bool, bytes] | None:
        query = job.query
        if keys.is_recording(query):
            of_run = query.key[0] == "runs"
            recording = self.engines.recording if of_run else self.engines.stream_recording
            return True, recording(query.owner, query.key[1])
        request = keys.decode_query(query)
        if isinstance(request, MotionRequest) and request.run_id is None:
            request = msgspec.structs.replace(request, run_id=job.run_id)
        size = len(query.payload)
        try:
            reply = self.engines.answer(
                query.user, query.owner, request, size=size, received=job.received, watcher=call
            )
        except GuidefieldError as error:
            _place_in_payload(error, request)
            raise
        if isinstance(reply, MotionReply) and reply.status.code == Status.PREEMPTED and call.set_back():
            self.engines.stores.of(query.owner).recordings.drop(reply.run_id)
            return None
        if isinstance(request, PlanRequest) and isinstance(reply, MotionReply) and _ended_loading(reply):
            call.defer_optional(partial(_go_on_preparing, self.engines.of(query.user), request, call))
        if self.eager and isinstance(reply, MotionReply) and reply.recording is not None:
            call.defer_required(partial(self._render, query.owner, reply.run_id))
        return True, codec.encode(reply, query.encoding)

    def _render(self, owner: str, run_id: str) -> None:
        try:
            self.engines.render(owner, run_id)
        except Exception:
            _log.exception("the recording of run %s could not be rendered; its log is kept", run_id)


def _go_on_preparing(engine: Engine, request: PlanRequest, call: Call) -> None:
    """Prepare what a plan had no time for, until the next query; the part that was begun is finished."""
    with contextlib.suppress(DeadlineExpired, GuidefieldError):  # the next request goes on, or says why it can't
        engine.prepare(request, Deadline(time.monotonic() + MAX_PREPARATION_S, call.is_awaited))


def _ended_loading(reply: MotionReply) -> bool:
    """Return whether a plan's time was up while something was loaded or prepared for it."""
    return reply.status.code == Status.TIMED_OUT and reply.status.details.get("stage") == "load"


PAYLOADS = {StoreScene: "scene", ChangeScene: "diff", StoreRobot: "files"}
"""The field of a request that is the payload that came for it."""


def _place_in_payload(error: GuidefieldError, request: Request) -> None:
    """Say where in its payload the fault of a request is."""
    holder = f"$.{PAYLOADS.get(type(request), '')}"
    path = str(error.details.get("path", ""))
    if type(request) in PAYLOADS and path.startswith(holder):
        error.details["path"] = f"${path[len(holder) :]}"
