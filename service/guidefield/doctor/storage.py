"""The disk: room for runs, and the kernels' machine code."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from guidefield.doctor.finding import Finding, fine, remark, wrong
from guidefield.first_start import PLAIN, cache_parent, compiled_mark, plain_numba, processor
from guidefield.stores.runs import DEFAULT_RETENTION

GIB = 2**30
LEAST = GIB
"""With less a few recordings fill the disk [bytes]."""


def disk(data: Path) -> Finding:
    """Whether runs can be kept.

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
    """What is said about so much room [bytes] for a folder."""
    found = f"{free / GIB:.1f} GiB are free for {data}"
    if free < LEAST:
        return wrong("disk", found, "make room: on a full disk plans go on, but no run or recording is kept")
    if free < DEFAULT_RETENTION.bytes:
        return remark("disk", found, f"give `guidefield serve --keep-gib {max(1, free // (2 * GIB))}`, or make room")
    return fine("disk", found)


def kernels() -> Finding:
    """Whether the kernels' machine code is there, or can be kept."""
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
            "kernels", f"compiled by plain numba, because {PLAIN} is set", f"unset {PLAIN}: plans take longer"
        )
    return fine("kernels", f"compiled for this processor ({processor()}), in {folder}")


def _takes_files(folder: Path) -> bool:
    """Whether a file can be made there: rights alone don't say it, least of all to root."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _there(path: Path) -> Path:
    """The path itself, or what is there of those above it."""
    return next((one for one in (path, *path.absolute().parents) if one.exists()), Path("/"))
