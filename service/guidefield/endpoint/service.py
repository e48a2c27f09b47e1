"""A service from its start to its end: alone under its name, workers warm, then open for queries until told to stop."""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import zenoh

from guidefield.endpoint.clients import Clients
from guidefield.endpoint.condition import Condition
from guidefield.endpoint.endpoint import Endpoint
from guidefield.endpoint.tracing import Trace, exporting_provider, no_trace, opentelemetry_trace
from guidefield.errors import WorkerCrashed, without_source
from guidefield.first_start import compile_kernels
from guidefield.messages import codec
from guidefield.messages.replies import error_reply
from guidefield.pool.pool import DEFAULT_MEMORY, Pool
from guidefield.pool.waiting import Limits
from guidefield.stores.files import checked_name
from guidefield.stores.runs import DEFAULT_RETENTION, Retention
from guidefield.worker import EngineSetup

_log = logging.getLogger(__name__)

DEFAULT_LISTEN = "tcp/127.0.0.1:7447"
READ_WITHIN = 15_000_000
"""How long an answer may take to be read, beside what the system keeps of it, before its link is ended [us]."""
RUNTIME = "(rx: (worker_threads: 32), tx: (worker_threads: 4), net: (worker_threads: 4), app: (worker_threads: 4))"
"""Zenoh's threads, unless the variable ZENOH_RUNTIME says otherwise.

Zenoh blocks one of those that receive, for up to `READ_WITHIN`, where a link ends to which something is still being
sent; of two, the default, the other links would end, too.
"""
UNLESS_TOLD = {
    "scouting/multicast/enabled": "false",
    "scouting/gossip/enabled": "false",
    "transport/link/tx/lease": "2000",  # [ms]; a cut link is noticed after it
    "transport/link/tx/queue/congestion_control/block/wait_before_close": str(READ_WITHIN),
    "transport/link/rx/max_message_size": str(4 * codec.MAX_REQUEST_BYTES),
}
"""What holds where the configuration leaves Zenoh's own: nobody is looked for, and nothing is read without end.

Zenoh drops a message above its limit without a word, so the limit is some times that of a payload: what is between them
is refused with an answer.
"""
ANSWERS_WITHIN = 5.0
"""How long a service of the same name may take to say that it is alive [s]; where there is none it takes no time."""
PATIENCE = 0.2
"""How often a start looks whether it is to be given up [s]."""


class CannotServe(RuntimeError):
    """The service can't start; says why in one sentence."""


@dataclass(frozen=True)
class ServiceSettings:
    """How a service runs.

    Attributes:
        data: Folder of its runs, scenes and robots.
        instance: Its name, the second chunk of its keys.
        listen: Zenoh endpoints; None takes the configuration's, or else a loopback port.
        config: Zenoh configuration file.
        workers: Number of worker processes.
        queue_limit: How many requests may wait for one; a single client may have half of them.
        memory: A worker that takes more is stopped [bytes].
        retention: How many runs are kept.
        json_logs: Whether its workers log JSON.
        otel: Whether queries are traced with OpenTelemetry.
        grace: How long requests that are being worked on may take at the end [s]; then plans are ended early.
        packages: Folders of packages from which a robot that a client sends may take meshes.
        prepare: Robots that are prepared for their first plan before the service is ready.
    """

    data: Path
    instance: str = "local"
    listen: tuple[str, ...] | None = None
    config: Path | None = None
    workers: int = 2
    queue_limit: int = 64
    memory: int = DEFAULT_MEMORY
    retention: Retention = DEFAULT_RETENTION
    json_logs: bool = False
    otel: bool = False
    grace: float = 10.0
    packages: tuple[Path, ...] = ()
    prepare: tuple[str, ...] = ()


def serve(settings: ServiceSettings, stop: threading.Event, announce: Callable[[str], None] = _log.info) -> None:
    """Serve until told to stop; then finish what is being worked on, refuse what waits, and leave.

    Args:
        settings: How.
        stop: Set by whoever wants it to end.
        announce: Is told, in one sentence each, how the start goes; the last begins with "ready".

    Raises:
        MalformedRequest: if its name can't be one.
        CannotServe: if a service of that name is alive, on this data folder or on the network; if the configuration is
            wrong, or an endpoint can't be listened on; if the workers can't be prepared.
    """
    checked_name(settings.instance, "instance")
    setup = EngineSetup(
        settings.instance,
        settings.data,
        _log.getEffectiveLevel(),
        json_logs=settings.json_logs,
        retention=settings.retention,
        packages=settings.packages,
        prepare=settings.prepare,
    )
    config = session_config(settings)
    os.environ.setdefault("ZENOH_RUNTIME", RUNTIME)  # read when the first session is opened
    with contextlib.ExitStack() as opened:
        opened.enter_context(_alone_in(settings.data))
        session = opened.enter_context(_opened(config))
        trace = _trace(settings, opened)
        _require_no_other(session, settings.instance)
        starting = session.liveliness().declare_token(f"guidefield/{settings.instance}/starting")
        runs = setup.runs()
        runs.sweep(error_reply(WorkerCrashed("the service stopped while it worked on this run")))
        limits = Limits(tasks=settings.queue_limit, tasks_of_client=(settings.queue_limit + 1) // 2)
        pool = Pool(setup, workers=settings.workers, limits=limits, memory=settings.memory)
        condition, publish = Condition(), partial(_publish, session)
        endpoint = Endpoint(settings.instance, setup.engine(), runs, pool, publish, trace, condition, settings.data)
        opened.enter_context(session.declare_queryable(f"guidefield/{settings.instance}/**", endpoint.receive))
        opened.callback(endpoint.close)
        opened.callback(Clients(session, settings.instance, endpoint.forget).close)
        opened.callback(pool.close, settings.grace)
        opened.callback(condition.end, f"what is being worked on is finished, within {settings.grace:g} s")
        announce(f"starting (workers: {settings.workers})")
        if not _started(settings, pool, condition, announce, stop):
            return
        starting.undeclare()
        opened.enter_context(session.liveliness().declare_token(_alive(settings.instance)))
        announce(f"ready: instance {settings.instance!r} answers at {config.get_json('listen/endpoints')}")
        stop.wait()
        announce("stopping: what is being worked on is finished, what waits is refused")


def session_config(settings: ServiceSettings) -> zenoh.Config:
    """The file's configuration; loopback only and no scouting where it doesn't say otherwise.

    Raises:
        CannotServe: if the file can't be read, or something in it or in the endpoints is wrong.
    """
    try:
        config = zenoh.Config() if settings.config is None else zenoh.Config.from_file(str(settings.config))
        if settings.listen is not None:
            _listen(config, settings.listen)
        elif config.get_json("listen/endpoints") == zenoh.Config().get_json("listen/endpoints"):
            config.insert_json5("listen/endpoints", json.dumps([DEFAULT_LISTEN]))
        for key, value in UNLESS_TOLD.items():
            if config.get_json(key) == zenoh.Config().get_json(key):
                config.insert_json5(key, value)
    except zenoh.ZError as error:
        file = "" if settings.config is None else f" {str(settings.config)!r}"
        raise CannotServe(f"the Zenoh configuration{file} is wrong: {without_source(error)}") from None
    return config


def _listen(config: zenoh.Config, endpoints: tuple[str, ...]) -> None:
    try:
        config.insert_json5("listen/endpoints", json.dumps(list(endpoints)))
    except zenoh.ZError:
        raise CannotServe(f"endpoints are written like {DEFAULT_LISTEN}, got {', '.join(endpoints)}") from None


def _trace(settings: ServiceSettings, opened: contextlib.ExitStack) -> Trace:
    if not settings.otel:
        return no_trace
    try:
        provider = exporting_provider(settings.instance)
    except ImportError:
        raise CannotServe("traces need OpenTelemetry: pip install 'guidefield[otel]'") from None
    opened.callback(provider.shutdown)
    return opentelemetry_trace(provider)


def _started(
    settings: ServiceSettings, pool: Pool, condition: Condition, announce: Callable[[str], None], stop: threading.Event
) -> bool:
    """Whether the pool became ready before it was told to stop; the condition says meanwhile what is done.

    The kernels are compiled before the workers load them: each would compile them all.
    """

    def told(sentence: str) -> None:
        condition.start(sentence)
        announce(sentence)

    try:
        compile_kernels(told, stop.is_set)
        robots = f", and prepares {', '.join(settings.prepare)}" if settings.prepare else ""
        condition.start(f"the first of {settings.workers} workers loads the planner{robots}")
        pool.start()
        while not pool.ready(PATIENCE):
            if stop.is_set():
                return False
    except RuntimeError as error:
        raise CannotServe(str(error)) from None
    condition.be_ready()
    return True


def _opened(config: zenoh.Config) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        where = config.get_json("listen/endpoints")
        raise CannotServe(f"Zenoh can't be opened at {where}: {without_source(error)}") from None


def _publish(session: zenoh.Session, key: str, payload: bytes) -> None:
    try:
        session.put(key, payload, encoding=codec.Encoding.JSON.value)
    except zenoh.ZError:  # nobody hears it then; the run goes on
        _log.exception("progress could not be published")


def _alive(instance: str) -> str:
    return f"guidefield/{instance}/alive"


def _require_no_other(session: zenoh.Session, instance: str) -> None:
    tokens = session.liveliness().get(f"guidefield/{instance}/*", timeout=ANSWERS_WITHIN)
    if any(reply.ok is not None for reply in tokens):
        raise CannotServe(f"a service named {instance!r} is alive on this network; choose another name")


@contextlib.contextmanager
def _alone_in(data: Path) -> Iterator[None]:
    """Hold a data folder; the system lets go of it however the process ends."""
    data.mkdir(parents=True, exist_ok=True)
    with (data / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise CannotServe(
                f"a service is alive on the data folder {str(data)!r}; choose another name or folder"
            ) from None
        yield
