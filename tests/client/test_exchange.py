"""Waiting for an answer."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import Future

import pytest

from guidefield.client.exchange import awaited
from guidefield.errors import ServerBusy

INTERRUPTED_IN_ANOTHER_THREAD = """
import signal, sys, threading, time
from concurrent.futures import Future
from guidefield.client.exchange import awaited

def take_it():
    time.sleep(0.2)  # until the main thread waits
    signal.pthread_kill(threading.get_ident(), signal.SIGINT)

signal.signal(signal.SIGINT, signal.default_int_handler)
threading.Thread(target=take_it, daemon=True).start()
try:
    awaited(Future())
except KeyboardInterrupt:
    sys.exit("interrupted")
"""


def test_an_answer_is_what_it_holds_or_raises_it() -> None:
    answer: Future[bytes] = Future()
    answer.set_result(b"answer")
    assert awaited(answer) == b"answer"
    refused: Future[bytes] = Future()
    refused.set_exception(ServerBusy("later"))
    with pytest.raises(ServerBusy, match="later"):
        awaited(refused)


def test_a_ctrl_c_that_another_thread_takes_interrupts_the_wait() -> None:
    command = [sys.executable, "-c", INTERRUPTED_IN_ANOTHER_THREAD]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stderr) == (1, "interrupted\n")
