"""A file is there whole or not at all, whatever the disk does."""

import io
from pathlib import Path

import pytest

from guidefield.whole_file import write_whole


def test_a_file_is_written_and_replaced(tmp_path: Path) -> None:
    for durable, data in ((True, b"old"), (False, b"new"), (True, b"")):
        write_whole(tmp_path / "reply.json", data, durable=durable)
        assert (tmp_path / "reply.json").read_bytes() == data
    assert list(tmp_path.iterdir()) == [tmp_path / "reply.json"]


@pytest.mark.parametrize("durable", [True, False])
def test_a_write_that_fails_leaves_the_old_contents_and_nothing_else(tmp_path, monkeypatch, durable):
    path = tmp_path / "reply.json"
    write_whole(path, b"old")

    class FullDisk(io.FileIO):
        def write(self, data: object) -> int:
            super().write(b"n")
            raise OSError(28, "No space left on device")

    def opened(file: Path, mode: str) -> FullDisk:
        return FullDisk(file, mode)

    monkeypatch.setattr(Path, "open", opened)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, b"new", durable=durable)
    monkeypatch.undo()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_flush_that_fails_leaves_the_old_contents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "reply.json"
    write_whole(path, b"old")

    def no_space_left(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", no_space_left)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
