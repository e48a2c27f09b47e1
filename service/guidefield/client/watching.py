"""The progress of a run, heard while a block runs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import msgspec
import zenoh

from guidefield.messages.replies import Progress


@contextlib.contextmanager
def watching(session: zenoh.Session, run_id: str, hear: Callable[[Progress], None] | None) -> Iterator[None]:
    """Have somebody hear how far a run is, whichever instance makes it; nothing is done for nobody.

    Args:
        session: An open session.
        run_id: Name of the run.
        hear: Who hears it, in a thread of the session.
    """
    if hear is None:
        yield
        return

    def heard(sample: zenoh.Sample) -> None:
        hear(msgspec.json.decode(sample.payload.to_bytes(), type=Progress))

    subscriber = session.declare_subscriber(f"guidefield/*/runs/{run_id}/progress", heard)
    try:
        yield
    finally:
        subscriber.undeclare()
