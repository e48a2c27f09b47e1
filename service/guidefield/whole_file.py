"""Write files atomically, whole or not at all, and share them by hard links.

A process that is killed at any moment leaves no file cut in half; a file that it leaves behind starts with a dot, ends
with `DRAFT`, and is never taken for data. A file that many others need is known by its content, and each has a hard
link to it: the file system counts them, so that a file is deleted only once nobody needs it.
"""

from __future__ import annotations

import contextlib
import errno
import os
import time
import uuid
from collections.abc import Callable
from pathlib import Path

DRAFT = ".draft"  # suffix of an incomplete file; `recorder/bodies.py` deletes old ones by it


def write_whole(path: Path, *data: bytes | memoryview, durable: bool = True) -> None:
    """Write `data` to `path` atomically: if the disk refuses, an older file stays unchanged.

    Args:
        data: What it holds, one behind the other.
        durable: Whether it must survive a power cut; other files are written faster.

    Raises:
        OSError: if it can't be written; names `path`.
    """
    draft = draft_path(path)
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


def draft_path(path: Path) -> Path:
    """Return a new name beside a file for its incomplete content."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex}{DRAFT}")


def flush_folder(folder: Path) -> None:
    """Make the names in a folder, and not only the contents of its files, survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def link_shared(link: Path, file: Path, content: Callable[[], bytes]) -> None:
    """Link to a shared file, which is written if it isn't there, or has as many links as the disk allows.

    Args:
        link: The link; there must be nothing.
        file: The file, known by its content; its folder is made.
        content: Gives the content.

    Raises:
        OSError: if the disk refuses, or knows no hard links.
    """
    for _ in range(2):
        try:
            link.hardlink_to(file)
            os.utime(file)
            return
        except OSError as error:
            if error.errno not in (errno.ENOENT, errno.EMLINK):
                raise
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, content(), durable=False)
    link.hardlink_to(file)


def remove_unshared(folder: Path, unused: float) -> None:
    """Delete the files of a folder that have no link and weren't used for some time [s]."""
    with contextlib.suppress(FileNotFoundError):
        for file in list(folder.iterdir()):
            with contextlib.suppress(OSError):
                state = file.stat()
                if state.st_nlink == 1 and time.time() - state.st_mtime >= unused:
                    file.unlink()  # a link made in between keeps the content
