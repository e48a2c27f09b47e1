"""How anything is written to disk here: atomically, under checked names, in one place.

A file is written beside its final name, flushed to the disk and renamed. A process that is killed at any moment leaves
no file cut in half; what it leaves behind starts with a dot and is never taken for data.
"""

from __future__ import annotations

import os
import re
import uuid
from pathlib import Path

from guidefield.errors import MalformedRequest

_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,127}")


def default_data_folder(instance: str) -> Path:
    """Where a service of that name keeps its data unless told otherwise: the user's data folder of the platform."""
    base = os.environ.get("XDG_DATA_HOME") or str(Path.home() / ".local" / "share")
    return Path(base) / "guidefield" / checked_name(instance, "instance")


def checked_name(name: str, what: str) -> str:
    """The name itself, if it can name a file and cannot lead out of its folder.

    Raises:
        MalformedRequest: otherwise; `what` says whose name it is.
    """
    if not _NAME.fullmatch(name):
        raise MalformedRequest(
            f"{what} {name[:64]!r} must be 1 to 128 of the characters A-Z a-z 0-9 _ . - and must not begin with a dot",
            **{what: name[:64]},
        )
    return name


def write_atomically(path: Path, data: bytes) -> None:
    """Put `data` where `path` says: all of it or, if the disk refuses, nothing (OSError)."""
    draft = path.with_name(f".{uuid.uuid4().hex}.new")
    try:
        with draft.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        draft.rename(path)
    except OSError:
        draft.unlink(missing_ok=True)
        raise
    flush_folder(path.parent)


def flush_folder(folder: Path) -> None:
    """Make the names in a folder, and not only the contents of its files, survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read_if_any(path: Path) -> bytes | None:
    """What the file holds, or None where there is none."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None
