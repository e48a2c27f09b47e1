"""Files of arrays: what was written is read, mapped or not, and what was altered is found."""

import logging
from pathlib import Path

import numpy as np
import pytest

from guidefield.geometry.cache import MAPPED, Draft, allocate_in_memory, read_arrays, write_arrays

MANY = 3 * MAPPED // 8
LAYOUT = {"numbers": ("<f8", (MANY,)), "kinds": ("<i4", (3, 5)), "none": ("<f4", (0, 2)), "some": ("|u1", (7,))}


def filled(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    for array in arrays.values():
        array[...] = rng.integers(0, 100, array.shape)
    return arrays


def check(arrays: dict[str, np.ndarray] | None, written: dict[str, np.ndarray]) -> None:
    assert list(arrays) == list(written)
    for name, array in arrays.items():
        assert array.dtype == written[name].dtype
        assert array.shape == written[name].shape
        assert array.tobytes() == written[name].tobytes()
        assert not array.flags.writeable
        assert array.flags.c_contiguous
        assert array.ctypes.data % array.itemsize == 0


def test_what_is_made_in_place_is_read_again(tmp_path: Path) -> None:
    path, wanted = tmp_path / "folder" / "entry", filled(allocate_in_memory(LAYOUT))
    draft = Draft(path)
    made = draft.allocate(LAYOUT)
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


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9999])
@pytest.mark.parametrize("bit", [0, 7])
def test_one_bit_that_is_another_is_found(
    share: float, bit: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "entry"
    write_arrays(path, filled(allocate_in_memory(LAYOUT)))
    content = bytearray(path.read_bytes())
    content[int(share * len(content))] ^= 1 << bit
    path.write_bytes(content)
    with caplog.at_level(logging.WARNING):
        assert read_arrays(path) is None
    assert "damaged" in caplog.text
