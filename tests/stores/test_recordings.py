"""Recordings and the logs that they are rendered from: kept, settled and deleted, with what logs share."""

import os
from functools import partial
from pathlib import Path

import pytest

from guidefield.errors import UnknownObject
from guidefield.stores.recordings import (
    LOG,
    LOST,
    RECORDING,
    ROBOT,
    SCENE,
    SCENE_LINK,
    KeptRecording,
    Recordings,
    SharedFile,
)


@pytest.fixture
def recordings(tmp_path: Path) -> Recordings:
    """Recordings of which that of `r1` is owed."""
    kept = Recordings(tmp_path / "recordings")
    kept.store_log("r1", b"log of r1", ())
    return kept


def shared(content: bytes, ending: str = SCENE, digest: str = "d1") -> SharedFile:
    return SharedFile(digest, ending, lambda: content)


def names(folder: Path) -> set[str]:
    return {file.name for file in folder.iterdir()}


def state(recordings: Recordings, run_id: str) -> os.stat_result:
    return recordings.file(run_id, LOG).stat()


def test_a_log_is_the_mark_of_a_recording_that_is_owed(recordings: Recordings) -> None:
    assert recordings.describe("r1") == KeptRecording("owed", len(b"log of r1"))
    with pytest.raises(UnknownObject, match="'r1' isn't rendered yet; `guidefield runs render` does it"):
        recordings.find("r1")
    recordings.path("r1").write_bytes(b"all of it")
    recordings.settle("r1", state(recordings, "r1"))
    assert recordings.find("r1").read_bytes() == b"all of it"
    assert recordings.describe("r1") == KeptRecording("rendered", len(b"all of it"))
    assert names(recordings.folder) == {"r1.rrd"}
    recordings.file("r1", SCENE_LINK).write_bytes(b"its scene")
    assert recordings.describe("r1") == KeptRecording("rendered", len(b"all of it") + len(b"its scene"))


def test_why_a_recording_is_lost_is_told(recordings: Recordings) -> None:
    recordings.settle("r1", state(recordings, "r1"), "it has 7 bytes, at most 6 are kept")
    with pytest.raises(UnknownObject, match="'r1' has no recording: it has 7 bytes, at most 6 are kept"):
        recordings.find("r1")
    assert recordings.describe("r1").kind == "lost"
    with pytest.raises(UnknownObject, match=r"'r2' has no recording$"):
        recordings.find("r2")
    assert recordings.describe("r2") == KeptRecording("none")


def test_what_logs_share_is_kept_once_and_goes_with_the_last_of_them(recordings: Recordings) -> None:
    asked: list[str] = []

    def content(of: str) -> bytes:
        asked.append(of)
        return bytes(50_000)

    for number in range(3):
        files = [SharedFile("d1", SCENE, partial(content, "scene")), SharedFile("d2", ROBOT, partial(content, "robot"))]
        recordings.store_log(f"s{number}", b"log", files)
    assert asked == ["scene", "robot"]
    assert names(recordings.shared_folder) == {"d1", "d2"}
    assert recordings.describe("s0") == KeptRecording("owed", 3 + 100_000)
    recordings.drop("s0")
    recordings.sweep_shared(unused=0.0)
    recordings.settle("s1", state(recordings, "s1"), "lost")
    recordings.sweep_shared(unused=0.0)
    assert names(recordings.shared_folder) == {"d1", "d2"}
    assert recordings.file("s2", SCENE).read_bytes() == bytes(50_000)
    recordings.settle("s2", state(recordings, "s2"))
    recordings.sweep_shared()
    assert names(recordings.shared_folder) == {"d1", "d2"}, "they were used just now"
    recordings.sweep_shared(unused=0.0)
    assert names(recordings.shared_folder) == set()
    assert names(recordings.folder) == {"r1.log", "s1.lost"}


def test_a_sweep_deletes_what_killed_processes_left(recordings: Recordings) -> None:
    recordings.store_log("s1", b"log", [shared(b"content")])
    recordings.store_log("s2", b"log", [shared(b"content"), shared(b"other", ROBOT, "d2")])
    recordings.file("s2", LOG).unlink()
    (recordings.folder / ".s3.log.1234.draft").write_bytes(b"half")
    (recordings.folder / "old.owed").write_text("1234 5678.9")  # of an earlier version
    recordings.sweep()
    assert names(recordings.folder) == {"r1.log", "s1.log", "s1.scene", "old.lost"}
    assert names(recordings.shared_folder) == {"d1"}
    with pytest.raises(UnknownObject, match="'old' has no recording: the process that wrote it ended"):
        recordings.find("old")
    recordings.drop("s1")
    recordings.sweep()
    assert not recordings.shared_folder.exists()


def test_a_deleted_run_leaves_nothing(recordings: Recordings) -> None:
    recordings.store_log("s1", b"log", [shared(b"content"), shared(b"other", ROBOT, "d2")])
    for ending in (RECORDING, LOST):
        recordings.file("s1", ending).write_bytes(b"")
    recordings.drop("s1")
    assert names(recordings.folder) == {"r1.log"}
