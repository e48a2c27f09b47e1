"""What runs in a worker process: it is prepared once, says what it begins, and ends with its parent."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable
from multiprocessing.connection import wait
from typing import Any

from guidefield.pool.waiting import Answer

Work = Callable[[Any], Answer]
"""Answers one job; it must not raise."""

Setup = Callable[[], Work]
"""Prepares a worker process and returns what answers there; it is sent there, so it must pickle."""

_answers: Work | None = None
"""In a worker process: what answers there."""
_begun: Any = None
"""In a worker process: the number of the job that was begun last, in memory shared with the slot."""


def prepare(setup: Setup, begun: Any) -> None:
    """Make this process a worker; `begun` is memory that it shares with its slot."""
    global _answers, _begun
    threading.Thread(target=_end_with_parent, name="guidefield-parent", daemon=True).start()
    _answers, _begun = setup(), begun


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None, "a worker is spawned"
    wait([parent.sentinel])
    os._exit(1)


def work(number: int, job: Any) -> Answer:
    """Answer one job, after saying that it is begun."""
    assert _answers is not None, "a worker is prepared before it works"
    _begun.value = number
    return _answers(job)
