"""Take over the runs of guidefield 0.1, which kept each in a folder of its own, into the database.

Theory of operation. Folders are taken over some at a time: their rows are committed and flushed, and only then their
recordings move and the folders go. A kill at any moment leaves each run in the database, in its folder, or in both; the
next start goes on.
"""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
from pathlib import Path

from guidefield.messages.replies import is_certify
from guidefield.stores.files import read_if_any
from guidefield.stores.recordings import LOST, OWED, RECORDING, Kept, Recordings
from guidefield.stores.run_rows import Ending, NewRun, complete, insert

AT_ONCE = 100
"""Folders that are taken over in one transaction."""


def earlier_folders(runs: Path) -> list[Path]:
    """The folders of runs in a folder, the oldest first; what a killed process left behind is deleted."""
    folders = []
    for found in runs.iterdir() if runs.is_dir() else ():
        if found.name.startswith("."):
            shutil.rmtree(found, ignore_errors=True)
        elif found.is_dir():
            folders.append((_began(found), found))
    return [folder for _, folder in sorted(folders)]


def add_folders(owner: str, folders: list[Path], shared: Path, db: sqlite3.Connection) -> None:
    """Add the rows of runs to the database, but of those that are there."""
    for folder in folders:
        there = db.execute("SELECT 1 FROM runs WHERE (owner, run_id) = (?, ?)", (owner, folder.name)).fetchone()
        if there is None:
            _add(owner, folder, (shared / folder.name).exists(), db)


def move_recordings(folders: list[Path], recordings: Recordings, shared: Path) -> None:
    """Move recordings to where they are looked for now, and delete what the database has."""
    recordings.folder.mkdir(exist_ok=True)
    for folder in folders:
        for name, ending in (("recording.rrd", RECORDING), ("recording.owed", OWED), ("recording.lost", LOST)):
            with contextlib.suppress(FileNotFoundError):
                (folder / name).rename(recordings.folder / f"{folder.name}{ending}")
        (shared / folder.name).unlink(missing_ok=True)
        shutil.rmtree(folder)


def _add(owner: str, folder: Path, shared: bool, db: sqlite3.Connection) -> None:
    request = read_if_any(folder / "request.json") or b""
    run = NewRun(owner, folder.name, "certify" if is_certify(request) else "plan", request, began=_began(folder))
    reply, error = read_if_any(folder / "reply.json"), read_if_any(folder / "error.json")
    number = insert(run, db)
    if reply is not None or error is not None:
        recording = folder / "recording.rrd"
        kept = Kept("rendered", recording.stat().st_size) if recording.exists() else Kept("none")
        complete(number, run, Ending(folder.stat().st_mtime, reply, error), kept, db)
    db.execute("UPDATE runs SET shared = ? WHERE number = ?", (shared, number))


def _began(folder: Path) -> float:
    """The time at which a run began [s since 1970]."""
    request = folder / "request.json"
    return (request if request.exists() else folder).stat().st_mtime
