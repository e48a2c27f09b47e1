"""Write, complete and delete rows of the database of runs within a transaction; take over runs of guidefield 0.1.

Columns are those of the tables in `run_file.py`. Guidefield 0.1 kept each run in a folder of its own. `runs.py` takes
over some folders at a time: their rows are committed and flushed, and only then their recordings move and the folders
go. A kill at any moment leaves each run in the database, in its folder, or in both; the next start continues.
"""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import time
from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import msgspec

from guidefield.errors import Status
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.replies import ErrorReply, is_certify
from guidefield.messages.requests import RUNNING, UNREADABLE
from guidefield.stores.files import decode_if_whole, read_if_any
from guidefield.stores.recordings import EARLIER_MARK, LOST, RECORDING, KeptRecording, Recordings

AT_ONCE = 100  # folders that are taken over in one transaction
KEPT_ERRORS = (Status.CRASH.name, Status.FAILURE.name, Status.DISK_REFUSED.name)
"""Errors that aren't the request's fault: a run that ends with one is kept, with another it is forgotten."""

Kind = Literal["plan", "certify"]


@dataclass
class NewRun:
    """A run that is to be kept."""

    owner: str  # its user
    run_id: str  # its name
    kind: Kind  # the kind of request
    request: bytes  # as it came
    encoding: Encoding = Encoding.JSON  # the encoding of the request and of its reply
    began: float = field(default_factory=time.time)  # time of its beginning [s since 1970]
    begun: Future[int] | None = None  # the writing of its first row, once that is asked for
    ended: float | None = None  # time of its end [s since 1970]
    reply: bytes | None = None  # the reply that ended it, as it is sent
    error: bytes | None = None  # JSON of the error instead


class _SceneHead(msgspec.Struct):
    name: str = ""
    base: str | None = None


class _RequestHead(msgspec.Struct):
    robot: str | dict[str, msgspec.Raw]
    scene: str | _SceneHead


class _RunEnd(msgspec.Struct):
    name: str
    message: str = ""


class _ReplyHead(msgspec.Struct):
    status: _RunEnd


def insert(run: NewRun, db: sqlite3.Connection, recording: KeptRecording | None = None) -> int:
    """Add a run that begins, or has ended if the state of its recording is given; return its number."""
    head = decode_if_whole(run.request, _RequestHead, run.encoding) or _RequestHead(UNREADABLE, UNREADABLE)
    row = {
        "owner": run.owner,
        "run_id": run.run_id,
        "kind": run.kind,
        "robot": head.robot if isinstance(head.robot, str) else "urdf",
        "scene": head.scene if isinstance(head.scene, str) else head.scene.name or head.scene.base or "",
        "began": run.began,
        "status": RUNNING,
        "message": "",
        "bytes": len(run.request),
    }
    columns, values = ", ".join(row), ", ".join(f":{name}" for name in row)
    number = db.execute(f"INSERT INTO runs ({columns}) VALUES ({values})", row).lastrowid  # noqa: S608 - ours
    assert number is not None, "a row has a number"
    db.execute(
        "INSERT INTO documents (number, encoding, request) VALUES (?, ?, ?)", (number, run.encoding, run.request)
    )
    if recording is not None:
        complete(number, run, recording, db)
    return number


def complete(number: int, run: NewRun, recording: KeptRecording, db: sqlite3.Connection) -> None:
    """Write the end of a run, and the state of its recording."""
    head = None if run.reply is None else decode_if_whole(run.reply, _ReplyHead, run.encoding)
    outcome = head.status if head is not None else decode_if_whole(run.error or b"", _RunEnd) or _RunEnd(UNREADABLE)
    size = len(run.request) + len(run.reply or b"") + len(run.error or b"")
    columns = "status = ?, message = ?, ended = ?, bytes = ?, recording = ?, recorded = ?"
    row = (outcome.name, outcome.message, run.ended, size, recording.bytes, recording.kind, number)
    db.execute(f"UPDATE runs SET {columns} WHERE number = ?", row)  # noqa: S608 - ours
    db.execute("UPDATE documents SET reply = ?, error = ? WHERE number = ?", (run.reply, run.error, number))


def end_abandoned(error: ErrorReply, since: float, db: sqlite3.Connection) -> None:
    """End, with an error, the runs without an end that began before a time [s since 1970]."""
    abandoned = "ended IS NULL AND began < ?"
    documents = f"UPDATE documents SET error = ? WHERE number IN (SELECT number FROM runs WHERE {abandoned})"  # noqa: S608
    db.execute(documents, (codec.encode(error), since))
    end = f"UPDATE runs SET status = ?, message = ?, ended = ? WHERE {abandoned}"  # noqa: S608 - ours
    db.execute(end, (error.name, error.message, time.time(), since))


def drop_runs(recordings: Recordings, runs: Iterable[tuple[int, str]], db: sqlite3.Connection) -> None:
    """Delete runs by number and name, their recordings first: a kill in between leaves no file without a run."""
    for number, run_id in runs:
        with contextlib.suppress(OSError):
            recordings.drop(run_id)
        db.execute("DELETE FROM runs WHERE number = ?", (number,))


def execute(statement: str, values: tuple[Any, ...], db: sqlite3.Connection) -> int:
    """Run one statement; return the number of rows that it changed."""
    return db.execute(statement, values).rowcount


def earlier_folders(runs: Path) -> list[Path]:
    """Return the folders of runs in a folder, the oldest first; delete drafts of killed processes."""
    folders = []
    for found in runs.iterdir() if runs.is_dir() else ():
        if found.name.startswith("."):
            shutil.rmtree(found, ignore_errors=True)
        elif found.is_dir():
            folders.append((_began(found), found))
    return [folder for _, folder in sorted(folders)]


def add_folders(owner: str, folders: list[Path], shared: Path, db: sqlite3.Connection) -> None:
    """Add the rows of runs that the database lacks."""
    for folder in folders:
        if db.execute("SELECT 1 FROM runs WHERE (owner, run_id) = (?, ?)", (owner, folder.name)).fetchone():
            continue
        request = read_if_any(folder / "request.json") or b""
        run = NewRun(owner, folder.name, "certify" if is_certify(request) else "plan", request, began=_began(folder))
        run.reply, run.error = read_if_any(folder / "reply.json"), read_if_any(folder / "error.json")
        kept, recording = None, folder / "recording.rrd"
        if run.reply is not None or run.error is not None:
            run.ended = folder.stat().st_mtime
            kept = KeptRecording("rendered", recording.stat().st_size) if recording.exists() else KeptRecording("none")
        number = insert(run, db, kept)
        db.execute("UPDATE runs SET shared = ? WHERE number = ?", ((shared / folder.name).exists(), number))


def move_recordings(folders: list[Path], recordings: Recordings, shared: Path) -> None:
    """Move recordings to their present place, and delete the folders of runs that the database has."""
    recordings.folder.mkdir(exist_ok=True)
    for folder in folders:
        for name, ending in (("recording.rrd", RECORDING), ("recording.owed", EARLIER_MARK), ("recording.lost", LOST)):
            with contextlib.suppress(FileNotFoundError):
                (folder / name).rename(recordings.folder / f"{folder.name}{ending}")
        (shared / folder.name).unlink(missing_ok=True)
        shutil.rmtree(folder)


def _began(folder: Path) -> float:
    request = folder / "request.json"
    return (request if request.exists() else folder).stat().st_mtime
