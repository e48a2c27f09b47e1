"""A process that is told to end ends, whichever thread takes the signal, in bounded time whatever its threads do."""

import os
import signal
import subprocess
import sys
import time

import pytest

from guidefield.cli import serving

PATIENCE = 300.0  # longer than anything here takes on a busy machine [s]

BEGINS = """
import ctypes, os, signal, sys, threading, time
from guidefield.cli import serving

def take_it():
    time.sleep(0.2)  # until the main thread waits
    signal.pthread_kill(threading.get_ident(), int(sys.argv[1]))

stop = threading.Event()
"""
IS_TOLD_IN_ANOTHER_THREAD = """
threading.Thread(target=take_it, daemon=True).start()
assert stop.wait(200.0)
print("told", flush=True)
"""
ENDS = BEGINS + "serving.end_on_signal(stop, 200.0)" + IS_TOLD_IN_ANOTHER_THREAD
SOON = "serving.DUMP_TIME_S = 2.0\n"  # where there can be no last words, they are not waited for as long as elsewhere
STAYS = BEGINS + "serving.end_on_signal(stop, 0.2)" + IS_TOLD_IN_ANOTHER_THREAD + "time.sleep(300.0)"
LINGERS = BEGINS + "serving.end_on_signal(stop, 300.0)" + IS_TOLD_IN_ANOTHER_THREAD + "time.sleep(300.0)"
KEEPS_THE_LOCK = (
    BEGINS + SOON + "serving.end_on_signal(stop, 0.2)" + IS_TOLD_IN_ANOTHER_THREAD + "ctypes.PyDLL(None).sleep(300)"
)


def _ended(program: str, number: signal.Signals = signal.SIGTERM) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", program, str(int(number))]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_that_another_thread_takes_is_heard_while_the_main_thread_waits(number: signal.Signals) -> None:
    done = _ended(ENDS, number)
    assert (done.returncode, done.stdout) == (0, "told\n"), done.stderr


def test_who_does_not_end_is_ended_by_force_and_says_where_it_stood() -> None:
    done = _ended(STAYS)
    assert done.returncode == serving.FORCED_EXIT_CODE
    assert "not ended 0.2 s after it was told to" in done.stderr
    assert "in <module>" in done.stderr


def test_who_keeps_the_interpreter_s_lock_is_ended_by_the_system() -> None:
    done = _ended(KEEPS_THE_LOCK)
    assert (done.returncode, done.stdout) == (-signal.SIGALRM, "told\n")


def test_who_is_stuck_and_can_not_say_so_is_ended_by_the_system() -> None:
    reading, full = full_pipe()
    program = STAYS.replace(BEGINS, BEGINS + SOON)
    command = [sys.executable, "-c", program, str(int(signal.SIGTERM))]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=full, timeout=PATIENCE, check=False)
    assert done.returncode == -signal.SIGALRM
    os.close(reading)
    os.close(full)


def test_a_second_signal_ends_the_process_at_once() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", LINGERS, str(int(signal.SIGTERM))], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "told\n"
        time.sleep(0.2)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 128 + signal.SIGINT


def full_pipe() -> tuple[int, int]:
    """The two ends of a pipe that takes not one byte more."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    for size in (1 << 16, 1):
        try:
            while True:
                os.write(writing, b"x" * size)
        except BlockingIOError:
            pass
    os.set_blocking(writing, True)
    return reading, writing
