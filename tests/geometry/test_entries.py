"""Files of arrays: what was written is read, mapped or not, and what was altered is found."""

from __future__ import annotations

import errno
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from guidefield.geometry import cache
from guidefield.geometry.cache import MAPPED, Draft, in_memory, read_arrays, write_arrays

MANY = 3 * MAPPED // 8
LAYOUT = {"numbers": ("<f8", (MANY,)), "kinds": ("<i4", (3, 5)), "none": ("<f4", (0, 2)), "some": ("|u1", (7,))}


def filled(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    for array in arrays.values():
        array[...] = rng.integers(0, 100, array.shape)
    return arrays


def check(arrays: dict[str, np.ndarray] | None, written: dict[str, np.ndarray]) -> None:
    assert arrays is not None
    assert list(arrays) == list(written)
    for name, array in arrays.items():
        assert array.dtype == written[name].dtype
        assert array.shape == written[name].shape
        assert array.tobytes() == written[name].tobytes()
        assert not array.flags.writeable
        assert array.flags.c_contiguous
        assert array.ctypes.data % array.itemsize == 0


def test_what_is_made_in_place_is_read_again(tmp_path: Path) -> None:
    path, wanted = tmp_path / "folder" / "entry", filled(in_memory(LAYOUT))
    draft = Draft(path)
    made = draft.room(LAYOUT)
    assert not any(array.any() for array in made.values())
    filled(made)
    assert read_arrays(path) is None, "it isn't whole yet"
    kept, size = draft.keep()
    draft.drop()
    assert size == path.stat().st_size > MAPPED
    check(kept, wanted)
    check(read_arrays(path), wanted)
    assert list(path.parent.iterdir()) == [path]
    in_place = path.read_bytes()
    write_arrays(path, wanted)
    assert path.read_bytes() == in_place, "it is the same file, whoever writes it"


def test_what_goes_stays_where_it_was_read(tmp_path: Path) -> None:
    path, wanted = tmp_path / "entry", filled(in_memory(LAYOUT))
    write_arrays(path, wanted)
    found = read_arrays(path)
    write_arrays(path, {name: array[:0] for name, array in wanted.items()})
    path.unlink()
    check(found, wanted)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9999])
@pytest.mark.parametrize("bit", [0, 7])
def test_one_bit_that_is_another_is_found(
    share: float, bit: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "entry"
    write_arrays(path, filled(in_memory(LAYOUT)))
    content = bytearray(path.read_bytes())
    content[int(share * len(content))] ^= 1 << bit
    path.write_bytes(content)
    with caplog.at_level(logging.WARNING):
        assert read_arrays(path) is None
    assert "damaged" in caplog.text


def test_without_room_it_is_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "no space left")

    monkeypatch.setattr(cache.os, "posix_fallocate", full)
    draft = Draft(tmp_path / "entry")
    filled(draft.room(LAYOUT))
    kept, size = draft.keep()
    assert size == 0
    check(kept, filled(in_memory(LAYOUT)))
    assert "no space left" in caplog.text
    assert not list(tmp_path.iterdir())


def test_what_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(room: cache.Room) -> None:
        room(LAYOUT)
        raise RuntimeError("no")

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(RuntimeError, match="no"):
        cache.make_in_place("large", {}, fail)
    assert not list(cache.folder().iterdir())
    made = cache.make_in_place("large", {}, lambda room: filled(room(LAYOUT)))
    check(made, filled(in_memory(LAYOUT)))
    check(cache.make_in_place("large", {}, lambda room: filled(room(LAYOUT))), made)
