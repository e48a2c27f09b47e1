"""Processor time and context switches of a process and of its children, as the system counts them."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

_CLOCK_OF_PROCESS = 2


def read_costs(pid: int) -> np.ndarray:
    """Return the costs of a process by now.

    They are its processor time and that of all processes below it [s], then the context switches of its threads,
    voluntary or not, and those of the processes below it. What a process cost that has ended is not counted.
    """
    own, below = _cost(pid), sum((_cost(child) for child in _descendants(pid)), np.zeros(2))
    return np.array([own[0], below[0], own[1], below[1]])


def _cost(pid: int) -> np.ndarray:
    switches = 0
    for thread in Path(f"/proc/{pid}/task").glob("*/status"):
        with contextlib.suppress(OSError):  # the thread has ended
            counts = (line.split() for line in thread.read_text().splitlines() if "ctxt_switches" in line)
            switches += sum(int(count) for _, count in counts)
    try:
        return np.array([time.clock_gettime(~pid << 3 | _CLOCK_OF_PROCESS), switches])
    except OSError:  # the process has ended
        return np.array([0.0, switches])


def _descendants(pid: int) -> Iterator[int]:
    for children in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in children.read_text().split():
                yield int(child)
                yield from _descendants(int(child))
