"""Zenoh on loopback: whether a session here answers another one."""

from __future__ import annotations

from guidefield.doctor.finding import Finding, fine, remark, wrong
from guidefield.endpoint.link import DEFAULT_LISTEN, NoAnswer, is_taken, measure_answer


def session() -> Finding:
    """Whether a query on loopback is answered, and whether a service's own port is free."""
    try:
        seconds = measure_answer()
    except NoAnswer as error:
        return wrong(
            "zenoh",
            f"no answer on loopback: {error}",
            "look at the firewall's rules for lo, and at ZENOH_RUNTIME and ZENOH_CONFIG in the environment",
        )
    answered = f"a query on loopback is answered in {1e3 * seconds:.1f} ms"
    if is_taken(DEFAULT_LISTEN):
        return remark(
            "zenoh",
            f"{answered}; {DEFAULT_LISTEN} is taken",
            "if that isn't your service, give `guidefield serve --listen tcp/127.0.0.1:PORT`",
        )
    return fine("zenoh", answered)
