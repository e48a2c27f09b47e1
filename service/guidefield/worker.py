"""What runs in a worker process: an engine that answers queries, bytes in and bytes out."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import msgspec

from guidefield import logs
from guidefield.engine import Engine, LocalFiles
from guidefield.errors import GuidefieldError, unforeseen
from guidefield.messages import codec, keys
from guidefield.messages.replies import error_reply
from guidefield.messages.requests import MotionRequest
from guidefield.pool.process import Call
from guidefield.stores.robots import RobotStore
from guidefield.stores.runs import DEFAULT_RETENTION, Retention, RunStore
from guidefield.stores.scenes import SceneStore

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
        retention: How many runs are kept.
        packages: Folders of packages from which a robot that is sent may take meshes.
        prepare: Robots that each worker prepares for their first plan before it is ready.
    """

    instance: str
    data: Path
    log_level: int = logging.INFO
    json_logs: bool = False
    retention: Retention = DEFAULT_RETENTION
    packages: tuple[Path, ...] = ()
    prepare: tuple[str, ...] = ()

    def runs(self) -> RunStore:
        """Where its runs are kept."""
        return RunStore(self.data / "runs", self.retention)

    def engine(self) -> Engine:
        """An engine on the data folder that refuses local files."""
        return Engine(
            self.instance,
            runs=self.runs(),
            scenes=SceneStore(self.data / "scenes"),
            robots=RobotStore(self.data / "robots"),
            local_files=LocalFiles.REFUSED,
            packages=self.packages,
        )

    def __call__(self) -> EngineWorker:
        """In a worker process: log, and warm an engine up."""
        logs.configure(self.log_level, json=self.json_logs)
        engine = self.engine()
        engine.warm_up(self.prepare)
        return EngineWorker(engine)


@dataclass(frozen=True)
class EngineWorker:
    """Answers jobs with an engine."""

    engine: Engine

    def __call__(self, job: Job, call: Call) -> tuple[bool, bytes]:
        """Whether there is a reply, or else an error; and its bytes."""
        try:
            request = keys.request_of(job.query)
            if isinstance(request, MotionRequest) and request.run_id is None:
                request = msgspec.structs.replace(request, run_id=job.run_id)
            return True, codec.encode(
                self.engine.answer(request, received=job.received, watcher=call), job.query.encoding
            )
        except GuidefieldError as error:
            return False, codec.encode(error_reply(error), job.query.encoding)
        except Exception as error:
            _log.exception("an answer could not be written")
            return False, codec.encode(error_reply(unforeseen(error)), job.query.encoding)
