"""Every query has one span, which says how it ended."""

import pytest

from guidefield.endpoint.monitoring import no_trace, opentelemetry_trace


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
