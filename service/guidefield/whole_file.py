"""Write files atomically: beside the final name, then renamed, so that a file is there whole or not at all.

A process that is killed at any moment leaves no file cut in half; what it leaves behind starts with a dot, ends with
`DRAFT`, and is never taken for data.
"""

from __future__ import annotations

import os
import uuid
from pathlib import Path

DRAFT = ".draft"
"""How the name of a file ends that isn't whole yet."""


def write_whole(path: Path, *data: bytes | memoryview, durable: bool = True) -> None:
    """Put `data` where `path` says: all of it or, if the disk refuses, nothing, and an older file stays as it was.

    Args:
        path: File to write; replaced if it exists.
        data: What it holds, one behind the other.
        durable: Whether it must survive a power cut; what can be made again need not, and is written faster.

    Raises:
        OSError: if it can't be written; names `path`.
    """
    draft = draft_of(path)
    try:
        with draft.open("wb") as file:
            file.writelines(data)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        draft.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        draft.unlink(missing_ok=True)
    if durable:
        flush_folder(path.parent)


def draft_of(path: Path) -> Path:
    """A name beside a file's, for what isn't whole yet: another one each time."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex}{DRAFT}")


def flush_folder(folder: Path) -> None:
    """Make the names in a folder, and not only the contents of its files, survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
