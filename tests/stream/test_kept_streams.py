"""Where journals are kept: the oldest streams make paths, and one of the same name begins anew."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.stream.journal import FILE_BYTES, MOST_FILES, MOST_KEPT, begin, file_bytes, kept_files


def test_the_oldest_make_room_and_a_name_begins_anew(tmp_path: Path) -> None:
    streams = tmp_path / "streams"
    for index in range(MOST_KEPT + 2):
        folder = begin(streams, f"s{index}")
        (folder / "000001.stream").write_bytes(b"x")
        os.utime(folder / "000001.stream", (index, index))
        os.utime(folder, (index, index))
    assert {folder.name for folder in streams.iterdir()} == {f"s{index}" for index in range(2, MOST_KEPT + 2)}
    again = begin(streams, "s5")
    assert list(again.iterdir()) == []
    assert len(list(streams.iterdir())) == MOST_KEPT


def test_all_streams_of_a_user_keep_its_quota() -> None:
    assert file_bytes(None) == FILE_BYTES
    assert MOST_KEPT * MOST_FILES * file_bytes(2**20) <= 2**20
    assert file_bytes(2**40) == FILE_BYTES


def test_files_are_asked_for_by_the_name_of_its_stream(tmp_path: Path) -> None:
    folder = begin(tmp_path / "streams", "s")
    with pytest.raises(UnknownObject, match="nothing is kept of a stream 's'"):
        kept_files(tmp_path / "streams", "s")
    for number in (1, 2):
        (folder / f"{number:06}.stream").write_bytes(b"x")
    assert [file.stem for file in kept_files(tmp_path / "streams", "s")] == ["000001", "000002"]
    for name in ("..", "../streams/s", ".", "", "s/../s"):
        with pytest.raises(MalformedRequest, match="stream_id"):
            kept_files(tmp_path / "streams", name)
    with pytest.raises(UnknownObject):
        kept_files(tmp_path / "nowhere", "s")
    assert not (tmp_path / "nowhere").exists(), "looking leaves no folder behind"
