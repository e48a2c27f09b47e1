"""One thread that writes the database of runs: all changes that wait are one transaction, and share its commit.

Theory of operation. A change is a function of the connection, and a future says when it is committed, or why it isn't.
If a transaction fails, each of its changes is tried again alone: a reply too large for the disk costs no other one. A
second thread checkpoints once a second, because that waits for the disk, and no answer should.
"""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from guidefield.errors import DiskRefused
from guidefield.stores.run_file import checkpoint, connect_writer, telling_faults

LINGER_S = 0.05  # longest time that a change without a waiting caller waits for others to share its commit [s]
UPKEEP_INTERVAL_S = 1.0  # time between two checkpoints, and so what a power cut may cost [s]
RETRY_INTERVAL_S = 1.0  # shortest time between two attempts to open a file that could not be opened [s]
MAX_WAITING_BYTES = 256 * 2**20  # size of changes that wait beyond which callers wait, too [bytes]

_log = logging.getLogger(__name__)

_T = TypeVar("_T")


class _Change(NamedTuple):
    apply: Callable[[sqlite3.Connection], Any]
    done: Future[Any]
    size: int


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
        """Have a change written that takes some memory until then [bytes]; `urgent`: somebody waits for it.

        `apply` makes it within a transaction, and may be called a second time, after a rollback. The future comes to
        what it returned, once that is committed, or to DiskRefused; until the change is begun it may be cancelled.
        """
        done: Future[_T] = Future()
        with self._changed:
            if self._closed:
                done.set_exception(DiskRefused("the service has ended"))
                return done
            if self._threads[0].ident is None:
                for thread in self._threads:
                    thread.start()
            self._changed.wait_for(lambda: self._size < MAX_WAITING_BYTES or self._closed)
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
        """Make some changes; return their own refusals, which are no reason to undo others, and their results."""
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
        told = ""
        while not self._ended.wait(UPKEEP_INTERVAL_S):
            try:
                self._keep_up()
                if self._unflushed:
                    self._unflushed = False
                    checkpoint(self._file)
                told = ""
            except Exception as error:  # the next one tries again
                if told != (told := f"{error}"):
                    _log.warning("the database of runs is not flushed: %s", told)
