"""All looks at this machine, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from guidefield.doctor.clock import clock
from guidefield.doctor.finding import Finding, wrong
from guidefield.doctor.graphics import graphics
from guidefield.doctor.memory import memory
from guidefield.doctor.packages import packages
from guidefield.doctor.processors import cores, vectors
from guidefield.doctor.session import session
from guidefield.doctor.storage import disk, kernels, runs


def examination(data: Path) -> Iterator[Finding]:
    """What each look finds.

    Args:
        data: Folder of a service's runs, scenes and robots.
    """
    looks: dict[str, Callable[[], Finding]] = {
        "packages": packages,
        "cores": cores,
        "vectors": vectors,
        "memory": memory,
        "disk": partial(disk, data),
        "runs": partial(runs, data),
        "kernels": kernels,
        "clock": clock,
        "zenoh": session,
        "graphics": graphics,
    }
    for about, look in looks.items():
        yield _looked(about, look)


def _looked(about: str, look: Callable[[], Finding]) -> Finding:
    """What a look finds; that it can't look is a finding, too."""
    try:
        return look()
    except OSError as error:
        return wrong(about, f"can't be looked at: {error}", "guidefield runs on Linux, with /proc readable")
