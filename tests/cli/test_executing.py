"""Signals while a robot executes: the first one cancels, and no second one keeps it from doing so."""

import subprocess
import sys

SIGNALS = """
import signal
from guidefield.cli import executing

def is_interrupted(number):
    try:
        signal.raise_signal(number)
    except KeyboardInterrupt:
        return True
    return False

signal.signal(signal.SIGTERM, signal.SIG_IGN)
with executing._signals_interrupt():
    print(is_interrupted(signal.SIGTERM))
signal.signal(signal.SIGTERM, signal.SIG_DFL)
with executing._signals_interrupt():
    print(*map(is_interrupted, (signal.SIGHUP, signal.SIGHUP, signal.SIGTERM, signal.SIGINT)))
print(all(signal.getsignal(one) is signal.SIG_DFL for one in (signal.SIGTERM, signal.SIGHUP)))
"""


def test_a_second_signal_does_not_interrupt_what_the_first_one_began() -> None:
    ran = subprocess.run([sys.executable, "-c", SIGNALS], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines() == ["False", "True False False True", "True"]
