"""What the system tells of processes, by the ways of Linux and of others."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from guidefield import system

GONE = 2**22 + 1
"""No process has that id: it is above Linux's largest."""
ENDS_AFTER = (
    "import time; from guidefield.pool.process import end_after; end_after(0); print(flush=True); time.sleep(300)"
)


def test_resident_memory_is_what_linux_counts() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    assert system.resident(os.getpid()) == pytest.approx(pages * resource.getpagesize(), rel=0.05)
    assert system.resident(GONE) == 0


def test_the_time_of_processors_is_the_same_by_both_ways() -> None:
    until = time.process_time() + 0.05
    while time.process_time() < until:
        pass
    precise, told = system.processor_time(os.getpid()), system.psutil_processor_time(os.getpid())
    assert precise == pytest.approx(time.process_time(), abs=0.05)
    assert told == pytest.approx(precise, abs=0.05)
    assert system.processor_time(GONE) == system.psutil_processor_time(GONE) == 0.0


def test_a_worker_ends_with_its_parent_where_the_system_does_not_see_to_it() -> None:
    with subprocess.Popen([sys.executable, "-c", ENDS_AFTER], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout.readline() == b"\n"
        assert child.poll() is None
        child.stdin.close()
        assert child.wait(60.0) == -signal.SIGKILL
