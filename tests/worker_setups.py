"""What the pool's tests run in worker processes: importable there, as a worker imports it anew."""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable
from pathlib import Path


def obedient() -> Callable[[tuple[str, str]], tuple[bool, bytes]]:
    """A worker that does what its jobs say."""
    return _obey


def broken() -> Callable[[tuple[str, str]], tuple[bool, bytes]]:
    """A worker that cannot be prepared."""
    raise ValueError("this worker cannot be prepared")


def _obey(job: tuple[str, str]) -> tuple[bool, bytes]:
    verb, value = job
    return _VERBS[verb](value)


def _echo(value: str) -> tuple[bool, bytes]:
    return True, value.encode()


def _pid(_value: str) -> tuple[bool, bytes]:
    return True, str(os.getpid()).encode()


def _sleep(value: str) -> tuple[bool, bytes]:
    time.sleep(float(value))
    return True, b"slept"


def _mark_and_sleep(value: str) -> tuple[bool, bytes]:
    Path(value).write_text(str(os.getpid()))
    time.sleep(60.0)
    return True, b"slept"


def _segfault(_value: str) -> tuple[bool, bytes]:
    ctypes.string_at(0)
    return True, b"unreachable"


def _refuse(value: str) -> tuple[bool, bytes]:
    return False, value.encode()


_VERBS = {
    "echo": _echo,
    "pid": _pid,
    "sleep": _sleep,
    "mark": _mark_and_sleep,
    "segfault": _segfault,
    "refuse": _refuse,
}
