"""Processors and memory: those of the machine, and what the control group of this process may use."""

from __future__ import annotations

import platform
import re
from collections.abc import Iterator
from pathlib import Path

import psutil

from guidefield.doctor.finding import Finding, fine, remark, wrong
from guidefield.pool.pool import DEFAULT_MEMORY
from guidefield.system import usable_processors

ROOT = Path("/sys/fs/cgroup")
OWN = Path("/proc/self/cgroup")


def processor_quota(root: Path = ROOT, own: Path = OWN) -> float | None:
    """How many processors may be used at once; None without such a limit.

    Args:
        root: Where the groups are.
        own: Says which group is this process's.
    """
    found = []
    for folder in _folders(root, own):
        share, _, period = _read(folder / "cpu.max").partition(" ")
        if share.isdecimal() and period.isdecimal():
            found.append(int(share) / int(period))
        quota, period = _read(folder / "cpu.cfs_quota_us"), _read(folder / "cpu.cfs_period_us")
        if quota.isdecimal() and period.isdecimal():
            found.append(int(quota) / int(period))
    return min(found, default=None)


def memory_limit(root: Path = ROOT, own: Path = OWN) -> int | None:
    """How much memory may be used [bytes]; None without such a limit."""
    found = [_read(folder / name) for folder in _folders(root, own) for name in ("memory.max", "memory.limit_in_bytes")]
    limits = [int(limit) for limit in found if limit.isdecimal() and int(limit) < 1 << 60]
    return min(limits, default=None)


def _folders(root: Path, own: Path) -> Iterator[Path]:
    """The group's folders and those above it, of both versions of control groups."""
    for line in _read(own).splitlines():
        _, names, path = line.split(":", 2)
        above = root if not names else root / names
        group = above / path.lstrip("/")
        while True:
            yield group
            if group in (above, group.parent):
                break
            group = group.parent


def _read(file: Path) -> str:
    try:
        return file.read_text().strip()
    except OSError:
        return ""


LEAST = 2
"""With less a worker and whatever else runs, the service's own process too, wait for one another."""
WIDE = ("avx512f", "avx2", "asimd")
"""Vector instructions that the kernels' sixteen lanes are made for, the widest first."""


def cores() -> Finding:
    """How many processors this process may use."""
    return cores_found(usable_processors(), processor_quota())


def cores_found(allowed: int, quota: float | None) -> Finding:
    """What is said about so many processors, of which so many may be used at once."""
    there = f"{allowed} to run on" + ("" if quota is None else f", the container may use {quota:g} at once")
    if quota is not None and quota < allowed:
        workers = max(1, int(quota))
        return remark("cores", there, f"give `guidefield serve --workers {workers}`: more only wait for one another")
    if allowed < LEAST:
        return remark("cores", there, "a second core keeps answers quick while a plan is made")
    return fine("cores", there)


def vectors(cpuinfo: Path = Path("/proc/cpuinfo"), machine: str | None = None) -> Finding:
    """How wide the registers of the processors are.

    Args:
        cpuinfo: Where Linux tells of them; other systems don't.
        machine: The family of processors; None: this one's.
    """
    if cpuinfo.exists():
        text = cpuinfo.read_text()
        flags = set(" ".join(re.findall(r"^(?:flags|Features)\s*:(.*)$", text, re.MULTILINE)).split())
    elif (machine or platform.machine()) in ("arm64", "aarch64"):
        flags = {"asimd"}  # each 64-bit one has it
    else:
        return fine("vectors", "this system doesn't say which")
    widest = next((name for name in WIDE if name in flags), None)
    if widest is None:
        return remark(
            "vectors",
            f"none of {', '.join(WIDE)}",
            "plans are right and take several times as long; a virtual machine may hide them: pass the host's through",
        )
    if widest == "avx2" and "fma" not in flags:
        return remark(
            "vectors", "avx2 without fma", "plans are right and take longer; pass the host's processor through"
        )
    return fine("vectors", widest)


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
