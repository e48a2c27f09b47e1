"""Metrics and health over HTTP on loopback, for Prometheus and whoever watches; needs ``guidefield[metrics]``.

Theory of operation. What `info` tells in brief is told here in Prometheus' text format, asked anew for each scrape:
nothing is counted twice. The server is there before anything else of a service, so that a watcher sees it start.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from guidefield.messages import codec
from guidefield.messages.replies import Histogram, InfoReply

LOOPBACK = "127.0.0.1"
PATIENCE = 5.0
"""How long whoever asks may take to say what for, and to read the answer [s]."""
OUTCOMES = ("asked", "answered", "refused", "dropped")
"""Counters of queries by what became of them; the others count other events."""


@contextlib.contextmanager
def metrics_server(port: int, instance: str, brief: Callable[[], InfoReply]) -> Iterator[int]:
    """Answer ``/metrics`` and ``/health`` on loopback while a block runs.

    Args:
        port: Where; 0: a free port.
        instance: Name of the service, a label of every metric.
        brief: What the service says about itself now.

    Yields:
        The port.

    Raises:
        ImportError: if prometheus-client isn't installed.
        OSError: if the port can't be listened on.
    """
    exposition = _exposition(instance, brief)

    class Asked(BaseHTTPRequestHandler):
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

    with ThreadingHTTPServer((LOOPBACK, port), Asked) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, name="guidefield-metrics", daemon=True)
        thread.start()
        try:
            yield server.server_port
        finally:
            server.shutdown()


def _exposition(instance: str, brief: Callable[[], InfoReply]) -> Callable[[], tuple[bytes, str]]:
    """What tells the metrics in Prometheus' text format, with its content type."""
    from prometheus_client import CollectorRegistry
    from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest

    class Told:
        def collect(self) -> Iterator[Any]:
            return families(instance, brief())

    registry = CollectorRegistry(auto_describe=False)
    registry.register(Told())
    return lambda: (generate_latest(registry), CONTENT_TYPE_LATEST)


def families(instance: str, told: InfoReply) -> Iterator[Any]:
    """The metrics of what a service says about itself, as prometheus-client has them.

    Args:
        instance: Name of the service.
        told: What it says.

    Raises:
        ImportError: if prometheus-client isn't installed.
    """
    from prometheus_client.metrics_core import (
        CounterMetricFamily,
        GaugeMetricFamily,
        HistogramMetricFamily,
        InfoMetricFamily,
    )

    def gauge(name: str, what: str, value: float) -> Any:
        family = GaugeMetricFamily(f"guidefield_{name}", what, labels=["instance_name"])
        family.add_metric([instance], value)
        return family

    version = InfoMetricFamily("guidefield", "The service", labels=["instance_name"])
    version.add_metric([instance], {"version": told.version})
    yield version

    health = GaugeMetricFamily("guidefield_health", "1 for the state that it is in", labels=["instance_name", "state"])
    for state in ("starting", "ready", "ending"):
        health.add_metric([instance, state], float(told.health.state == state))
    yield health
    yield gauge("uptime_seconds", "Since the start", told.uptime)
    yield gauge("workers", "Worker processes", told.workers)
    yield gauge("workers_busy", "Those of them that work on a request", told.busy)
    yield gauge("queue_requests", "Requests that wait for a worker", told.queue)

    memory = GaugeMetricFamily("guidefield_memory_bytes", "Resident memory", labels=["instance_name", "of"])
    memory.add_metric([instance, "service"], told.own_memory)
    memory.add_metric([instance, "workers"], told.memory)
    yield memory
    if told.disk is not None:
        yield gauge("disk_free_bytes", "What is free on the data folder's disk", told.disk.free)
        yield gauge("disk_total_bytes", "How large it is", told.disk.total)

    queries = CounterMetricFamily("guidefield_queries", "By what became of them", labels=["instance_name", "outcome"])
    events = CounterMetricFamily("guidefield_events", "Of other kinds", labels=["instance_name", "event"])
    for name, count in told.counters.items():
        (queries if name in OUTCOMES else events).add_metric([instance, name], count)
    yield queries
    yield events

    requests = GaugeMetricFamily(
        "guidefield_user_requests", "Of a user, that wait or run", labels=["instance_name", "user", "state"]
    )
    spent = GaugeMetricFamily(
        "guidefield_user_processor_seconds", "What a user got lately", labels=["instance_name", "user"]
    )
    for user, figures in told.users.items():
        requests.add_metric([instance, user, "waiting"], figures.waiting)
        requests.add_metric([instance, user, "running"], figures.running)
        spent.add_metric([instance, user], figures.processor)
    yield requests
    yield spent

    latency = HistogramMetricFamily(
        "guidefield_answer_seconds", "From a query's arrival to its answer", labels=["instance_name", "kind"]
    )
    for kind, histogram in told.latency.items():
        latency.add_metric([instance, kind], _buckets(histogram), histogram.sum)
    yield latency


def _buckets(histogram: Histogram) -> list[tuple[str, float]]:
    """How often something took at most so long, by the bound."""
    total, buckets = 0, []
    for bound, count in zip([*map(str, histogram.bounds), "+Inf"], histogram.counts, strict=True):
        total += count
        buckets.append((bound, float(total)))
    return buckets
