"""Arrays in a file: it starts with a checksum of all that follows, and large ones are read where the system has them.

A file of many megabytes is mapped: memory that others read too, of which no copy is made. All of it is summed before
anything of it is used. Who makes large arrays may have them made in the file, so that none is written a second time.
"""

from __future__ import annotations

import hashlib
import logging
import math
import mmap
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from guidefield.kernels.linalg.page_sums import PAGE, page_sums
from guidefield.whole_file import draft_path, write_whole

_log = logging.getLogger(__name__)

MAPPED = 2**20
"""Files of more bytes are mapped; others are as soon read."""

Arrays = Mapping[str, np.ndarray]

Layout = Mapping[str, tuple[str, tuple[int, ...]]]
"""Type, as NumPy writes it, and shape of each array, by name."""

Room = Callable[[Layout], dict[str, np.ndarray]]
"""Gives arrays of such types and shapes to write in, all zero."""


class _Stored(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An array as it is on disk, `offset` bytes behind where the first begins."""

    dtype: Literal["<f8", "<f4", "<i8", "<i4", "|u1", "|b1"]
    shape: tuple[int, ...]
    offset: int


_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(dict[str, _Stored]).decode

_DIGEST = hashlib.sha256().digest_size

_ALIGNED = 64
"""What arrays begin at a multiple of: kernels take no others, and so those of a large mesh needn't be copied."""

_LENGTH = np.dtype("<i8")
"""Of the number behind the checksum: how long the list of the arrays is."""

_KEYS = np.frombuffer(hashlib.shake_128(b"guidefield").digest(8 * (PAGE + 1)), "<u8")


def in_memory(layout: Layout) -> dict[str, np.ndarray]:
    """`Room` in memory alone."""
    return {name: np.zeros(shape, kind) for name, (kind, shape) in layout.items()}


def read(path: Path) -> dict[str, np.ndarray] | None:
    """The arrays of a file, read-only, in the shapes in which they were written, by name.

    None if there is no such file, or none that can be used, which is logged.
    """
    try:
        content = _content(path)
        os.utime(path)
    except FileNotFoundError:
        return None
    except OSError as error:
        _log.warning("cannot read %s: %s", path, error)
        return None
    if checksum(content[_DIGEST:]) != content[:_DIGEST].tobytes():
        _log.warning("%s is damaged and is computed again", path)
        return None
    content.setflags(write=False)
    try:
        return _arrays_in(content)
    except (msgspec.DecodeError, ValueError) as error:
        _log.warning("%s is not understood (%s) and is computed again", path, error)
        return None


def checksum(payload: np.ndarray) -> bytes:
    """What bytes, shape (n,), are known by: a hash of the sums of their pages, and of what is left behind them."""
    whole = len(payload) // 8 * 8
    words = payload[:whole].view("<u8")
    sums = np.empty((-(-len(words) // PAGE), 2), np.uint64)
    page_sums(words, _KEYS, sums)
    digest = hashlib.sha256(len(payload).to_bytes(8, "little"))
    digest.update(sums.data)
    digest.update(payload[whole:].data)
    return digest.digest()


def write(path: Path, arrays: Arrays) -> int:
    """Write arrays, contiguous ones, as a file; how many bytes it has.

    Raises:
        OSError: if it can't be written.
    """
    header, size = _header({name: (array.dtype.str, array.shape) for name, array in arrays.items()})
    content = np.zeros(size, np.uint8)
    content[_DIGEST : _DIGEST + len(header)] = np.frombuffer(header, np.uint8)
    for name, into in _arrays_in(content).items():
        into[...] = arrays[name]
    content[:_DIGEST] = np.frombuffer(checksum(content[_DIGEST:]), np.uint8)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    write_whole(path, content.data, durable=False)
    return size


class Draft:
    """Arrays that are made in the memory of a file, which is there whole or not at all.

    Where there is no disk, or no room on it, they are in memory alone, and a warning is logged.

    Args:
        path: Of the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: Path | None = None
        self._content: np.ndarray | None = None

    def room(self, layout: Layout) -> dict[str, np.ndarray]:
        """Arrays to write in, of the types and shapes asked for, all zero; to be asked for once."""
        header, size = _header(layout)
        try:
            self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._file = draft_path(self._path)
            content = _mapped(self._file, size)
        except OSError as error:
            _log.warning("cannot keep %s: %s", self._path, error)
            self.drop()
            content = np.zeros(size, np.uint8)
        content[_DIGEST : _DIGEST + len(header)] = np.frombuffer(header, np.uint8)
        self._content = content
        return _arrays_in(content)

    def keep(self) -> tuple[dict[str, np.ndarray], int]:
        """The arrays, in their shapes, read-only from now on, and how many bytes the file has: 0 if there is none."""
        content, size = self._content, 0
        assert content is not None, "nothing was made"
        if self._file is not None:
            content[:_DIGEST] = np.frombuffer(checksum(content[_DIGEST:]), np.uint8)
            try:
                self._file.replace(self._path)
                size = len(content)
            except OSError as error:
                _log.warning("cannot keep %s: %s", self._path, error)
        content.setflags(write=False)
        return _arrays_in(content), size

    def drop(self) -> None:
        """Remove what was begun."""
        if self._file is not None:
            self._file.unlink(missing_ok=True)
            self._file = None


def _content(path: Path) -> np.ndarray:
    """The bytes of a file, of a large one where the system has them."""
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size <= MAPPED:
            return np.fromfile(file, np.uint8)
        return np.frombuffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), np.uint8)


def _mapped(path: Path, size: int) -> np.ndarray:
    """A new file of so many bytes, all zero, as memory that can be written.

    Raises:
        OSError: if there is no room for it.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        os.posix_fallocate(descriptor, 0, size)  # on a disk that is full later, writing would end the process
        return np.frombuffer(mmap.mmap(descriptor, size), np.uint8)
    finally:
        os.close(descriptor)


def _header(layout: Layout) -> tuple[bytes, int]:
    """What stands between the checksum and the arrays, and how many bytes there are with them."""
    listed, size = dict[str, _Stored](), 0
    for name, (kind, shape) in layout.items():
        listed[name] = _Stored(kind, shape, size)  # type: ignore[arg-type]
        size += _up(math.prod(shape) * np.dtype(kind).itemsize)
    header = _encode(listed)
    return len(header).to_bytes(_LENGTH.itemsize, "little") + header, _begin(len(header)) + size


def _arrays_in(content: np.ndarray) -> dict[str, np.ndarray]:
    """The arrays of a file's bytes, in the same memory; ValueError or msgspec.DecodeError if there are none."""
    start = _DIGEST + _LENGTH.itemsize
    length = int(content[_DIGEST:start].view(_LENGTH)[0])
    first, arrays = _begin(length), {}
    for name, stored in _decode(content[start : start + length].data).items():
        kind, begin = np.dtype(stored.dtype), first + stored.offset
        end = begin + math.prod(stored.shape) * kind.itemsize
        arrays[name] = content[begin:end].view(kind).reshape(stored.shape)
    return arrays


def _begin(length: int) -> int:
    """Where the first array begins, behind a list of so many bytes."""
    return _up(_DIGEST + _LENGTH.itemsize + length)


def _up(size: int) -> int:
    """The next multiple of `_ALIGNED`."""
    return -(-size // _ALIGNED) * _ALIGNED
