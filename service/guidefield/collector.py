"""Pause Python's garbage collector while many long-lived objects are made.

Where and whether it is paused changes time alone, and memory while the block runs.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Iterator


@contextlib.contextmanager
def pause_collector() -> Iterator[None]:
    """Pause garbage collection in this process for as long as a block runs.

    Loading a planner or reading many obstacles makes a million objects that stay, which the collector would traverse
    again and again, for a tenth of the time and more. Afterwards they belong to its oldest generation, which is
    traversed seldom. If it was off before, it stays off.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if not gc.get_freeze_count():  # else objects that somebody froze would be unfrozen
            gc.freeze()
            gc.unfreeze()
        if was_on:
            gc.enable()
