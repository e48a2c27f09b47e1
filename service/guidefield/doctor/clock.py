"""The clock: certificates of TLS and the ages of runs are told by it."""

from __future__ import annotations

import ctypes
import datetime
import time
from pathlib import Path

import guidefield
from guidefield.doctor.finding import Finding, fine, remark, wrong

UNSYNCHRONIZED = 5
"""TIME_ERROR: what the system says of a clock that nothing sets."""
SLACK = 86_400.0
"""How far behind the newest file of ours it may be, whose time another machine may have set [s]."""


def clock() -> Finding:
    """Whether the clock is set, and by something that keeps it right."""
    ours = Path(guidefield.__file__).stat().st_mtime
    return clock_found(time.time(), ours, _system_state())


def clock_found(now: float, ours: float, state: int) -> Finding:
    """What is said about a clock.

    Args:
        now: What it says [s since 1970].
        ours: When guidefield was installed, by the time of its files [s since 1970].
        state: What the system says about it, as adjtimex(2) does; negative: nothing.
    """
    told = datetime.datetime.fromtimestamp(now, datetime.UTC).isoformat(sep=" ", timespec="seconds")
    if now < ours - SLACK:
        return wrong("clock", f"{told} is before guidefield was installed", "set it: `timedatectl set-time`, or NTP")
    if state == UNSYNCHRONIZED:
        return remark(
            "clock",
            f"{told}, kept right by nothing",
            "`timedatectl set-ntp true`, unless the host sets it: a clock that strays has certificates refused",
        )
    return fine("clock", told)


def _system_state() -> int:
    """What adjtimex(2) says, asked without changing anything; negative where it isn't allowed, or isn't there."""
    asked = ctypes.create_string_buffer(256)  # struct timex, all 0: nothing is set
    adjtimex = getattr(ctypes.CDLL(None), "adjtimex", None)  # Linux's own
    return -1 if adjtimex is None else int(adjtimex(asked))
