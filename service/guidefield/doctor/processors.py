"""The processors: how many there are for us, and how wide their registers are."""

from __future__ import annotations

import platform
import re
from pathlib import Path

from guidefield.doctor.control_group import processor_quota
from guidefield.doctor.finding import Finding, fine, remark
from guidefield.system import usable_processors

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
