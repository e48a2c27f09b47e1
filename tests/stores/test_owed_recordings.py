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
from guidefield.messages import requests
from guidefield.stores.run_folder import OWED
from guidefield.stores.runs import RunStore
from guidefield.system import is_alive, told_apart
from tests.replies import plan_reply

REQUEST = requests.PlanRequest(robot="panda", scene="bookshelf", goal=requests.GuidePlaneGoal())


@pytest.fixture
def store(tmp_path: Path) -> RunStore:
    kept = RunStore(tmp_path / "runs")
    kept.begin("r1", REQUEST)
    kept.owe_recording("r1")
    kept.finish("r1", plan_reply("r1"))
    return kept


def test_who_asks_for_a_recording_that_is_being_written_waits_for_it(store: RunStore) -> None:
    found: list[bytes] = []
    asker = threading.Thread(target=lambda: found.append(store.recording("r1").read_bytes()))
    asker.start()
    time.sleep(0.05)
    assert not found
    path = store.recording_path("r1")
    assert path is not None
    path.write_bytes(b"all of it")
    store.settle_recording("r1", None)
    asker.join(30.0)
    assert found == [b"all of it"]
    assert not (path.parent / OWED).exists()


def test_why_a_recording_was_not_kept_is_told(store: RunStore) -> None:
    store.settle_recording("r1", "it has 7 bytes, at most 6 are kept")
    with pytest.raises(UnknownObject, match="'r1' has no recording: it has 7 bytes, at most 6 are kept"):
        store.recording("r1")


def test_a_recording_whose_writer_died_is_lost_and_said_to_be(store: RunStore) -> None:
    ended = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    known = told_apart(ended.pid)
    assert is_alive(known)
    (store.recording_path("r1").parent / OWED).write_text(known)  # type: ignore[union-attr]
    ended.kill()
    ended.wait()
    with pytest.raises(UnknownObject, match=r"'r1' is lost: .* `guidefield replay r1` plans it again"):
        store.recording("r1")
    assert store.read("r1").reply == plan_reply("r1")


def test_a_process_is_told_from_a_later_one_of_its_number() -> None:
    pid, _, began = told_apart(os.getpid()).partition(" ")
    assert is_alive(f"{pid} {began}")
    assert not is_alive(f"{pid} {float(began) + 1.0}")
    assert not is_alive("")


def test_a_run_that_is_gone_is_not_made_again(store: RunStore) -> None:
    store.delete("r1")
    store.settle_recording("r1", "late")
    assert store.summaries() == []
