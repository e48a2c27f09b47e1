"""The engine in a worker process, which answers queries: bytes in, bytes out."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from guidefield import logs
from guidefield.engines import Engines
from guidefield.errors import GuidefieldError, Preempted, Status, unforeseen
from guidefield.later import Later, Work
from guidefield.messages import codec, keys
from guidefield.messages.identities import PLAIN
from guidefield.messages.quotas import DEFAULT_QUOTAS, Quotas
from guidefield.messages.replies import MotionReply, error_reply
from guidefield.messages.requests import ChangeScene, MotionRequest, Request, StoreRobot, StoreScene
from guidefield.pool.process import Call
from guidefield.stores.by_user import StoresByUser
from guidefield.stores.runs import RunDatabase

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Job:
    """A query for a worker.

    Attributes:
        query: As it came.
        received: When, by `time.monotonic()`, which all processes of a machine share [s].
        run_id: What to call the run, if the query asks for one and names none.
    """

    query: keys.Query
    received: float
    run_id: str | None = None


@dataclass(frozen=True)
class EngineSetup:
    """Prepares the engine of a service, or of one of its workers.

    Attributes:
        instance: Name of the service.
        data: Folder of its runs, scenes and robots.
        log_level: How much a worker logs, to stderr.
        json_logs: Whether as JSON.
        quotas: How much room each user has.
        packages: Folders of packages from which a robot that is sent may take meshes.
        prepare: Robots that each worker prepares for their first plan before it is ready.
    """

    instance: str
    data: Path
    log_level: int = logging.INFO
    json_logs: bool = False
    packages: tuple[Path, ...] = ()
    prepare: tuple[str, ...] = ()
    quotas: Quotas = DEFAULT_QUOTAS

    def engines(self, database: RunDatabase | None = None) -> Engines:
        """Engines on the data folder; those that read runs are given their database."""
        return Engines(self.instance, StoresByUser(self.data, self.quotas, database), self.packages)

    def __call__(self) -> EngineWorker:
        """In a worker process: log, and warm an engine up."""
        logs.configure(self.log_level, json=self.json_logs)
        engines = self.engines()
        engines.of(PLAIN).warm_up(self.prepare)
        return EngineWorker(engines)


@dataclass(frozen=True)
class EngineWorker:
    """Answers jobs with the engine of their users; their recordings are written when nobody waits for an answer."""

    engines: Engines
    later: Later = field(default_factory=Later)

    def __call__(self, job: Job, call: Call) -> tuple[bool, bytes] | None:
        """Return whether it is a reply, not an error, and its bytes; None if the job was set back and ended early."""
        with self.later.answering():
            owed: list[Work] = []
            answer = self._answer(job, call, owed)
            for work in owed if answer is not None else ():  # what begins anew owes nothing
                self.later.add(work, call.owe)
            return answer

    def _answer(self, job: Job, call: Call, owed: list[Work]) -> tuple[bool, bytes] | None:
        encoding = job.query.encoding
        try:
            return self._replied(job, call, owed)
        except Preempted as error:
            if call.set_back():
                return None
            return False, codec.encode(error_reply(error), encoding)
        except GuidefieldError as error:
            return False, codec.encode(error_reply(error), encoding)
        except Exception as error:
            _log.exception("an answer could not be written")
            return False, codec.encode(error_reply(unforeseen(error)), encoding)

    def _replied(self, job: Job, call: Call, owed: list[Work]) -> tuple[bool, bytes] | None:
        query = job.query
        if keys.is_recording(query):  # of a stream; those of runs are files
            return True, self.engines.stream_recording(query.owner, query.key[1])
        request = keys.request_of(query)
        if isinstance(request, MotionRequest) and request.run_id is None:
            request = msgspec.structs.replace(request, run_id=job.run_id)
        with _from_payload(request):
            reply = self.engines.answer(
                query.user,
                query.owner,
                request,
                size=len(query.payload),
                received=job.received,
                watcher=call,
                later=owed.append,
            )
        if isinstance(reply, MotionReply) and reply.status.code == Status.PREEMPTED and call.set_back():
            self.engines.stores.of(query.owner).recordings.drop(reply.run_id)
            return None
        return True, codec.encode(reply, query.encoding)


PAYLOADS = {StoreScene: "scene", ChangeScene: "diff", StoreRobot: "files"}
"""The field of a request that is the payload that came for it."""


@contextlib.contextmanager
def _from_payload(request: Request) -> Iterator[None]:
    """Say where in its payload a fault of a request is."""
    try:
        yield
    except GuidefieldError as error:
        holder = f"$.{PAYLOADS.get(type(request), '')}"
        path = str(error.details.get("path", ""))
        if type(request) in PAYLOADS and path.startswith(holder):
            error.details["path"] = f"${path[len(holder) :]}"
        raise
