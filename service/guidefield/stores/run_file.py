"""The SQLite file of all runs of a data folder: its tables, connections for reading, and the one thread that writes.

Theory of operation. The file is in WAL mode: readers never wait for the writer, nor it for them, and a killed process
leaves every finished transaction behind. A commit isn't flushed to the disk (`synchronous=NORMAL`), a checkpoint is: a
power cut costs what was committed since the last checkpoint, and never the file. A line of the list is a row of `runs`;
requests and replies, which are long, are rows of `documents`, so that listing and counting read little. Files of users
have these tables: a change of them needs a new `VERSION`, and other versions' files are refused.

All changes that wait for the writer are one transaction, and share its commit. A change is a function of the
connection, and a future says when it is committed, or why it isn't. If a transaction fails, each of its changes is
tried again alone: a reply too large for the disk costs no other one. A second thread checkpoints once a second, because
that waits for the disk, and no answer should.
"""

from __future__ import annotations

import contextlib
import logging
import os
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from guidefield.errors import DiskRefused

LINGER_S = 0.05  # longest time that a change without a waiting caller waits for others to share its commit [s]
UPKEEP_INTERVAL_S = 1.0  # time between two checkpoints, and so what a power cut may cost [s] (docs/service.md)
RETRY_INTERVAL_S = 1.0  # shortest time between two attempts to open a file that could not be opened [s]
MAX_WAITING_BYTES = 256 * 2**20  # size of changes that wait beyond which callers wait, too [bytes]

_log = logging.getLogger(__name__)

_T = TypeVar("_T")


class _Change(NamedTuple):
    apply: Callable[[sqlite3.Connection], Any]
    done: Future[Any]
    size: int  # memory until it is written [bytes]


class RunWriter:
    """Writes changes in the order in which they come; its threads begin with the first.

    Args:
        file: The database.
        keep_up: Called after each `UPKEEP_INTERVAL_S`, in the second thread.
    """

    def __init__(self, file: Path, keep_up: Callable[[], None]) -> None:
        self._file, self._keep_up = file, keep_up
        self._db: sqlite3.Connection | None = None
        self._fault: tuple[float, DiskRefused] | None = None
        self._waiting: list[_Change] = []
        self._size = 0
        self._urgent = self._closed = self._unflushed = False
        self._changed = threading.Condition()
        self._ended = threading.Event()
        self._threads = [
            threading.Thread(target=run, name=f"guidefield-runs-{name}", daemon=True)
            for name, run in (("writer", self._write), ("upkeep", self._flush))
        ]

    def submit(self, apply: Callable[[sqlite3.Connection], _T], *, urgent: bool = True, size: int = 0) -> Future[_T]:
        """Have a change written, which takes a size of memory until then [bytes]; `urgent`: somebody waits for it.

        `apply` makes it within a transaction, and may be called a second time, after a rollback. Once that is
        committed, the future has its result, else DiskRefused; until the change is begun, it may be cancelled.
        """
        done: Future[_T] = Future()
        with self._changed:
            self._changed.wait_for(lambda: self._size < MAX_WAITING_BYTES or self._closed)
            if self._closed:  # the thread that writes may have ended
                done.set_exception(DiskRefused("the service has ended"))
                return done
            if self._threads[0].ident is None:
                for thread in self._threads:
                    thread.start()
            self._waiting.append(_Change(apply, done, size + 1))
            self._size += size + 1
            self._urgent |= urgent
            self._changed.notify_all()
        return done

    def settle(self) -> None:
        """Return when all changes so far are written, or refused."""
        if self._size:
            with contextlib.suppress(DiskRefused):
                self.submit(lambda _: None).result()

    def close(self) -> None:
        """Write what waits, and close the file."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._ended.set()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()
        if self._db is not None:
            self._db.close()

    def _write(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed)
                self._changed.wait_for(lambda: self._urgent or self._closed, LINGER_S)
                batch, self._waiting, self._urgent = self._waiting, [], False
            if not batch:
                return
            if begun := [change for change in batch if change.done.set_running_or_notify_cancel()]:
                self._commit(begun)
            with self._changed:
                self._size -= sum(change.size for change in batch)
                self._changed.notify_all()

    def _commit(self, changes: list[_Change]) -> None:
        try:
            outcomes = self._transaction(changes)
        except DiskRefused as refusal:
            if len(changes) > 1:
                for change in changes:
                    self._commit([change])
            else:
                changes[0].done.set_exception(refusal)
            return
        self._unflushed = True
        for change, (error, result) in zip(changes, outcomes, strict=True):
            if error is not None:
                change.done.set_exception(error)
            else:
                change.done.set_result(result)

    def _transaction(self, changes: list[_Change]) -> list[tuple[Exception | None, Any]]:
        """Make some changes; return for each the exception it raised, which undoes no other one, or its result."""
        db, outcomes = self._open(), list[tuple[Exception | None, Any]]()
        with telling_faults(self._file):
            db.execute("BEGIN IMMEDIATE")
            try:
                for change in changes:
                    try:
                        outcomes.append((None, change.apply(db)))
                    except sqlite3.Error:
                        raise
                    except Exception as error:
                        outcomes.append((error, None))
                db.execute("COMMIT")
            finally:
                if db.in_transaction:
                    db.execute("ROLLBACK")
        return outcomes

    def _open(self) -> sqlite3.Connection:
        """Return the connection; raise DiskRefused if the file can't be opened, or couldn't just now."""
        if self._db is None:
            if self._fault is not None and time.monotonic() - self._fault[0] < RETRY_INTERVAL_S:
                raise self._fault[1]
            try:
                self._db, self._fault = connect_writer(self._file), None
            except DiskRefused as refusal:
                self._fault = time.monotonic(), refusal
                raise
        return self._db

    def _flush(self) -> None:
        logged = ""  # the last fault, which isn't logged again
        while not self._ended.wait(UPKEEP_INTERVAL_S):
            try:
                self._keep_up()
                if self._unflushed:
                    self._unflushed = False
                    checkpoint(self._file)
                logged = ""
            except Exception as error:  # the next one tries again
                if logged != (logged := f"{error}"):
                    _log.warning("the database of runs is not flushed: %s", logged)


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
"""The tables, with triggers that update `usage`.

A `kind` is "plan" or "certify". Times are [s since 1970]; `bytes` is the size of request and reply, `recording` that of
the recording or log with its proof and shared files, and `recorded` its state (`recordings.Kind`); `shared` is 1 if all
users may read the run. `usage` has for each user the number of runs that have ended, and the bytes of all runs with
their recordings.
"""


def connect_writer(file: Path) -> sqlite3.Connection:
    """Open the file to write, and make it if it isn't there; DiskRefused says why it can't be, and what to do."""
    with contextlib.ExitStack() as failed, telling_faults(file):
        db = failed.enter_context(contextlib.closing(_connect(file, "rwc")))
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
    # Without a write-ahead log in a folder that can't be written, no process writes the file.
    is_still = not file.with_name(f"{file.name}-wal").exists() and not os.access(file.parent, os.W_OK)
    with contextlib.ExitStack() as failed, telling_faults(file):
        db = failed.enter_context(contextlib.closing(_connect(file, "ro&immutable=1" if is_still else "ro")))
        _require_version(db, file)
        failed.pop_all()
    return db


def checkpoint(file: Path) -> None:
    """Flush all commits so far to the disk; raises DiskRefused if the disk refuses."""
    with telling_faults(file), contextlib.closing(_connect(file, "rw")) as db:
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
        """Lend a block a connection that sees one state of the file; raises DiskRefused if it can't be read."""
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
        """Close the connections that no block uses."""
        with self._lock:
            while self._free:
                self._free.pop().close()


@contextlib.contextmanager
def telling_faults(file: Path) -> Iterator[None]:
    """Turn what SQLite raises in a block into DiskRefused, which says what to do."""
    try:
        yield
    except (sqlite3.DatabaseError, sqlite3.InterfaceError) as error:
        raise DiskRefused(fault_of(error, file.name)) from None


def fault_of(error: sqlite3.Error, name: str) -> str:
    """Describe a fault of the file in a sentence that says what to do."""
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


def _connect(file: Path, mode: str) -> sqlite3.Connection:
    address = f"{file.absolute().as_uri()}?mode={mode}"
    return sqlite3.connect(address, timeout=LONGEST_LOCK_S, isolation_level=None, check_same_thread=False, uri=True)


def _require_version(db: sqlite3.Connection, file: Path) -> None:
    (version,) = db.execute("PRAGMA user_version").fetchone()
    if version != VERSION:
        raise DiskRefused(
            f"{file.name} has tables of version {version}, and this guidefield reads version {VERSION}; use the "
            "guidefield that wrote it, or move the file away"
        )
