"""The folders of streams' journals, one for each stream; the oldest are removed."""

from __future__ import annotations

import shutil
from pathlib import Path

from guidefield.errors import UnknownObject
from guidefield.stores.files import checked_name
from guidefield.stream.journal import FILE_BYTES, MOST_FILES, files_of

MOST_KEPT = 8
"""So many streams are kept of a user, one that is open among them."""


def file_bytes(most: int | None) -> int:
    """How large a file of a journal may be, where all that is kept of a user's streams may take so much [bytes]."""
    return FILE_BYTES if most is None else min(FILE_BYTES, most // (MOST_KEPT * MOST_FILES))


def begin(streams: Path, name: str) -> Path:
    """The folder for the journal of a new stream; an earlier one of its name makes room, and so do the oldest.

    Raises:
        OSError: if the disk refuses.
    """
    streams.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(streams / name, ignore_errors=True)
    kept = sorted((_changed(folder), folder) for folder in streams.iterdir() if folder.is_dir())
    for _, folder in kept[: max(0, len(kept) + 1 - MOST_KEPT)]:
        shutil.rmtree(folder, ignore_errors=True)
    (streams / name).mkdir()
    return streams / name


def kept_files(streams: Path, name: str) -> list[Path]:
    """The files of a stream's journal, the oldest first.

    Raises:
        MalformedRequest: if that can't be the name of a stream.
        UnknownObject: if nothing is kept of it.
    """
    files = files_of(streams / checked_name(name, "stream_id"))
    if not files:
        raise none_kept(name)
    return files


def none_kept(name: str) -> UnknownObject:
    """What is told where nothing is kept of a stream."""
    return UnknownObject(f"nothing is kept of a stream {name!r}", stream=name)


def _changed(folder: Path) -> float:
    """When the newest file of a folder was written [s since 1970]."""
    try:
        return max((file.stat().st_mtime for file in files_of(folder)), default=folder.stat().st_mtime)
    except OSError:  # it goes away meanwhile
        return 0.0
