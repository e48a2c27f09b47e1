"""The memory: enough for the workers that a service starts, and for what each may take."""

from __future__ import annotations

import psutil

from guidefield.doctor.control_group import memory_limit
from guidefield.doctor.finding import Finding, fine, remark, wrong
from guidefield.pool.pool import DEFAULT_MEMORY
from guidefield.system import usable_processors

GIB = 2**30
SERVICE_TAKES = 704 * 2**20
"""The service's own process, and the one that renders recordings: 110 and 410 MiB were measured [bytes]."""
WORKER_TAKES = 768 * 2**20
"""A worker: 420 MiB were measured of a fresh one, 500 MiB after plans for two arms of meshes [bytes]."""


def memory() -> Finding:
    """How much memory this process and its workers may have."""
    there = psutil.virtual_memory()
    return memory_found(there.total, there.available, memory_limit(), usable_processors())


def memory_found(total: int, available: int, limit: int | None, workers: int) -> Finding:
    """What is said about so much memory.

    Args:
        total: What there is [bytes].
        available: What is free for new processes [bytes].
        limit: What the container may use, if it is limited [bytes].
        workers: How many a service starts.
    """
    most = total if limit is None else min(total, limit)
    free = min(available, most)
    there = f"{free / GIB:.1f} of {most / GIB:.1f} GiB are free"
    fit = (free - SERVICE_TAKES) // WORKER_TAKES
    if fit < 1:
        return wrong("memory", there, f"a service with one worker needs {(SERVICE_TAKES + WORKER_TAKES) / GIB:.1f} GiB")
    if fit < workers:
        return remark("memory", there, f"give `guidefield serve --workers {fit}`, instead of {workers}")
    if workers * DEFAULT_MEMORY > most:
        each = (most - SERVICE_TAKES) // workers >> 20
        return remark("memory", there, f"give `guidefield serve --memory {each}`, so that no request takes it all")
    return fine("memory", there)
