"""The disk: room for runs, their database, and the kernels' machine code."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from pathlib import Path

from guidefield.doctor.finding import Finding, fine, remark, wrong
from guidefield.errors import DiskRefused
from guidefield.first_start import KNOWN, PLAIN, cache_parent, compiled_mark, plain_numba, processor
from guidefield.stores.run_file import FILE, connect_reader, connect_writer, telling_faults
from guidefield.stores.runs import DEFAULT_RETENTION

GIB = 2**30
LEAST = GIB
"""With less a few recordings fill the disk [bytes]."""


def disk(data: Path) -> Finding:
    """Look whether the data folder takes files, and at the room on its disk.

    Args:
        data: Folder of a service's runs, scenes and robots; need not be there yet.
    """
    there = _there(data)
    if not there.is_dir():
        return wrong("disk", f"{there} is no folder", f"give `guidefield serve --data FOLDER`, or move {there} away")
    if not _takes_files(there):
        return wrong("disk", f"{there} can't be written", "give `guidefield serve --data FOLDER`, or the rights to it")
    return room_found(shutil.disk_usage(there).free, data)


def room_found(free: int, data: Path) -> Finding:
    """Judge the free room [bytes] for a data folder."""
    found = f"{free / GIB:.1f} GiB are free for {data}"
    if free < LEAST:
        return wrong("disk", found, "make room: on a full disk plans go on, but no run or recording is kept")
    if free < DEFAULT_RETENTION.bytes:
        return remark("disk", found, f"give `guidefield serve --keep-gib {max(1, free // (2 * GIB))}`, or make room")
    return fine("disk", found)


def runs(data: Path) -> Finding:
    """Look whether a database of runs can be written, and whether the one that is there is damaged.

    Args:
        data: Folder of a service's runs, scenes and robots; need not be there yet.
    """
    file, there = data / FILE, _there(data)
    try:
        with tempfile.TemporaryDirectory(prefix=".guidefield-", dir=there) as trial:
            connect_writer(Path(trial) / FILE).close()
    except (DiskRefused, OSError) as fault:
        return wrong("runs", f"a database in {there} is refused: {fault}", "give `guidefield serve --data FOLDER`")
    if not file.exists():
        if (data / "runs").is_dir():
            advice = "start the service: it takes them over"
            return remark("runs", f"{data / 'runs'} has runs that guidefield 0.1 kept in folders", advice)
        return fine("runs", f"none are kept in {data} yet; a database can be made there")
    try:
        with telling_faults(file), contextlib.closing(connect_reader(file)) as db:
            looked_at = "1" if file.stat().st_size < GIB else "'runs'"  # all of a larger one takes minutes
            (damage,) = db.execute(f"PRAGMA quick_check({looked_at})").fetchone()
            total = "SELECT count(*), ifnull(sum(bytes + recording), 0) FROM runs"
            count, size = db.execute(total).fetchone()
    except DiskRefused as fault:
        return wrong("runs", fault.message, "until then plans go on, but no run is kept")
    if damage != "ok":
        advice = f'stop the service and move it away, or mend it: sqlite3 {FILE} ".recover" | sqlite3 mended.sqlite'
        return wrong("runs", f"{file} is damaged: {damage}", advice)
    return fine("runs", f"{count} are kept in {file}, of {size / GIB:.1f} GiB with their recordings")


def kernels() -> Finding:
    """Look whether the kernels' machine code is there, or can be kept."""
    folder = cache_parent() / "guidefield"
    there = _there(folder)
    if not (there.is_dir() and _takes_files(there)):
        return wrong(
            "kernels",
            f"{there} can't be written: every start compiles for a minute",
            "set XDG_CACHE_HOME or NUMBA_CACHE_DIR to a folder that stays",
        )
    if not compiled_mark().exists():
        return remark(
            "kernels",
            f"not compiled for this version and processor ({processor()}) in {folder}",
            "the first start does it, for a minute; `python -m guidefield.kernels.jit.compile_ahead` does it now",
        )
    if plain_numba():
        return remark(
            "kernels",
            f"compiled by plain numba, as {PLAIN} is set or its version is none of {', '.join(KNOWN)}",
            f"unset {PLAIN}, or install one of these: the first start and plans take longer",
        )
    return fine("kernels", f"compiled for this processor ({processor()}), in {folder}")


def _takes_files(folder: Path) -> bool:
    """Look whether a file can be made in a folder: rights alone don't say it, least of all to root."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _there(path: Path) -> Path:
    """The path itself, or what is there of those above it."""
    return next((one for one in (path, *path.absolute().parents) if one.exists()), Path("/"))
