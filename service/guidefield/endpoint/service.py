"""Start a service, alone under its name and on its data folder, serve until it has to stop, and end it in order.

Callbacks of the `ExitStack` in `serve` run in reverse at the end; their order is that of what still needs what.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh

from guidefield.endpoint import monitoring
from guidefield.endpoint.endpoint import Endpoint
from guidefield.endpoint.link import (
    DEFAULT_LISTEN,
    DEFAULT_SETTINGS,
    LATCHING,
    ROS_USER,
    RUNTIME,
    RosSettings,
    close_links_at_once,
)
from guidefield.endpoint.rules import DELIVERY, list_limits
from guidefield.endpoint.streams import Streams
from guidefield.endpoint.under_way import Clients
from guidefield.engines import Engines, EngineSetup
from guidefield.errors import DiskRefused, GuidefieldError, WorkerCrashed, strip_source
from guidefield.first_start import CannotStart, compile_kernels
from guidefield.handlers.info import Figures, Rules, brief_info
from guidefield.messages import codec
from guidefield.messages.identities import PLAIN, base_key
from guidefield.messages.replies import Health, InfoReply, make_error_reply
from guidefield.messages.streams import DEFAULT_STREAMS
from guidefield.pool.pool import DEFAULT_MEMORY, Pool
from guidefield.pool.waiting import Limits
from guidefield.renderer import Renderer
from guidefield.stores.files import checked_name
from guidefield.stores.runs import DEFAULT_RETENTION, Retention, RunDatabase

if TYPE_CHECKING:
    from guidefield.endpoint.ros.node import RosNode

_log = logging.getLogger(__name__)

DEFAULT_QUEUE = 64  # default number of requests that may wait; that of `guidefield serve --queue` must be the same
DEFAULT_GRACE = 10.0  # default time for requests under way at the end [s]; see `DUMP_TIME_S` of `cli/serving.py`
# both are in docs/service.md, and in docs/wire.md by rules.py: after a change, `tools/wire_page`
LIVELINESS_TIMEOUT_S = 5.0  # longest time to ask for a service of the same name [s]; one that answers later isn't seen
CLAIM_PERIOD_S = 0.05  # between two checks of who claims the same name [s]
EAGER_PATIENCE_S = 30.0
"""Time that a worker has for the recording that it renders after its reply, before another process does it [s]."""
STREAM_OPTIONS = {
    "congestion_control": zenoh.CongestionControl.DROP,  # a client that doesn't read delays no other
    "priority": zenoh.Priority.INTERACTIVE_HIGH,
    "express": True,
}
"""Zenoh's options for messages of streams."""
STOP_CHECK_S = 0.2  # interval at which a start checks whether it is to stop [s]


@dataclass(frozen=True)
class ServiceSettings(EngineSetup):
    """The settings of a service, beside those of its engine."""

    listen: tuple[str, ...] | None = None  # zenoh endpoints; None takes the configuration's, or else a loopback port
    config: Path | None = None  # zenoh configuration file
    workers: int = 2  # number of worker processes
    streams: int = DEFAULT_STREAMS  # how many streams may be open at once; each has a process of its own
    queue_limit: int = DEFAULT_QUEUE  # how many requests may wait for a worker; a single client may have half of them
    memory: int = DEFAULT_MEMORY  # a worker that takes more is stopped [bytes]
    retention: Retention = DEFAULT_RETENTION  # how many runs are kept
    otel: bool = False  # whether queries are traced with OpenTelemetry
    metrics: int | None = None  # port on loopback where metrics and health are reported over HTTP; None: nowhere
    grace: float = DEFAULT_GRACE  # time for running requests at the end [s]; then plans are ended early
    ros: RosSettings | None = None  # how it is offered to ROS 2 nodes; None: not at all

    def setup(self) -> EngineSetup:
        """Return the settings of the engine alone, which workers read; they log as much as this process."""
        setup = EngineSetup(*(getattr(self, field.name) for field in fields(EngineSetup)))
        return replace(setup, log_level=_log.getEffectiveLevel())


def limits_of(queue: int) -> Limits:
    """Return the limits of a queue of a number of requests; a single client may have half of them."""
    return Limits(tasks=queue, tasks_of_client=(queue + 1) // 2)


def serve(settings: ServiceSettings, stop: threading.Event, announce: Callable[[str], None] = _log.info) -> None:
    """Serve until `stop` is set; then finish running requests, refuse waiting ones, and return.

    Args:
        stop: Ends the service once it is set.
        announce: Takes sentences about the start, of which the last begins with "ready", and about the end, of which
            the first begins with "stopping": `cli/serving.py` reads them.

    Raises:
        MalformedRequest: if its name can't be one.
        CannotStart: if a service of that name is alive, on this data folder or on the network; if the configuration is
            wrong, or an endpoint or the port of metrics can't be listened on; if the workers can't be prepared.
    """
    checked_name(settings.instance, "instance")
    setup = settings.setup()
    config = session_config(settings)
    os.environ.setdefault("ZENOH_RUNTIME", RUNTIME)  # read when the first session is opened
    with contextlib.ExitStack() as opened:
        opened.enter_context(_alone_in(settings.data, announce))
        condition, began = monitoring.Condition(), time.monotonic()
        figures: list[Callable[[], Figures]] = [
            lambda: Figures({}, time.monotonic() - began, health=condition.now)  # until there is an endpoint
        ]
        _tell_metrics(settings, lambda: brief_info(figures[-1]()), opened)
        session = opened.enter_context(_open_session(config))
        opened.callback(close_links_at_once(session).undeclare)
        starting = claim_name(session, settings.instance)
        runs = RunDatabase(settings.data, settings.retention, lambda user: settings.quotas.of(user).bytes)
        renderer = _renderer(settings, setup, runs)
        _prepare(runs, announce)
        engines = setup.engines(runs)
        limits = limits_of(settings.queue_limit)
        progress = session.declare_publisher(f"guidefield/{settings.instance}/**/runs/*/progress")
        pool = Pool(setup, workers=settings.workers, limits=limits, memory=settings.memory)
        hear_listeners = zenoh.handlers.Callback(
            lambda status: setattr(pool.listened, "value", status.matching), indirect=False
        )
        opened.enter_context(progress.declare_matching_listener(hear_listeners))
        streams = Streams(setup, settings.streams, settings.memory, partial(_publish, session, **STREAM_OPTIONS))
        endpoint = Endpoint(
            setup,
            engines,
            runs,
            pool,
            streams,
            partial(_publish, session),
            _trace(settings, opened),
            condition,
            Rules(list_limits(limits, settings.memory, settings.retention, settings.grace, settings.streams), DELIVERY),
            _has_access_control(config),
            lambda: renderer.memory,
        )
        figures.append(endpoint.figures)
        _declare(endpoint, settings.instance, session, opened)
        opened.callback(runs.close)
        opened.callback(renderer.close)
        opened.callback(Clients(session, settings.instance, endpoint.forget).close)
        node = None if settings.ros is None else _ros_node(settings.ros, session, engines, endpoint, opened)
        opened.callback(streams.close)
        opened.callback(pool.close, settings.grace)
        ending = Health(state="ending", doing=f"what is being worked on is finished, within {settings.grace:g} s")
        opened.callback(setattr, condition, "now", ending)
        announce(f"starting (workers: {settings.workers})")
        if not _await_start(settings, pool, condition, announce, stop):
            return
        if _has_access_control(config):  # there are users
            pool.stand_by()
        if node is not None:
            opened.callback(node.withdraw)
            node.offer()
        renderer.start()
        starting.undeclare()
        opened.enter_context(session.liveliness().declare_token(f"guidefield/{settings.instance}/alive"))
        announce(f"ready: instance {settings.instance!r} answers at {config.get_json('listen/endpoints')}")
        stop.wait()
        announce("stopping: what is being worked on is finished, what waits is refused")


def _declare(endpoint: Endpoint, instance: str, session: zenoh.Session, opened: contextlib.ExitStack) -> None:
    """Have an endpoint take queries, and updates of streams, each in the thread of its link.

    In one thread for all, a query would wait for the earlier ones of all links.
    """
    for keys in (base_key(instance, PLAIN), base_key(instance, "*")):
        heard = zenoh.handlers.Callback(endpoint.hear_update, indirect=False)
        opened.enter_context(session.declare_subscriber(f"{keys}/streams/*/update", heard))
    queries = zenoh.handlers.Callback(endpoint.receive, indirect=False)
    opened.enter_context(session.declare_queryable(f"guidefield/{instance}/**", queries))
    opened.callback(endpoint.close)


def _renderer(settings: ServiceSettings, setup: EngineSetup, runs: RunDatabase) -> Renderer:
    patience = EAGER_PATIENCE_S if setup.eager_recordings else 0.0
    renderer = Renderer(setup, settings.memory, runs.recordings, runs.note_recording, patience)
    runs.render = renderer.add
    return renderer


def session_config(settings: ServiceSettings) -> zenoh.Config:
    """Return the file's configuration; on loopback only and without scouting unless that says otherwise.

    Raises CannotStart if the file can't be read, or something in it or in the endpoints is wrong.
    """
    file, listen = "" if settings.config is None else f" {str(settings.config)!r}", settings.listen
    with _refuse_start(f"the Zenoh configuration{file} is wrong", zenoh.ZError):
        config = zenoh.Config() if settings.config is None else zenoh.Config.from_file(str(settings.config))
        if listen is not None:
            try:
                config.insert_json5("listen/endpoints", json.dumps(list(listen)))
            except zenoh.ZError:
                raise CannotStart(f"endpoints are written like {DEFAULT_LISTEN}, got {', '.join(listen)}") from None
        elif config.get_json("listen/endpoints") == zenoh.Config().get_json("listen/endpoints"):
            config.insert_json5("listen/endpoints", json.dumps([DEFAULT_LISTEN]))
        for key, value in DEFAULT_SETTINGS.items():
            if config.get_json(key) == zenoh.Config().get_json(key):
                config.insert_json5(key, value)
        if settings.ros is not None:
            config.insert_json5(*LATCHING)
    return config


@contextlib.contextmanager
def _refuse_start(failure: str, *errors: type[Exception]) -> Iterator[None]:
    try:
        yield
    except errors as error:
        raise CannotStart(f"{failure}: {strip_source(error)}") from None


def _open_session(config: zenoh.Config) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        why, advice = strip_source(error), ""
        if "in use" in why:
            advice = "; another program, perhaps a service, listens there: end it, or give another --listen"
        elif "invalid socket address" in why:
            advice = f"; an endpoint is written like {DEFAULT_LISTEN}"
        where = config.get_json("listen/endpoints")
        raise CannotStart(f"Zenoh can't be opened at {where}: {why}{advice}") from None


def _has_access_control(config: zenoh.Config) -> bool:
    return bool(json.loads(config.get_json("access_control/enabled")))


def _trace(settings: ServiceSettings, opened: contextlib.ExitStack) -> monitoring.Trace:
    if not settings.otel:
        return monitoring.no_trace
    try:
        provider = monitoring.exporting_provider(settings.instance)
    except ImportError:
        raise CannotStart("traces need OpenTelemetry: pip install 'guidefield[otel]'") from None
    opened.callback(provider.shutdown)
    return monitoring.opentelemetry_trace(provider)


def _tell_metrics(settings: ServiceSettings, brief: Callable[[], InfoReply], opened: contextlib.ExitStack) -> None:
    if settings.metrics is None:
        return
    try:
        opened.enter_context(monitoring.metrics_server(settings.metrics, settings.instance, brief))
    except ImportError:
        raise CannotStart("metrics need prometheus-client: pip install 'guidefield[metrics]'") from None
    except OSError as error:
        raise CannotStart(f"metrics can't be served at port {settings.metrics}: {error.strerror}") from None


def _await_start(
    settings: ServiceSettings,
    pool: Pool,
    condition: monitoring.Condition,
    announce: Callable[[str], None],
    stop: threading.Event,
) -> bool:
    """Return whether the pool became ready before `stop` was set; the condition reports the progress.

    The kernels are compiled before workers start, each of which would compile them all.
    """

    def tell(sentence: str) -> None:
        condition.now = Health(state="starting", doing=sentence)
        announce(sentence)

    try:
        compile_kernels(tell, stop.is_set)
        robots = f", and prepares {', '.join(settings.prepare)}" if settings.prepare else ""
        doing = f"the first of {settings.workers} workers loads the planner{robots}"
        condition.now = Health(state="starting", doing=doing)
        pool.start()
        while not pool.ready(STOP_CHECK_S):
            if stop.is_set():
                return False
    except RuntimeError as error:
        raise CannotStart(str(error)) from None
    condition.now = Health(state="ready")
    return True


def _ros_node(
    settings: RosSettings, own: zenoh.Session, engines: Engines, endpoint: Endpoint, opened: contextlib.ExitStack
) -> RosNode:
    try:
        from guidefield.endpoint.ros.node import ros_node, session_for
    except ImportError:
        raise CannotStart("ROS needs rosbags: pip install 'guidefield[ros]'") from None
    with _refuse_start("the service can't be offered to ROS", GuidefieldError, zenoh.ZError):
        session = opened.enter_context(session_for(settings, own))
        node = ros_node(settings, session, engines.of(ROS_USER).robot(settings.robot), endpoint.ask)
    opened.callback(node.finish)
    return node


def _publish(
    session: zenoh.Session, key: str, payload: bytes, encoding: codec.Encoding = codec.Encoding.JSON, **options: Any
) -> None:
    try:
        session.put(key, payload, encoding=encoding.value, **options)
    except zenoh.ZError:  # nobody hears it then; the work goes on
        _log.exception("%s could not be published", key)


def claim_name(session: zenoh.Session, instance: str) -> zenoh.LivelinessToken:
    """Return the token of a service that starts, once no other one of its name is alive or may become so.

    Of several that claim a name at the same time the one with the smallest identifier gets it.

    Raises:
        CannotStart: if another one has it or gets it.
    """
    own, begun = str(session.zid()), time.monotonic()
    claim = session.liveliness().declare_token(f"guidefield/{instance}/starting/{own}")
    while True:
        claims = _find_tokens(session, f"guidefield/{instance}/starting/*") - {
            own
        }  # before who has it: it is both then
        is_taken = bool(_find_tokens(session, f"guidefield/{instance}/*")) or min(claims, default=own) < own
        if is_taken or (claims and time.monotonic() - begun > LIVELINESS_TIMEOUT_S):
            raise CannotStart(f"a service named {instance!r} is alive on this network; choose another name")
        if not claims:
            break
        time.sleep(CLAIM_PERIOD_S)  # until those with larger identifiers have given up
    starting = session.liveliness().declare_token(f"guidefield/{instance}/starting")
    claim.undeclare()
    return starting


def _find_tokens(session: zenoh.Session, keys: str) -> set[str]:
    """Find the last parts of the keys of liveliness tokens."""
    found = session.liveliness().get(keys, timeout=LIVELINESS_TIMEOUT_S)
    return {str(reply.ok.key_expr).rpartition("/")[2] for reply in found if reply.ok is not None}


def _prepare(runs: RunDatabase, announce: Callable[[str], None]) -> None:
    stopped = WorkerCrashed("the service stopped while it worked on this run")
    try:
        runs.take_over(announce)
        runs.sweep(make_error_reply(stopped))
    except (DiskRefused, OSError) as error:
        reason = error.message if isinstance(error, DiskRefused) else f"the disk refuses: {error.strerror}"
        announce(f"no run is kept, and each reply says so: {reason}")


@contextlib.contextmanager
def _alone_in(data: Path, announce: Callable[[str], None]) -> Iterator[None]:
    try:
        data.mkdir(parents=True, exist_ok=True)
        opened = (data / ".lock").open("w")
    except OSError as error:
        raise CannotStart(
            f"the data folder {str(data)!r} can't be written ({error.strerror}): --data names another"
        ) from None
    with opened as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise CannotStart(
                f"a service is alive on the data folder {str(data)!r}; choose another name or folder"
            ) from None
        except OSError as error:
            announce(f"the data folder can't be locked ({error.strerror}): start no second service on {str(data)!r}")
        yield
