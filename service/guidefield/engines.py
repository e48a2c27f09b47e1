"""The engines of all users, and the worker process that answers queries with them: bytes in, bytes out.

Each user's engine has its own stores, and all share the caches of robots and scenes. The caller checks rights to an
owner's things (`endpoint/endpoint.py`); to what a request names as ``user:name`` they are checked here.

The service pickles `EngineSetup` and jobs to its workers: a new field of `Job` needs its place in `__reduce__`.
`ServiceSettings` of `endpoint/service.py` inherits the fields of `EngineSetup`.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from guidefield.deadline import Deadline, DeadlineExpired
from guidefield.engine import Engine, LocalFiles, SharedCaches
from guidefield.errors import GuidefieldError, MalformedRequest, Preempted, Status, UnknownObject, convert_exception
from guidefield.memory import ENGINES, BoundedMap
from guidefield.messages import codec, keys, requests
from guidefield.messages.identities import DEFAULT_QUOTAS, PLAIN, USERS, Quotas
from guidefield.messages.replies import Done, MotionReply, RobotsReply, ScenesReply, make_error_reply
from guidefield.messages.requests import ChangeScene, MotionRequest, PlanRequest, Request, StoreRobot, StoreScene
from guidefield.messages.values import Reply
from guidefield.pool.process import Call
from guidefield.rendering import LARGEST_RECORDING, Renderings, whole_recording
from guidefield.run import Watcher
from guidefield.stores.by_user import Kind, StoresByUser
from guidefield.stores.runs import RunDatabase
from guidefield.system import configure_logging


class Engines:
    """Engines of all users of a service; requests that name local files are refused.

    If stores are only read, by a command that replays earlier runs, no recording is kept, and local files are allowed:
    the person who reads all users' stores owns the machine's files.
    """

    def __init__(
        self, instance: str, stores: StoresByUser, packages: Sequence[Path] = (), viewer: str | None = None
    ) -> None:
        self.stores = stores
        self._instance, self._packages, self._viewer = instance, tuple(packages), viewer
        self._loaded = SharedCaches(self._packages)
        self._engines = BoundedMap[str, Engine](ENGINES)

    def of(self, user: str) -> Engine:
        """Return the engine of a user; raises QuotaExceeded if too many users have something stored already."""
        return self._engines.find(user, lambda: self._make_engine(user), lambda _: 0)

    def answer(
        self,
        asking: str,
        owner: str,
        request: requests.Request,
        *,
        size: int = 0,
        received: float | None = None,
        watcher: Watcher | None = None,
    ) -> Reply:
        """Answer one request about things of an owner; the caller has checked the right to them.

        Raises GuidefieldError as `Engine.answer`; QuotaExceeded if the owner has no space for it.
        """
        if isinstance(request, requests.StoreScene | requests.ChangeScene | requests.StoreRobot):
            self.stores.require_room(owner, size)
        reply = self.of(owner).answer(request, received=received or time.monotonic(), watcher=watcher)
        if isinstance(request, requests.DeleteScene):
            self.stores.of(owner).shared.remove("scenes", request.name)
        elif isinstance(request, requests.DeleteRobot):
            self.stores.of(owner).shared.remove("robots", request.name)
        return self._add_shared(asking, owner, reply)

    def render(self, owner: str, run_id: str) -> None:
        """Render the recording of a run from its log, if it has only a log; raises OSError if the disk refuses."""
        self._renderings.render(self.stores.of(owner).recordings, run_id)

    def recording(self, owner: str, run_id: str) -> bytes:
        """Return the self-contained recording of a run, rendered if it has only a log.

        Raises UnknownObject if there is none, or it is damaged; raises OSError if the disk refuses.
        """
        self.render(owner, run_id)
        return whole_recording(self.stores.of(owner).recordings, run_id)

    @functools.cached_property
    def _renderings(self) -> Renderings:
        return Renderings({self._loaded.packages: self._loaded.catalog}, self._loaded.scenes)

    def share(self, owner: str, kind: Kind, name: str, *, shared: bool) -> Done:
        """Share a thing with all users, or end that; raises GuidefieldError if there is no such thing."""
        stores = self.stores.of(owner)
        if kind == "runs":
            stores.runs.share(name, shared=shared)
        else:
            if kind == "scenes":
                stores.scenes.read(name)
            elif stores.robots.find(name) is None:
                self.of(owner).answer(requests.ReadRobot(name))
            (stores.shared.add if shared else stores.shared.remove)(kind, name)
        if shared:
            return Done(done=f"{kind.removesuffix('s')} {name!r} can be read by everybody, as {f'{owner}:{name}'!r}")
        return Done(done=f"{kind.removesuffix('s')} {name!r} can be read by nobody else any more")

    def stream_recording(self, owner: str, name: str) -> bytes:
        """Make the recording of a stored stream from all files of its journal.

        Raises UnknownObject if there is none of that name, or no update yet, or it is damaged or too large;
        GuidefieldError if its robot or scene is refused now; OSError if the disk refuses.
        """
        from guidefield.stream import journal
        from guidefield.stream.shown import render

        files = journal.kept_files(self.stores.streams_of(owner), name)
        try:
            recording = render(files, self.of(owner).stream)
        except MalformedRequest as error:
            raise UnknownObject(f"stream {name!r} has no recording: {error.message}", stream=name) from None
        if len(recording) > LARGEST_RECORDING:
            raise UnknownObject(
                f"the recording of stream {name!r} has {len(recording)} bytes, at most {LARGEST_RECORDING} are sent: at"
                f" the service `guidefield runs export {name} stream.rrd` writes it, `guidefield replay FILE --record"
                " stream.rrd` that of a single file of it",
                stream=name,
            )
        return recording

    def _make_engine(self, user: str) -> Engine:
        stores = self.stores.of(user)
        return Engine(
            self._instance if user == PLAIN else f"{self._instance}/{USERS}/{user}",
            runs=stores.runs,
            recordings=None if self.stores.reading else stores.recordings,
            scenes=stores.scenes,
            robots=stores.robots,
            local_files=LocalFiles.ALLOWED if self.stores.reading else LocalFiles.REFUSED,
            packages=self._packages,
            loaded=self._loaded,
            lend=partial(self._lend, user),
            viewer=self._viewer,
        )

    def _lend(self, asking: str, kind: Kind, owner: str, name: str) -> Engine:
        self.stores.require_right(asking, owner, kind, name, read_only=True)
        return self.of(owner)

    def _add_shared(self, asking: str, owner: str, reply: Reply) -> Reply:
        if isinstance(reply, ScenesReply):
            return ScenesReply(scenes=[*reply.scenes, *self._list_shared_names(asking, owner, "scenes")])
        if isinstance(reply, RobotsReply):
            names = self._list_shared_names(asking, owner, "robots")
            return RobotsReply(robots=[*reply.robots, *self.of(owner).summaries(names)])
        return reply

    def _list_shared_names(self, asking: str, owner: str, kind: Kind) -> list[str]:
        found = []
        for other in self._list_other_users(owner):
            stores = self.stores.of(other)
            names = stores.scenes.stored() if kind == "scenes" else stores.robots.names()
            found += [f"{other}:{name}" for name in names if self.stores.may_read(asking, other, kind, name)]
        return found

    def _list_other_users(self, owner: str) -> list[str]:
        return [user for user in (PLAIN, *self.stores.users()) if user != owner]


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
        configure_logging(self.log_level, json=self.json_logs)
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
