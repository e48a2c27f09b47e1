"""A disk cache of computed arrays, by a hash of all that they depend on, the sources of what computes them included.

So no entry survives a change, be it of a comment, of the file that made it, or of those of `_PACKAGES` that this
imports: no version has to be raised. Entries are files, whole and shared by processes, of
``<cache>/guidefield/geometry`` (``XDG_CACHE_HOME`` or ``~/.cache``): one record in NumPy's own format, whose fields are
a checksum and the arrays. Large files are mapped, and large arrays are made in them. When the folder is full, the least
recently used entries go. Sizes and shares are memory and time alone; an unreadable file is computed anew.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import io
import logging
import mmap
import os
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
import xxhash

from guidefield.whole_file import draft_path, write_whole

_log = logging.getLogger(__name__)

MAPPED = 2**20  # files of more bytes are mapped; smaller ones are read as fast

Arrays = Mapping[str, np.ndarray]

Layout = Mapping[str, tuple[str, tuple[int, ...]]]  # type, as NumPy writes it, and shape of each array, by name
Allocate = Callable[[Layout], dict[str, np.ndarray]]  # makes arrays of such types and shapes to write in, all zero

_SUM = "checksum"  # field of the checksum

_ALIGNED = 64
"""Arrays begin at a multiple of it [bytes], so that kernels take those of a mapped file without a copy."""

_UNREADABLE = (ValueError, EOFError, KeyError, TypeError, OverflowError, MemoryError)
"""Exceptions of NumPy for files that aren't of its format."""


def allocate_in_memory(layout: Layout) -> dict[str, np.ndarray]:
    """`Allocate` in memory alone."""
    return {name: np.zeros(shape, kind) for name, (kind, shape) in layout.items()}


def read_arrays(path: Path) -> dict[str, np.ndarray] | None:
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


def write_arrays(path: Path, arrays: Arrays) -> int:
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

    def allocate(self, layout: Layout) -> dict[str, np.ndarray]:
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
    digest = xxhash.xxh3_128(repr(record.dtype.descr).encode())
    digest.update(record.view(np.uint8)[_ALIGNED:].data)
    return digest.digest()


def _header(dtype: np.dtype) -> bytes:
    header = io.BytesIO()
    fields = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": (1,)}
    np.lib.format.write_array_header_1_0(header, fields)
    return header.getvalue()


def _rest(file: BinaryIO) -> np.ndarray:
    begin = file.tell()
    if os.fstat(file.fileno()).st_size <= MAPPED:
        return np.frombuffer(bytearray(file.read()), np.uint8)
    return np.frombuffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), np.uint8)[begin:]


def _arrays_in(record: np.ndarray) -> dict[str, np.ndarray]:
    return {name: record[name][0] for name in record.dtype.names or () if name != _SUM}


MOST_BYTES = 4 * 2**30  # size of the folder, beyond which entries are removed; docs/service.md states it
TRIMMED_SHARE = 0.75  # the share of that which is left then

CHECK_SHARE = 0.01
"""A process sums up the folder at its first entry, and each time that it has written this share of `MOST_BYTES`."""

LARGE = 10_000
"""A mesh of fewer triangles isn't worth a file: its results are made in some hundredths of a second."""

STALE = 3600.0  # a draft of that age was left by a process that was killed [s]

_PACKAGE = Path(__file__).parent.parent
_PACKAGES = ("collision", "geometry", "kernels", "scene")
"""The packages whose sources count for an entry's hash; a new one with code that computes entries has to be added. Of
others the maker's own file counts: what it imports from there, such as a constant, has to be among the inputs."""

_COMPUTING = tuple(f"{_PACKAGE.name}.{room}." for room in _PACKAGES)

_COMMENT = re.compile(r"#[^\n]*")
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+([^\n]*))", re.MULTILINE
)
_ALIAS = re.compile(r"[ \t]+as[ \t]+\w+")


def find_or_compute(kind: str, inputs: Arrays, make: Callable[[], Arrays]) -> dict[str, np.ndarray]:
    """Return what `make` returns, read-only, from disk if it was computed from the same inputs before.

    Args:
        kind: A short name of what is computed.
        inputs: All that the result depends on, by name; numbers as arrays of no dimension.
        make: Computes arrays of float64, int64, int32, uint8 or bool, of one dimension at least, by name.
    """
    arrays = recall(kind, inputs, make)
    if arrays is None:
        arrays = {name: np.ascontiguousarray(array) for name, array in make().items()}
        _write(_path(kind, inputs, make), arrays)
        for array in arrays.values():
            array.setflags(write=False)
    return arrays


def make_in_place(kind: str, inputs: Arrays, make: Callable[[Allocate], object]) -> dict[str, np.ndarray]:
    """`find_or_compute` for results so large that `make` writes them in arrays, asked for once, of their file."""
    path = _path(kind, inputs, make)
    arrays = read_arrays(path)
    if arrays is None:
        draft = Draft(path)
        try:
            make(draft.allocate)
            arrays, size = draft.keep()
        finally:
            draft.drop()
        if size:
            _count(path.parent, size)
    return arrays


def keep_file(name: str, content: bytes) -> Path:
    """Keep a file of a unique name beside the entries; OSError if it can't be written."""
    path = folder() / name
    if path.is_file() and path.stat().st_size == len(content):
        os.utime(path)
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, content, durable=False)
    _count(path.parent, len(content))
    return path


def is_large(triangles: int) -> bool:
    """Whether what is found for a mesh with a given number of triangles is worth a file."""
    return triangles >= LARGE


def recall(kind: str, inputs: Arrays, make: Callable[..., object]) -> dict[str, np.ndarray] | None:
    """Return what `find_or_compute` would, without computing it; None if it isn't on disk."""
    return read_arrays(_path(kind, inputs, make))


def entry_name(kind: str, inputs: Arrays, make: Callable[..., object]) -> str:
    """Return the file name of an entry of `find_or_compute`: the same for the same question."""
    return _path(kind, inputs, make).name


def folder() -> Path:
    """Where entries are kept; a relative ``XDG_CACHE_HOME`` is ignored, as its specification has it."""
    chosen = os.environ.get("XDG_CACHE_HOME", "")
    base = Path(chosen) if Path(chosen).is_absolute() else Path.home() / ".cache"
    return base / "guidefield" / "geometry"


def _path(kind: str, inputs: Arrays, make: Callable[..., object]) -> Path:
    return folder() / f"{kind}-{_key(kind, inputs, make)}"


def _key(kind: str, inputs: Arrays, make: Callable[..., object]) -> str:
    digest = hashlib.sha256(f"{_sources(make.__module__)} {kind}".encode())
    for name, array in sorted(inputs.items()):
        digest.update(f"\0{name} {array.dtype.str} {array.shape}\0".encode())
        digest.update(_bytes_of(array))
    return digest.hexdigest()


def _bytes_of(array: np.ndarray) -> memoryview:
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data


@functools.cache
def _sources(module: str) -> str:
    """Hash NumPy's and Coal's versions, a module, and all that it imports of `_PACKAGES`, directly or not."""
    import coal  # loaded already where an entry is computed

    found: set[str] = set()
    waiting = {module}
    digest = hashlib.sha256(f"{np.__version__} {coal.__version__}".encode())
    while waiting:
        found |= waiting
        waiting = {needed for name in waiting for needed in _imports(name)} - found
    for name in sorted(found):
        if (path := _source(name)) is not None:
            digest.update(b"\0" + name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _imports(module: str) -> set[str]:
    path = _source(module)
    return set() if path is None else {name for name in _find_named_in(path) if _source(name) is not None}


@functools.cache
def _find_named_in(path: Path) -> set[str]:
    return _find_named(path.read_bytes().decode())


def _find_named(source: str) -> set[str]:
    """Find all computing modules that a source may import; Python's own parser takes a hundred times as long."""
    named: set[str] = set()
    for room, inside, listed in _IMPORT.findall(_COMMENT.sub("", source)):
        names = _ALIAS.sub("", inside or listed).strip("() \t\r\n").split(",")
        named.update(f"{room}.{name.strip()}" if room else name.strip() for name in names if name.strip())
        named.add(room)
    return {name for name in named if name.startswith(_COMPUTING)}


def _source(module: str) -> Path | None:
    return _file(_PACKAGE, module) if module.startswith(f"{_PACKAGE.name}.") else None


@functools.cache
def _file(package: Path, module: str) -> Path | None:
    """File of a module of a package; None if there is no such: that a thousand names are none takes 10 ms to see."""
    path = os.path.join(package.parent, *module.split(".")) + ".py"  # noqa: PTH118  a third of the time of a Path
    return Path(path) if os.path.isfile(path) else None  # noqa: PTH113


def _write(path: Path, arrays: Arrays) -> None:
    try:
        size = write_arrays(path, arrays)
    except OSError as error:
        _log.warning("cannot keep %s: %s", path, error)
    else:
        _count(path.parent, size)


def _count(parent: Path, size: int) -> None:
    """Add to what was written to a folder, and trim it if that is enough to check it again."""
    _written[parent] = _written.get(parent, np.inf) + size
    if _written[parent] < CHECK_SHARE * MOST_BYTES:
        return
    try:
        _remove_oldest(parent)
        _written[parent] = 0.0
    except OSError as error:
        _log.warning("cannot look at what is in %s: %s", parent, error)


_written: dict[Path, float] = {}
"""Bytes that this process wrote to a folder since it last summed it up, which takes long for thousands of files."""


def _remove_oldest(parent: Path) -> None:
    """Remove what was used longest ago, if there is too much, and drafts that nobody writes any more."""
    known = []
    for path in parent.iterdir():
        with contextlib.suppress(FileNotFoundError):  # another process may have removed it
            status = path.stat()
            if not path.name.startswith("."):
                known.append((status.st_mtime, status.st_size, path))
            elif status.st_mtime < time.time() - STALE:
                path.unlink()
    total = sum(size for _, size, _ in known)
    if total <= MOST_BYTES:
        return
    for _, size, path in sorted(known):
        if total <= TRIMMED_SHARE * MOST_BYTES:
            return
        path.unlink(missing_ok=True)
        total -= size
