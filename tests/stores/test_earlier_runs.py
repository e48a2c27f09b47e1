"""Runs that guidefield 0.1 kept in folders are taken over whole, whenever the process that does it is killed."""

import os
import shutil
import sqlite3
from pathlib import Path

import pytest

from guidefield.errors import DiskRefused, UnknownObject, WorkerCrashed
from guidefield.messages import codec
from guidefield.messages.identities import PLAIN
from guidefield.messages.replies import make_error_reply
from guidefield.messages.requests import UNREADABLE, ReadRuns
from guidefield.stores import run_rows
from guidefield.stores.run_file import FILE
from guidefield.stores.runs import RunDatabase
from tests.kept_runs import REQUEST
from tests.replies import plan_reply

CRASH = make_error_reply(WorkerCrashed("left behind"))


def _kept(folder: Path, *, began: float, **files: bytes) -> None:
    """A run as it was kept then."""
    folder.mkdir(parents=True)
    for name, content in {"request_json": codec.encode(REQUEST), **files}.items():
        (folder / name.replace("_", ".")).write_bytes(content)
    os.utime(folder / "request.json", (began, began))


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A data folder with runs of two users, and what a killed service left."""
    runs = tmp_path / "runs"
    reply = codec.encode(plan_reply("any"))
    _kept(runs / "second", began=2e9, reply_json=reply, recording_rrd=b"recorded")
    _kept(runs / "first", began=1e9, reply_json=reply, recording_lost=b"it was too large")
    _kept(runs / "crashed", began=1.5e9, error_json=codec.encode(CRASH))
    _kept(runs / "under_way", began=2.1e9)
    _kept(runs / "damaged", began=2.2e9, reply_json=reply[:20])
    (runs / ".0123.draft").mkdir()
    alice = tmp_path / "users" / "alice"
    _kept(alice / "runs" / "first", began=3e9, reply_json=reply)
    (alice / "shared" / "runs").mkdir(parents=True)
    (alice / "shared" / "runs" / "first").touch()
    return tmp_path


def _require_all(data: Path) -> None:
    database = RunDatabase(data)
    database.take_over(lambda _: None)
    database.sweep(CRASH)
    listed = database.of(PLAIN).list(ReadRuns()).runs
    assert {run.run_id: (run.status, run.began) for run in listed} == {
        "damaged": (UNREADABLE, 2.2e9),
        "under_way": ("CRASH", 2.1e9),
        "second": ("SUCCESS", 2e9),
        "crashed": ("CRASH", 1.5e9),
        "first": ("SUCCESS", 1e9),
        "alice:first": ("SUCCESS", 3e9),
    }
    own = [run.run_id for run in listed if ":" not in run.run_id]
    assert own == ["damaged", "under_way", "second", "crashed", "first"]
    second = next(run for run in listed if run.run_id == "second")
    assert second.bytes == len(codec.encode(REQUEST)) + len(codec.encode(plan_reply("any"))) + len(b"recorded")
    assert [run.run_id for run in database.of("bob").list(ReadRuns()).runs] == ["alice:first"]
    kept = database.of(PLAIN)
    assert kept.read("second").reply == plan_reply("any")
    assert kept.recordings.find("second").read_bytes() == b"recorded"
    with pytest.raises(UnknownObject, match="it was too large"):
        kept.recordings.find("first")
    assert not (data / "runs").exists()
    assert not (data / "users" / "alice" / "runs").exists()
    database.close()


def test_runs_in_folders_are_taken_over(data: Path) -> None:
    _require_all(data)
    _require_all(data)


@pytest.mark.parametrize("kept_up_to", range(6))
def test_a_kill_in_the_middle_loses_none(kept_up_to: int, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_rows, "AT_ONCE", 2)
    shutil.rmtree(data / "runs" / ".0123.draft")
    removed, steps = shutil.rmtree, iter(range(100))

    class KilledError(BaseException):
        pass

    def killed_later(folder: Path) -> None:
        if next(steps) == kept_up_to:
            raise KilledError
        removed(folder)

    with monkeypatch.context() as patched:
        patched.setattr(run_rows.shutil, "rmtree", killed_later)
        database = RunDatabase(data)
        with pytest.raises(KilledError):
            database.take_over(lambda _: None)
        database.close()
    _require_all(data)


def test_what_cannot_be_taken_over_stays(data: Path) -> None:
    (data / FILE).write_bytes(b"no database" * 1000)
    database = RunDatabase(data)
    with pytest.raises(DiskRefused, match="damaged"):
        database.take_over(lambda _: None)
    database.close()
    assert len(list((data / "runs").glob("*/request.json"))) == 5
    (data / FILE).unlink()
    _require_all(data)


def test_it_is_told_how_far_it_is(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_rows, "AT_ONCE", 2)
    told: list[str] = []
    database = RunDatabase(data)
    database.take_over(told.append)
    database.close()
    assert [sentence.rpartition(": ")[2] for sentence in told] == ["0 of 5", "2 of 5", "4 of 5", "0 of 1"]
    with sqlite3.connect(data / FILE) as db:
        assert db.execute("SELECT sum(runs) FROM usage").fetchone() == (5,), "one is under way still"
