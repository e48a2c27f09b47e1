"""Arrays in a file of NumPy's own format: one record, whose fields are the arrays, and a checksum.

A large file is mapped, so that processes share its memory. Who makes large arrays may make them in the file.
"""

from __future__ import annotations

import io
import logging
import mmap
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
import xxhash

from guidefield.whole_file import draft_path, write_whole

_log = logging.getLogger(__name__)

MAPPED = 2**20
"""Files of more bytes are mapped; others are as soon read."""

Arrays = Mapping[str, np.ndarray]

Layout = Mapping[str, tuple[str, tuple[int, ...]]]
"""Type, as NumPy writes it, and shape of each array, by name."""

Room = Callable[[Layout], dict[str, np.ndarray]]
"""Gives arrays of such types and shapes to write in, all zero."""

_SUM = "checksum"
"""Field of the checksum."""

_ALIGNED = 64
"""Arrays begin at a multiple of it: kernels take no others, and so those of a large mesh needn't be copied."""

_UNREADABLE = (ValueError, EOFError, KeyError, TypeError, OverflowError, MemoryError)
"""Exceptions of NumPy for files that aren't of its format."""


def in_memory(layout: Layout) -> dict[str, np.ndarray]:
    """`Room` in memory alone."""
    return {name: np.zeros(shape, kind) for name, (kind, shape) in layout.items()}


def read(path: Path) -> dict[str, np.ndarray] | None:
    """Return the read-only arrays of a file by name, of their own shapes; None if there is no usable one."""
    try:
        with path.open("rb") as file:
            np.lib.format.read_magic(file)
            dtype = np.lib.format.read_array_header_1_0(file)[2]
            record = _rest(file).view(dtype)
        if len(record) != 1 or record[_SUM].tobytes() != _sum(record):
            raise ValueError("its checksum is another one")
        os.utime(path)
    except FileNotFoundError:
        return None
    except OSError as error:
        _log.warning("cannot read %s: %s", path, error)
        return None
    except _UNREADABLE as error:
        _log.warning("%s is damaged and is computed again (%s)", path, error)
        return None
    record.setflags(write=False)
    return _arrays_in(record)


def write(path: Path, arrays: Arrays) -> int:
    """Write arrays as a file; return its size [bytes]. OSError if it can't be written."""
    dtype = _dtype({name: (array.dtype.str, array.shape) for name, array in arrays.items()})
    header = _header(dtype)
    content = np.zeros(len(header) + dtype.itemsize, np.uint8)
    content[: len(header)] = np.frombuffer(header, np.uint8)
    record = content[len(header) :].view(dtype)
    for name, into in _arrays_in(record).items():
        into[...] = arrays[name]
    record[_SUM] = np.frombuffer(_sum(record), np.uint8)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    write_whole(path, content.data, durable=False)
    return len(content)


class Draft:
    """Arrays made in the memory of a file, which is there whole or not at all; in memory alone without a disk."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: Path | None = None
        self._record: np.ndarray | None = None

    def room(self, layout: Layout) -> dict[str, np.ndarray]:
        """Arrays to write in, of the types and shapes asked for, all zero; to be asked for once."""
        dtype = _dtype(layout)
        header = _header(dtype)
        try:
            self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._file = draft_path(self._path)
            with self._file.open("x+b") as file:
                file.write(header)
                file.flush()
                # on a disk that is full later, writing would end the process
                os.posix_fallocate(file.fileno(), 0, len(header) + dtype.itemsize)
                record = np.frombuffer(mmap.mmap(file.fileno(), 0), np.uint8)[len(header) :].view(dtype)
        except OSError as error:
            _log.warning("cannot keep %s: %s", self._path, error)
            self.drop()
            record = np.zeros(1, dtype)
        self._record = record
        return _arrays_in(record)

    def keep(self) -> tuple[dict[str, np.ndarray], int]:
        """The arrays, in their shapes, read-only from now on, and how many bytes the file has: 0 if there is none."""
        record, size = self._record, 0
        assert record is not None, "nothing was made"
        if self._file is not None:
            record[_SUM] = np.frombuffer(_sum(record), np.uint8)
            try:
                size = self._file.stat().st_size
                self._file.replace(self._path)
            except OSError as error:
                size = 0
                _log.warning("cannot keep %s: %s", self._path, error)
        record.setflags(write=False)
        return _arrays_in(record), size

    def drop(self) -> None:
        """Remove what was begun."""
        if self._file is not None:
            self._file.unlink(missing_ok=True)
            self._file = None


def _dtype(layout: Layout) -> np.dtype:
    names, formats, offsets, size = [_SUM], [np.dtype("(16,)u1")], [0], _ALIGNED
    for name, (kind, shape) in layout.items():
        names.append(name)
        formats.append(np.dtype((kind, shape)))
        offsets.append(size)
        size += -(-formats[-1].itemsize // _ALIGNED) * _ALIGNED
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


def _sum(record: np.ndarray) -> bytes:
    """Return the checksum of a record, of its type and of all of it but the checksum."""
    digest = xxhash.xxh3_128(repr(record.dtype.descr).encode())
    digest.update(record.view(np.uint8)[_ALIGNED:].data)
    return digest.digest()


def _header(dtype: np.dtype) -> bytes:
    header = io.BytesIO()
    told = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": (1,)}
    np.lib.format.write_array_header_1_0(header, told)
    return header.getvalue()


def _rest(file: BinaryIO) -> np.ndarray:
    begin = file.tell()
    if os.fstat(file.fileno()).st_size <= MAPPED:
        return np.frombuffer(bytearray(file.read()), np.uint8)
    return np.frombuffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), np.uint8)[begin:]


def _arrays_in(record: np.ndarray) -> dict[str, np.ndarray]:
    return {name: record[name][0] for name in record.dtype.names or () if name != _SUM}
