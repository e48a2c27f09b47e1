"""Metrics, health and traces: Prometheus' own parser reads them, and every query has one span."""

import json
import re
import socket
import threading
import urllib.error
import urllib.request
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from guidefield.cli.serving import free_port
from guidefield.endpoint.monitoring import Meter, metrics_server, no_trace, opentelemetry_trace
from guidefield.endpoint.service import ServiceSettings, serve
from guidefield.handlers.info import Figures, brief_info
from guidefield.messages.replies import Disk, Health, InfoReply, UserFigures
from tests.journeys.service import ANSWERED_WITHIN, ENDED_WITHIN, await_that

parser = pytest.importorskip("prometheus_client.parser", reason="pip install 'guidefield[metrics]'")


def _answer(port: int, path: str) -> tuple[int, str, str]:
    """Status, content type and text of an answer."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=ANSWERED_WITHIN) as answer:
            return answer.status, answer.headers["Content-Type"], answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.headers["Content-Type"], error.read().decode()


def _samples(port: int) -> dict[tuple[str, ...], float]:
    """Values by name and labels, as Prometheus' parser reads them."""
    status, _, text = _answer(port, "/metrics")
    assert status == 200
    return {
        (sample.name, *(f"{key}={value}" for key, value in sorted(sample.labels.items()) if key != "instance_name")): (
            sample.value
        )
        for family in parser.text_string_to_metric_families(text)
        for sample in family.samples
        if sample.labels["instance_name"] == 'cell "7"'
    }


def _busy() -> InfoReply:
    meter = Meter()
    for seconds in (0.0005, 0.003, 0.003, 100.0):
        meter.count_answer("answered", "plan", seconds)
    return brief_info(
        Figures(
            counters={"asked": 5, "answered": 3, "refused": 1, "crashes": 2},
            uptime=12.5,
            workers=4,
            busy=3,
            queue=7,
            memory=1 << 30,
            latency=meter.latency(),
            health=Health(state="ready"),
            disk=Disk(free=5, total=9),
            users={"ann": UserFigures(waiting=2, running=1, processor=0.5)},
        )
    )


def test_metrics_are_what_info_tells() -> None:
    with metrics_server(0, 'cell "7"', _busy) as port:
        told = _samples(port)
    assert told[("guidefield_uptime_seconds",)] == 12.5
    assert (told[("guidefield_workers",)], told[("guidefield_workers_busy",)]) == (4, 3)
    assert told[("guidefield_queue_requests",)] == 7
    assert told[("guidefield_memory_bytes", "of=workers")] == 1 << 30
    assert told[("guidefield_memory_bytes", "of=service")] > 1 << 20
    assert (told[("guidefield_disk_free_bytes",)], told[("guidefield_disk_total_bytes",)]) == (5, 9)
    assert told[("guidefield_queries_total", "outcome=asked")] == 5
    assert told[("guidefield_events_total", "event=crashes")] == 2
    assert [told[("guidefield_health", f"state={state}")] for state in ("starting", "ready", "ending")] == [0, 1, 0]
    assert told[("guidefield_user_requests", "state=waiting", "user=ann")] == 2
    assert told[("guidefield_user_requests", "state=running", "user=ann")] == 1
    assert told[("guidefield_user_processor_seconds", "user=ann")] == 0.5
    assert ("guidefield_info", f"version={_busy().version}") in told


@pytest.mark.parametrize(("state", "status"), [("starting", 503), ("ready", 200), ("ending", 503)])
def test_health_has_a_status(state: Any, status: int) -> None:
    reply = brief_info(Figures({}, 0.0, health=Health(state=state, doing="something")))
    with metrics_server(0, "local", lambda: reply) as port:
        answer = _answer(port, "/health")
        assert answer[:2] == (status, "application/json")
        assert json.loads(answer[2]) == {"state": state, "doing": "something"}
        assert _answer(port, "/")[0] == 404


def test_whoever_says_nothing_keeps_nobody_waiting() -> None:
    with metrics_server(0, 'cell "7"', _busy) as port, socket.create_connection(("127.0.0.1", port)):
        assert _answer(port, "/health")[0] == 200


def test_a_service_tells_its_health_before_it_is_ready(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stop, seen, opening, open_it = (threading.Event() for _ in range(4))

    def compiled(told: Callable[[str], None], _stopped: Callable[[], bool]) -> None:
        told("compiling kernels: 26 of 66")
        seen.wait(ANSWERED_WITHIN)
        stop.set()

    from guidefield.endpoint import service

    opened = service.zenoh.open

    def opened_late(config: Any) -> Any:
        opening.set()
        open_it.wait(ANSWERED_WITHIN)
        return opened(config)

    monkeypatch.setattr(service, "compile_kernels", compiled)
    monkeypatch.setattr(service.zenoh, "open", opened_late)
    with free_port() as port, free_port() as metrics, ThreadPoolExecutor(1) as thread:
        settings = ServiceSettings(tmp_path, listen=(f"tcp/127.0.0.1:{port}",), metrics=metrics)
        served = thread.submit(serve, settings, stop)
        try:
            opening.wait(ANSWERED_WITHIN)
            assert json.loads(_answer(metrics, "/health")[2]) == {"state": "starting", "doing": "starting"}
            assert "guidefield_queries_total{" not in _answer(metrics, "/metrics")[2]
            open_it.set()
            await_that(lambda: "26 of 66" in _answer(metrics, "/health")[2])
            assert (
                'guidefield_queries_total{instance_name="local",outcome="asked"} 0.0' in _answer(metrics, "/metrics")[2]
            )
        finally:
            open_it.set()
            seen.set()
        served.result(ENDED_WITHIN)
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", metrics))


def test_the_page_has_every_metric() -> None:
    page = (Path(__file__).resolve().parents[2] / "service" / "docs" / "operation.md").read_text()
    rows = "\n".join(line.split(" | ")[0] for line in page.splitlines() if line.startswith("| `guidefield_"))
    told = set(re.findall(r"guidefield_\w+", rows))
    with metrics_server(0, 'cell "7"', _busy) as port:
        families = list(parser.text_string_to_metric_families(_answer(port, "/metrics")[2]))
    there = {family.name + ("_total" if family.type == "counter" else "") for family in families}
    assert {name.removesuffix("_total") for name in told} == {name.removesuffix("_total") for name in there}


def test_a_query_has_one_span() -> None:
    reason = "OpenTelemetry is not installed: pip install 'guidefield[otel]'"
    sdk = pytest.importorskip("opentelemetry.sdk.trace", reason=reason)
    from opentelemetry.sdk.trace.export import SimpleSpanProcessor
    from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

    kept, provider = InMemorySpanExporter(), sdk.TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(kept))
    begin = opentelemetry_trace(provider)
    first, second = begin("plan", "guidefield/local/plan"), begin("info", "guidefield/local/info")
    second("answered")
    first("refused")
    told = [
        (span.name, span.attributes["guidefield.key"], span.attributes["guidefield.outcome"])
        for span in kept.get_finished_spans()
    ]
    assert told == [("info", "guidefield/local/info", "answered"), ("plan", "guidefield/local/plan", "refused")]


def test_nothing_is_traced_unless_asked_for() -> None:
    no_trace("plan", "guidefield/local/plan")("answered")
