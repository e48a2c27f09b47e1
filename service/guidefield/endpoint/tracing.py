"""A trace of every query, for OpenTelemetry; needs ``guidefield[otel]``, and costs nothing where nobody asks for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

End = Callable[[str], None]
"""Ends the trace of a query; is told whether it was answered or refused."""

Trace = Callable[[str, str], End]
"""Begins the trace of a query, by the kind and the key of it."""


def no_trace(_kind: str, _key: str) -> End:
    """Trace nothing."""
    return _nothing


def _nothing(_outcome: str) -> None:
    pass


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
    """A provider that sends spans to where OpenTelemetry's own environment variables say (OTEL_EXPORTER_OTLP_ENDPOINT).

    Raises:
        ImportError: if OpenTelemetry isn't installed.
    """
    from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor

    resource = Resource.create({"service.name": "guidefield", "service.instance.id": instance})
    provider = TracerProvider(resource=resource)
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    return provider
