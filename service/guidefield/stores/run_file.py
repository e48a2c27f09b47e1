"""The SQLite file of all runs of a data folder: its tables, connections to it, and sentences for its faults.

Theory of operation. The file is in WAL mode: readers never wait for the writer, nor it for them, and a killed process
leaves every finished transaction behind. A commit isn't flushed to the disk (`synchronous=NORMAL`), a checkpoint is: a
power cut costs what was committed since the last checkpoint, and never the file. A line of the list is a row of `runs`;
requests and replies, which are long, are rows of `documents`, so that listing and counting read little.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path

from guidefield.errors import DiskRefused

FILE = "runs.sqlite"  # its name in the data folder
VERSION = 2  # the version of its tables
LARGEST_WAL = 16_384  # with more pages than this in the write-ahead log a commit checkpoints by itself [pages of 4 KiB]
LONGEST_LOCK_S = 5.0  # longest wait for another program that writes to the file [s]

_TABLES = """
BEGIN;
CREATE TABLE runs (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    owner TEXT NOT NULL,
    run_id TEXT NOT NULL,
    kind TEXT NOT NULL,
    status TEXT NOT NULL,
    message TEXT NOT NULL,
    robot TEXT NOT NULL,
    scene TEXT NOT NULL,
    began REAL NOT NULL,
    ended REAL,
    bytes INTEGER NOT NULL,
    recording INTEGER NOT NULL DEFAULT 0,
    recorded TEXT NOT NULL DEFAULT 'none',
    shared INTEGER NOT NULL DEFAULT 0,
    UNIQUE (owner, run_id)
) STRICT;
CREATE INDEX owned ON runs (owner);
CREATE INDEX ended ON runs (owner, ended) WHERE ended IS NOT NULL;
CREATE INDEX shared ON runs (shared) WHERE shared;
CREATE TABLE documents (
    number INTEGER PRIMARY KEY,
    encoding TEXT NOT NULL,
    request BLOB NOT NULL,
    reply BLOB,
    error BLOB
) STRICT;
CREATE TABLE usage (owner TEXT PRIMARY KEY, runs INTEGER NOT NULL, bytes INTEGER NOT NULL) STRICT, WITHOUT ROWID;
CREATE TRIGGER begun AFTER INSERT ON runs BEGIN
    INSERT INTO usage VALUES (new.owner, new.ended IS NOT NULL, new.bytes + new.recording)
        ON CONFLICT DO UPDATE SET runs = runs + excluded.runs, bytes = bytes + excluded.bytes;
END;
CREATE TRIGGER changed AFTER UPDATE OF ended, bytes, recording ON runs BEGIN
    UPDATE usage SET
        runs = runs + (new.ended IS NOT NULL) - (old.ended IS NOT NULL),
        bytes = bytes + new.bytes + new.recording - old.bytes - old.recording
        WHERE owner = new.owner;
END;
CREATE TRIGGER dropped AFTER DELETE ON runs BEGIN
    DELETE FROM documents WHERE number = old.number;
    UPDATE usage SET
        runs = runs - (old.ended IS NOT NULL),
        bytes = bytes - old.bytes - old.recording
        WHERE owner = old.owner;
END;
"""
"""The tables, with triggers that keep `usage` up.

A `kind` is "plan" or "certify". Times are [s since 1970]; `recording` is the size of a run's recording or of its log,
and `recorded` says which of them there is (`recordings.Kind`); `usage` has the number of runs that have ended.
"""


def connect_writer(file: Path) -> sqlite3.Connection:
    """Open the file to write, and make it if it isn't there.

    Raises DiskRefused if it can't be written as it should; says why and what to do.
    """
    with contextlib.ExitStack() as failed, telling_faults(file):
        db = failed.enter_context(contextlib.closing(_connected(file, "rwc")))
        if db.execute("PRAGMA user_version").fetchone() == (0,):
            db.executescript(f"{_TABLES} PRAGMA user_version = {VERSION}; COMMIT;")
        _require_version(db, file)
        mode = db.execute("PRAGMA journal_mode = WAL").fetchone()[0]
        if mode != "wal":
            raise DiskRefused(
                f"the file system of {file.name} has no locks or shared memory for a database; choose a data folder on "
                "a local disk (`--data`)"
            )
        db.execute("PRAGMA synchronous = NORMAL")
        db.execute(f"PRAGMA wal_autocheckpoint = {LARGEST_WAL}")
        db.execute(f"PRAGMA user_version = {VERSION}")  # writes: a locked file or a full disk refuses here already
        failed.pop_all()
    return db


def connect_reader(file: Path) -> sqlite3.Connection:
    """Open the file to read, also while a service writes it; raises DiskRefused if it can't be read."""
    # Where no log is left, and none can be made beside it, nobody writes it either.
    is_still = not file.with_name(f"{file.name}-wal").exists() and not os.access(file.parent, os.W_OK)
    with contextlib.ExitStack() as failed, telling_faults(file):
        db = failed.enter_context(contextlib.closing(_connected(file, "ro&immutable=1" if is_still else "ro")))
        _require_version(db, file)
        failed.pop_all()
    return db


def checkpoint(file: Path) -> None:
    """Flush all commits so far to the disk; raises DiskRefused if the disk refuses."""
    with telling_faults(file), contextlib.closing(_connected(file, "rw")) as db:
        db.execute("PRAGMA synchronous = NORMAL")
        db.execute("PRAGMA wal_checkpoint(PASSIVE)")


class Readers:
    """Connections for reading, one for each thread that reads at a time."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._free: list[sqlite3.Connection] = []
        self._lock = threading.Lock()

    @contextlib.contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """A connection for the time of a block, in which the file stays as it is.

        Raises DiskRefused if the file can't be read.
        """
        with self._lock:
            db = self._free.pop() if self._free else None
        db = connect_reader(self._file) if db is None else db
        with contextlib.ExitStack() as failed, telling_faults(self._file):
            failed.callback(db.close)
            db.execute("BEGIN")
            try:
                yield db
            finally:
                db.execute("COMMIT")
            failed.pop_all()
        with self._lock:
            self._free.append(db)

    def close(self) -> None:
        """Close those that nobody uses."""
        with self._lock:
            while self._free:
                self._free.pop().close()


@contextlib.contextmanager
def telling_faults(file: Path) -> Iterator[None]:
    """Have whatever SQLite raises in a block come out as DiskRefused, with what to do."""
    try:
        yield
    except (sqlite3.DatabaseError, sqlite3.InterfaceError) as error:
        raise DiskRefused(fault_of(error, file.name)) from None


def fault_of(error: sqlite3.Error, name: str) -> str:
    """A fault of the file as a sentence that says what to do."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    if code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
        return (
            f"the database of runs is damaged ({error}); stop the service and move {name} away, or mend it: "
            f'sqlite3 {name} ".recover" | sqlite3 mended.sqlite'
        )
    if code == sqlite3.SQLITE_FULL:
        return "the disk refuses: No space left on device"
    if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return f"another program holds {name} locked; end it"
    return f"the disk refuses {name}: {error}"


def _connected(file: Path, mode: str) -> sqlite3.Connection:
    address = f"{file.absolute().as_uri()}?mode={mode}"
    return sqlite3.connect(address, timeout=LONGEST_LOCK_S, isolation_level=None, check_same_thread=False, uri=True)


def _require_version(db: sqlite3.Connection, file: Path) -> None:
    (version,) = db.execute("PRAGMA user_version").fetchone()
    if version != VERSION:
        raise DiskRefused(
            f"{file.name} has tables of version {version}, and this guidefield reads version {VERSION}; use the "
            "guidefield that wrote it, or move the file away"
        )
