"""A service ends on a signal, whatever its main thread does when the signal comes."""

import os
import signal
import subprocess
import sys

import pytest

from tests.cli.test_ending import full_pipe

INTERRUPTED_WHILE_IT_HOLDS_THE_EVENT = """
import os, sys
from pathlib import Path
from guidefield.cli import serving

def serve(settings, stop, announce):
    with stop._cond:  # where a thread that begins to wait is for a moment
        os.kill(os.getpid(), int(sys.argv[1]))
    assert stop.wait(200.0)
    announce("ended")
    sys.stderr.write("ended")

serving.serve = serve
serving.serve_until_signal(serving.ServiceSettings(Path("unused")), print)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_that_comes_as_a_service_begins_to_wait_ends_it(number: signal.Signals) -> None:
    command = [sys.executable, "-c", INTERRUPTED_WHILE_IT_HOLDS_THE_EVENT, str(int(number))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout == "ended\n", done.stderr
    assert done.returncode == 0


def test_a_service_says_where_its_threads_stand_and_goes_on() -> None:
    code = INTERRUPTED_WHILE_IT_HOLDS_THE_EVENT.replace(
        "assert stop", "os.kill(os.getpid(), serving.TRACE_SIGNAL); assert stop"
    )
    command = [sys.executable, "-c", code, str(int(signal.SIGTERM))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout == "ended\n"
    assert "in serve" in done.stderr


def test_an_output_that_nobody_reads_does_not_hold_a_service_up() -> None:
    reading, full = full_pipe()
    command = [sys.executable, "-c", INTERRUPTED_WHILE_IT_HOLDS_THE_EVENT, str(int(signal.SIGTERM))]
    done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, timeout=300, check=False)
    assert (done.returncode, done.stderr) == (0, b"ended")
    os.close(reading)
    os.close(full)
