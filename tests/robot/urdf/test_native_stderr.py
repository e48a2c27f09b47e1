"""What native libraries write to stderr is caught, and stderr is itself again afterwards."""

import os
import threading
from contextlib import suppress

import pinocchio as pin
import pytest

from guidefield.robot.model.neutral_names import capture_stderr

NAMELESS = "<robot><link name='a'/></robot>"


def test_the_reason_of_a_native_library_is_told():
    with capture_stderr() as stderr, pytest.raises(ValueError, match="valid URDF"):
        pin.buildModelFromXML(NAMELESS)
    assert "No name given for the robot." in stderr.text()
    assert stderr.reason() == "No name given for the robot."


def test_it_is_readable_within_and_after():
    with capture_stderr() as stderr:
        assert stderr.text() == ""
        os.write(2, b"Error:   first\n         at line 3 in /a/b.cpp\n")
        assert stderr.reason() == "first"
        os.write(2, b"Error:   second\nfirst\n")
    assert stderr.reason() == "first; second"


def test_stderr_is_itself_again_also_after_an_error(capfd):
    with suppress(KeyError), capture_stderr():
        os.write(2, b"inside")
        raise KeyError
    os.write(2, b"outside")
    assert capfd.readouterr().err == "outside"


def test_captures_of_threads_wait_for_each_other():
    seen = []

    def capture(word: bytes) -> None:
        for _ in range(20):
            with capture_stderr() as stderr:
                os.write(2, word)
            seen.append((word.decode(), stderr.text()))

    threads = [threading.Thread(target=capture, args=(word,)) for word in (b"one", b"two", b"three")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(seen) == 60
    assert all(written == caught for written, caught in seen)
