"""Health, counters and times of a service: metrics over HTTP on loopback, and traces of queries.

Metrics need ``guidefield[metrics]``, traces ``guidefield[otel]``; both are off unless settings turn them on. The server
of metrics starts before anything else of a service, so that a watcher sees it start; each scrape gets the figures of a
brief `info` in Prometheus' text format. Names of metrics are an interface: dashboards read them.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from guidefield.endpoint.link import LOOPBACK
from guidefield.errors import ServerBusy
from guidefield.messages import codec
from guidefield.messages.replies import Health, Histogram, InfoReply

BOUNDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 60.0)
"""Upper bounds of the histograms' bins, rising [s]: `info` tells them, and dashboards read them as labels `le`."""


class Meter:
    """Counts events and times of answers; any thread may."""

    def __init__(self) -> None:
        self._counters = Counter(asked=0, answered=0, refused=0)
        self._bins: dict[str, list[int]] = {}
        self._sums: dict[str, float] = {}
        self._lock = threading.Lock()

    def count(self, event: str) -> None:
        """Count an event."""
        with self._lock:
            self._counters[event] += 1

    def count_answer(self, outcome: str, kind: str, seconds: float) -> None:
        """Count the outcome of a query of a kind, and its time [s]."""
        with self._lock:
            self._counters[outcome] += 1
            bins = self._bins.setdefault(kind, [0] * (len(BOUNDS) + 1))
            bins[bisect_left(BOUNDS, seconds)] += 1
            self._sums[kind] = self._sums.get(kind, 0.0) + seconds

    def counters(self) -> dict[str, int]:
        """Return the counts by event."""
        with self._lock:
            return dict(self._counters)

    def latency(self) -> dict[str, Histogram]:
        """Return histograms of answers' times by kind of query."""
        with self._lock:
            return {
                kind: Histogram(bounds=list(BOUNDS), counts=list(bins), sum=self._sums[kind])
                for kind, bins in self._bins.items()
            }


PATIENCE = 5.0  # time for a client of HTTP to ask, and to read the answer [s]
OUTCOMES = ("asked", "answered", "refused", "dropped")  # counters of queries by outcome; the others count other events


@contextlib.contextmanager
def metrics_server(port: int, instance: str, brief: Callable[[], InfoReply]) -> Iterator[int]:
    """Answer ``/metrics`` and ``/health`` on loopback while a block runs.

    Yields:
        The port.

    Raises:
        ImportError: if prometheus-client isn't installed.
        OSError: if the port can't be listened on.
    """
    exposition = _exposition(instance, brief)

    class Handler(BaseHTTPRequestHandler):
        timeout = PATIENCE

        def do_GET(self) -> None:
            if self.path == "/metrics":
                self._send(HTTPStatus.OK, *exposition())
            elif self.path == "/health":
                health = brief().health
                status = HTTPStatus.OK if health.state == "ready" else HTTPStatus.SERVICE_UNAVAILABLE
                self._send(status, codec.encode(health), "application/json")
            else:
                self._send(HTTPStatus.NOT_FOUND, b"/metrics and /health are here\n", "text/plain; charset=utf-8")

        def _send(self, status: HTTPStatus, body: bytes, kind: str) -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *_arguments: object) -> None:  # noqa: A002 - the name of the base class
            """Say nothing: a scrape every few seconds is no event."""

    with ThreadingHTTPServer((LOOPBACK, port), Handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, name="guidefield-metrics", daemon=True)
        thread.start()
        try:
            yield server.server_port
        finally:
            server.shutdown()


def _exposition(instance: str, brief: Callable[[], InfoReply]) -> Callable[[], tuple[bytes, str]]:
    from prometheus_client import CollectorRegistry
    from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest

    class Collector:
        def collect(self) -> Iterator[Any]:
            return families(instance, brief())

    registry = CollectorRegistry(auto_describe=False)
    registry.register(Collector())
    return lambda: (generate_latest(registry), CONTENT_TYPE_LATEST)


def families(instance: str, info: InfoReply) -> Iterator[Any]:
    """Make metric families, as prometheus-client has them, of what a service tells about itself.

    Raises ImportError if prometheus-client isn't installed.
    """
    from prometheus_client import metrics_core

    def family(kind: str, name: str, what: str, values: Mapping[Any, Any], *labels: str) -> Any:
        made = getattr(metrics_core, f"{kind}MetricFamily")(
            f"guidefield{name}", what, labels=["instance_name", *labels]
        )
        for own, value in values.items():
            made.add_metric([instance, *own], *(value if isinstance(value, tuple) else (value,)))
        return made

    yield family("Info", "", "The service", {(): {"version": info.version}})
    states = {(state,): float(info.health.state == state) for state in ("starting", "ready", "ending")}
    yield family("Gauge", "_health", "1 for the state that it is in", states, "state")
    yield family("Gauge", "_uptime_seconds", "Since the start", {(): info.uptime})
    yield family("Gauge", "_workers", "Worker processes", {(): info.workers})
    yield family("Gauge", "_workers_busy", "Those of them that work on a request", {(): info.busy})
    yield family("Gauge", "_queue_requests", "Requests that wait for a worker", {(): info.queue})
    memory = {("service",): info.own_memory, ("workers",): info.memory}
    yield family("Gauge", "_memory_bytes", "Resident memory", memory, "of")
    if info.disk is not None:
        yield family("Gauge", "_disk_free_bytes", "What is free on the data folder's disk", {(): info.disk.free})
        yield family("Gauge", "_disk_total_bytes", "How large it is", {(): info.disk.total})
    queries = {(name,): count for name, count in info.counters.items() if name in OUTCOMES}
    yield family("Counter", "_queries", "By what became of them", queries, "outcome")
    events = {(name,): count for name, count in info.counters.items() if name not in OUTCOMES}
    yield family("Counter", "_events", "Of other kinds", events, "event")
    waiting = {(user, "waiting"): figures.waiting for user, figures in info.users.items()}
    running = {(user, "running"): figures.running for user, figures in info.users.items()}
    yield family("Gauge", "_user_requests", "Of a user, that wait or run", waiting | running, "user", "state")
    spent = {(user,): figures.processor for user, figures in info.users.items()}
    yield family("Gauge", "_user_processor_seconds", "What a user got lately", spent, "user")
    times = {(kind,): (_buckets(histogram), histogram.sum) for kind, histogram in info.latency.items()}
    yield family("Histogram", "_answer_seconds", "From a query's arrival to its answer", times, "kind")


def _buckets(histogram: Histogram) -> list[tuple[str, float]]:
    bounds = [*map(str, histogram.bounds), "+Inf"]
    return list(zip(bounds, map(float, itertools.accumulate(histogram.counts)), strict=True))


End = Callable[[str], None]  # ends the trace of a query, given its outcome: answered or refused
Trace = Callable[[str, str], End]  # begins the trace of a query, by the kind and the key of it


def no_trace(_kind: str, _key: str) -> End:
    """Trace nothing."""
    return lambda _outcome: None


def opentelemetry_trace(provider: Any) -> Trace:
    """Trace with a provider of OpenTelemetry's: one span for each query, from its arrival to its answer."""
    tracer = provider.get_tracer("guidefield")

    def begin(kind: str, key: str) -> End:
        span = tracer.start_span(kind, attributes={"guidefield.key": key})

        def end(outcome: str) -> None:
            span.set_attribute("guidefield.outcome", outcome)
            span.end()

        return end

    return begin


def exporting_provider(instance: str) -> Any:
    """Return a provider that sends spans to the endpoint of OpenTelemetry's variable OTEL_EXPORTER_OTLP_ENDPOINT.

    Raises ImportError if OpenTelemetry isn't installed.
    """
    from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor

    resource = Resource.create({"service.name": "guidefield", "service.instance.id": instance})
    provider = TracerProvider(resource=resource)
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    return provider


RETRY_AFTER = 2.0  # time after which a client may repeat a query to a service that is starting [s]


class Condition:
    """The state of a service; one thread changes it, any may read it."""

    def __init__(self) -> None:
        self.now = Health(state="starting", doing="starting")

    def require_ready(self) -> None:
        """Raise ServerBusy, for a request that needs a worker, unless the service is ready."""
        now = self.now
        if now.state == "starting":
            raise ServerBusy(f"the service is starting: {now.doing}; ask again later", retry_after=RETRY_AFTER)
        if now.state == "ending":
            raise ServerBusy("the service is shutting down")
