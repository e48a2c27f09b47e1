"""Rows of the database of runs: written, completed and deleted within a transaction."""

from __future__ import annotations

import contextlib
import sqlite3
import time
from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec

from guidefield.errors import Status
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.replies import ErrorReply
from guidefield.messages.store_requests import RUNNING, UNREADABLE
from guidefield.stores.files import decoded
from guidefield.stores.recordings import Kept, Recordings

KEPT_ERRORS = (Status.CRASH.name, Status.FAILURE.name, Status.DISK_REFUSED.name)
"""Errors that are no fault of the request: the run that ended so is kept."""

Kind = Literal["plan", "certify"]


@dataclass
class NewRun:
    """A run that is to be kept.

    Attributes:
        owner: Its user.
        run_id: Its name.
        kind: The kind of request.
        request: As it came.
        encoding: The encoding of the request and of its reply.
        began: Time of its beginning [s since 1970].
        begun: The writing of its first row, once that is asked for.
    """

    owner: str
    run_id: str
    kind: Kind
    request: bytes
    encoding: Encoding = Encoding.JSON
    began: float = field(default_factory=time.time)
    begun: Future[int] | None = None


@dataclass(frozen=True)
class Ending:
    """The end of a run.

    Attributes:
        ended: Its time [s since 1970].
        reply: The reply, if there is one, as it is sent.
        error: JSON of the error in its place.
    """

    ended: float
    reply: bytes | None
    error: bytes | None


class _SceneHead(msgspec.Struct):
    name: str = ""
    base: str | None = None


class _RequestHead(msgspec.Struct):
    """Just enough of a request for a list."""

    robot: str | dict[str, msgspec.Raw]
    scene: str | _SceneHead


class _Outcome(msgspec.Struct):
    name: str
    message: str = ""


class _ReplyHead(msgspec.Struct):
    """Just enough of a reply for a list."""

    status: _Outcome


def insert(run: NewRun, db: sqlite3.Connection) -> int:
    """Add a run that begins; its number."""
    head = decoded(run.request, _RequestHead, run.encoding) or _RequestHead(UNREADABLE, UNREADABLE)
    robot = head.robot if isinstance(head.robot, str) else "urdf"
    scene = head.scene if isinstance(head.scene, str) else head.scene.name or head.scene.base or ""
    begun = (run.owner, run.run_id, run.kind, RUNNING, "", robot, scene, run.began, len(run.request))
    columns = "owner, run_id, kind, status, message, robot, scene, began, bytes"
    values = ", ".join("?" * len(begun))
    number = db.execute(f"INSERT INTO runs ({columns}) VALUES ({values})", begun).lastrowid  # noqa: S608 - ours
    assert number is not None, "a row has a number"
    documents = "INSERT INTO documents (number, encoding, request) VALUES (?, ?, ?)"
    db.execute(documents, (number, run.encoding.value, run.request))
    return number


def find_unended(run: NewRun, db: sqlite3.Connection) -> int | None:
    """The number of a run that has begun; None if its row isn't there."""
    find = "SELECT number FROM runs WHERE (owner, run_id) = (?, ?) AND ended IS NULL"
    found = db.execute(find, (run.owner, run.run_id)).fetchone()
    return None if found is None else int(found[0])


def complete(number: int, run: NewRun, ending: Ending, recording: Kept, db: sqlite3.Connection) -> None:
    """Write how a run ended, and what there is of its recording."""
    outcome: _Outcome | None = None
    if ending.reply is not None:
        head = decoded(ending.reply, _ReplyHead, run.encoding)
        outcome = None if head is None else head.status
    elif ending.error is not None:
        outcome = decoded(ending.error, _Outcome)
    outcome = outcome or _Outcome(UNREADABLE)
    size = len(run.request) + len(ending.reply or b"") + len(ending.error or b"")
    db.execute(
        "UPDATE runs SET status = ?, message = ?, ended = ?, bytes = ?, recording = ?, recorded = ? WHERE number = ?",
        (outcome.name, outcome.message, ending.ended, size, recording.bytes, recording.kind, number),
    )
    db.execute("UPDATE documents SET reply = ?, error = ? WHERE number = ?", (ending.reply, ending.error, number))


def end_abandoned(error: ErrorReply, since: float, db: sqlite3.Connection) -> None:
    """End the runs that are under way and began before the service did [s since 1970]."""
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
    """Run one statement; the number of rows that it changed."""
    return db.execute(statement, values).rowcount
