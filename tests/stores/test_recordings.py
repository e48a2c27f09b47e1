"""Recordings that are written after the reply: who asks waits, and hears it where one is lost."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from guidefield.errors import UnknownObject
from guidefield.stores.recordings import Recordings
from guidefield.system import is_alive, told_apart


@pytest.fixture
def recordings(tmp_path: Path) -> Recordings:
    """Where this process owes the recording of `r1`."""
    kept = Recordings(tmp_path)
    kept.owe("r1")
    return kept


def test_who_asks_for_a_recording_that_is_being_written_waits_for_it(recordings: Recordings) -> None:
    found: list[bytes] = []
    asker = threading.Thread(target=lambda: found.append(recordings.find("r1").read_bytes()))
    asker.start()
    time.sleep(0.05)
    assert not found
    assert recordings.size("r1") is None
    recordings.path("r1").write_bytes(b"all of it")
    recordings.settle("r1", None)
    asker.join(30.0)
    assert found == [b"all of it"]
    assert recordings.size("r1") == len(b"all of it")
    assert [file.name for file in recordings.folder.iterdir()] == ["r1.rrd"]


def test_why_a_recording_was_not_kept_is_told(recordings: Recordings) -> None:
    recordings.settle("r1", "it has 7 bytes, at most 6 are kept")
    with pytest.raises(UnknownObject, match="'r1' has no recording: it has 7 bytes, at most 6 are kept"):
        recordings.find("r1")
    assert recordings.size("r1") == 0
    with pytest.raises(UnknownObject, match=r"'r2' has no recording$"):
        recordings.find("r2")


def test_a_recording_whose_writer_died_is_lost_and_said_to_be(recordings: Recordings, tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    known = told_apart(ended.pid)
    assert is_alive(known)
    (tmp_path / "r1.owed").write_text(known)
    ended.kill()
    ended.wait()
    with pytest.raises(UnknownObject, match=r"'r1' is lost: .* `guidefield replay r1` plans it again"):
        recordings.find("r1")
    assert recordings.size("r1") == 0


def test_a_process_is_told_from_a_later_one_of_its_number() -> None:
    pid, _, began = told_apart(os.getpid()).partition(" ")
    assert is_alive(f"{pid} {began}")
    assert not is_alive(f"{pid} {float(began) + 1.0}")
    assert not is_alive("")


def test_the_recording_of_a_run_that_was_dropped_meanwhile_goes(recordings: Recordings) -> None:
    recordings.drop("r1")
    recordings.path("r1").write_bytes(b"late")
    recordings.settle("r1", None)
    assert list(recordings.folder.iterdir()) == []
