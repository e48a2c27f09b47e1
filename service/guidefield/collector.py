"""Python's collector of garbage, which has nothing to do while much is loaded or read."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Iterator


@contextlib.contextmanager
def waiting_collector() -> Iterator[None]:
    """No garbage is looked for meanwhile, in this process.

    Loading a planner or reading many obstacles makes a million objects that stay: the collector looks through them
    again and again, for a tenth of the time and more. They count as old when it begins again: it doesn't look through
    all of them at once then. Where it was off before it stays off.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if not gc.get_freeze_count():  # else what somebody froze would no longer be so
            gc.freeze()
            gc.unfreeze()
        if was_on:
            gc.enable()
