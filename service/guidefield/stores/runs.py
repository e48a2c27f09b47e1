"""Runs of all users of a data folder: requests and replies in one database, recordings as files beside it.

A run is written when it begins, without anybody waiting for that, and when it ends, before it is answered. One process
writes; others may read. The oldest runs of a user make room for new ones. `run_file.py` has the tables and the thread
that writes, `run_rows.py` the statements for rows.
"""

from __future__ import annotations

import contextlib
import math
import sqlite3
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import msgspec

from guidefield.errors import DiskRefused, MalformedRequest, UnknownObject
from guidefield.messages import codec, replies
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest, ReadRuns
from guidefield.stores import run_rows
from guidefield.stores.files import checked_name, decode_if_whole, user_folder, users_in
from guidefield.stores.recordings import KeptRecording, Recordings
from guidefield.stores.run_file import FILE, Readers, RunWriter, checkpoint

FORGET = "DELETE FROM runs WHERE (owner, run_id) = (?, ?) AND ended IS NULL"  # unless it has ended
MOST_DROPPED = 100
"""Number of runs that are dropped for a new one at most: if far fewer are to be kept, no answer waits for all."""
SWEEP_INTERVAL_S = 60.0  # time between two searches for runs that are too old, and for files that nobody needs [s]


@dataclass(frozen=True)
class Retention:
    """Limits for each user, beyond which the oldest runs are dropped: number, total size, age [s].

    The defaults of number and size are in docs/wire.md, by `tools/wire_page`, and in docs/service.md, by hand.
    """

    runs: int = 1_000
    bytes: int = 20 * 2**30
    seconds: float = math.inf


DEFAULT_RETENTION = Retention()


class NoRuns:
    """Keeps no run: each is unknown."""

    def list(self, _request: ReadRuns) -> replies.RunsReply:
        """List none."""
        return replies.RunsReply(runs=[])

    def _raise_unknown(self, run_id: str, **_: bool) -> NoReturn:
        raise _unknown(run_id)

    read = delete = share = _raise_unknown


class RunDatabase:
    """The runs of all users.

    Attributes:
        unended: Runs, by owner and id, whose end could not be written: no list or reading shows them, and their rows
            are deleted as soon as the disk permits.
        render: Called with the owner and id of each run whose recording is to be rendered from its log.
    """

    def __init__(
        self,
        data: Path,
        retention: Retention = DEFAULT_RETENTION,
        byte_quota_of: Callable[[str], int | None] = lambda _: None,
    ) -> None:
        self._data, self._retention, self._byte_quota_of = data, retention, byte_quota_of
        self.readers = Readers(data / FILE)
        self.writer = RunWriter(data / FILE, self._keep_up)
        self.render: Callable[[str, str], None] = lambda _owner, _run_id: None
        self.unended: set[tuple[str, str]] = set()
        self._abandoned: replies.ErrorReply | None = None
        self._since, self._swept = time.time(), time.monotonic()

    def of(self, owner: str) -> UserRuns:
        """Return the runs of a user."""
        return UserRuns(self, owner)

    def recordings(self, owner: str) -> Recordings:
        """Return the recordings of a user."""
        return Recordings(user_folder(self._data, owner) / "recordings")

    def sweep(self, error: replies.ErrorReply, since: float = math.inf) -> None:
        """End the runs that a killed service was working on, and have recordings rendered that have only a log.

        Args:
            error: The error that ends them.
            since: Begin of this process's own runs, which stay [s since 1970]; infinite: it has none.

        Raises:
            DiskRefused: if the database can't be read or written; then it is tried again from time to time.
        """
        self._abandoned = error
        self.writer.submit(partial(run_rows.end_abandoned, error, since)).result()
        self._abandoned = None
        with self.readers.reading() as db:
            users = [owner for (owner,) in db.execute("SELECT owner FROM usage")]
            owed = db.execute("SELECT owner, run_id FROM runs WHERE recorded = 'owed'").fetchall()
        for user in users:
            recordings = self.recordings(user)
            recordings.sweep()
            owed += [(user, run_id) for run_id in reversed(recordings.list_owed())]
        for owner, run_id in reversed(dict.fromkeys(reversed(owed))):
            self.render(owner, run_id)

    def take_over(self, tell: Callable[[str], None]) -> None:
        """Take over the runs that guidefield 0.1 kept in folders; `tell` takes sentences about the progress.

        Raises DiskRefused if the database can't be written; OSError, if a folder can't be read.
        """
        for owner in (PLAIN, *users_in(self._data)):
            own = user_folder(self._data, owner)
            folders, shared = run_rows.earlier_folders(own / "runs"), own / "shared" / "runs"
            for begin in range(0, len(folders), run_rows.AT_ONCE):
                tell(f"the runs of guidefield 0.1 are taken over into a database: {begin} of {len(folders)}")
                chunk = folders[begin : begin + run_rows.AT_ONCE]
                self.writer.submit(partial(run_rows.add_folders, owner, chunk, shared)).result()
                checkpoint(self._data / FILE)
                run_rows.move_recordings(chunk, self.recordings(owner), shared)
            with contextlib.suppress(OSError):  # something else is in it, or it isn't there
                (own / "runs").rmdir()

    def close(self) -> None:
        """Write what waits to be written, and close the file."""
        self.readers.close()  # first, since the last connection empties the write-ahead log, which a reader can't
        self.writer.close()

    def note_recording(self, owner: str, run_id: str) -> None:
        """Note the state of a run's recording; if the run was deleted, delete the recording, too."""

        def note(db: sqlite3.Connection) -> None:
            recordings = self.recordings(owner)
            kept = recordings.describe(run_id)
            update = "UPDATE runs SET recording = ?, recorded = ? WHERE owner = ? AND run_id = ?"
            if not run_rows.execute(update, (kept.bytes, kept.kind, owner, run_id), db):
                recordings.drop(run_id)

        self.writer.submit(note, urgent=False)

    def make_room(self, owner: str, newest: int | None, db: sqlite3.Connection) -> None:
        """Drop a user's oldest runs but the one with the number `newest`, if runs are too many, large or old."""
        most, quota, too_old = self._retention, self._byte_quota_of(owner), time.time() - self._retention.seconds
        most_bytes = most.bytes if quota is None else min(quota, most.bytes)
        runs, size = db.execute("SELECT runs, bytes FROM usage WHERE owner = ?", (owner,)).fetchone() or (0, 0)
        dropped = []
        oldest = "SELECT number, run_id, bytes + recording, ended FROM runs "
        for number, run_id, taken, ended in db.execute(
            f"{oldest} WHERE owner = ? AND ended IS NOT NULL ORDER BY ended, number", (owner,)
        ):
            if number == newest or (runs <= most.runs and size <= most_bytes and ended >= too_old):
                break
            dropped.append((number, run_id))
            if len(dropped) == MOST_DROPPED:
                break
            runs, size = runs - 1, size - taken
        run_rows.drop_runs(self.recordings(owner), dropped, db)

    def _keep_up(self) -> None:
        """Delete runs whose end could not be written, runs that are too old, and files that no log needs."""
        if self._abandoned is not None:
            self.sweep(self._abandoned, self._since)
        for name in tuple(self.unended):
            with contextlib.suppress(DiskRefused):
                self.writer.submit(partial(run_rows.execute, FORGET, name)).result()
                self.unended.discard(name)
        if time.monotonic() - self._swept > SWEEP_INTERVAL_S:
            self._swept = time.monotonic()
            with self.readers.reading() as db:
                owners = db.execute("SELECT owner FROM usage").fetchall()
            for (owner,) in owners:
                self.recordings(owner).sweep_shared()
                if self._retention.seconds < math.inf:
                    self.writer.submit(partial(self.make_room, owner, None), urgent=False)


class UserRuns:
    """The runs of one user, and in a list those of others that this user may see."""

    def __init__(self, database: RunDatabase, owner: str) -> None:
        self._database, self._owner = database, owner
        self._writer, self._readers = database.writer, database.readers
        self.recordings = database.recordings(owner)

    def begin(self, run: run_rows.NewRun) -> None:
        """Write that a run begins, without waiting for it."""
        if run.begun is None:
            run.began = time.time()
            run.begun = self._writer.submit(partial(run_rows.insert, run), urgent=False, size=len(run.request))

    def finish(self, run: run_rows.NewRun, reply: bytes) -> Future[Any]:
        """Keep the reply of a run; the future is done once it is kept, with DiskRefused if the disk refuses."""
        return self._end(run, reply=reply)

    def fail(self, run: run_rows.NewRun, error: replies.ErrorReply) -> Future[Any]:
        """Keep the error that ended a run, unless it was the request's fault: then nothing is kept."""
        return self._end(run, error=codec.encode(error)) if error.name in run_rows.KEPT_ERRORS else self.discard(run)

    def discard(self, run: run_rows.NewRun) -> Future[Any]:
        """Forget a run that has begun."""
        if run.begun is None or run.begun.cancel():
            nothing: Future[None] = Future()
            nothing.set_result(None)
            return nothing
        return self._writer.submit(partial(run_rows.execute, FORGET, (run.owner, run.run_id)))

    def drop_recording(self, run_id: str) -> None:
        """Delete the recording of a run, or its log, without waiting for it."""
        self._writer.submit(lambda _: self.recordings.drop(run_id), urgent=False)

    def has(self, run_id: str) -> bool:
        """Return whether there is a run of that name."""
        return self._row(run_id, "1") is not None

    def list(self, request: ReadRuns) -> replies.RunsReply:
        """List the runs that are kept, newest first, with those of others that the user may see, as ``owner:id``.

        Raises DiskRefused if the database can't be read.
        """
        self._writer.settle()
        after = 2**63 - 1 if request.after is None else int(request.after)
        unended = [":".join(name) for name in tuple(self._database.unended)]
        wanted = {
            "status = :status": request.status,
            "robot = :robot": request.robot,
            "began >= :since": request.since,
            r"message LIKE :text ESCAPE '\'": None if request.text is None else _like_pattern(request.text),
            "owner || ':' || run_id NOT IN (SELECT value FROM json_each(:unended))": unended or None,
        }
        values = dict(zip(("status", "robot", "since", "text", "unended"), wanted.values(), strict=True))
        values |= {"owner": self._owner, "after": after, "limit": request.limit + 1}
        values["unended"] = msgspec.json.encode(unended).decode()
        where = " AND ".join(clause for clause, value in wanted.items() if value is not None) or "TRUE"
        columns = "number, owner, run_id, status, message, robot, scene, began, ended, bytes + recording, recorded"
        page = f"SELECT {columns} FROM runs %s AND number < :after AND {where} ORDER BY number DESC LIMIT :limit"  # noqa: S608
        count = f"SELECT count(*) FROM runs %s AND {where}"  # noqa: S608 - ours
        sources = ["NOT INDEXED WHERE TRUE"]
        if self._owner != PLAIN:
            sources = ["INDEXED BY owned WHERE owner = :owner", "INDEXED BY shared WHERE shared AND owner <> :owner"]
        with self._readers.reading() as db:
            rows = [row for source in sources for row in db.execute(page % source, values)]
            total = sum(db.execute(count % source, values).fetchone()[0] for source in sources)
        rows.sort(reverse=True)
        following = str(rows[request.limit - 1][0]) if len(rows) > request.limit else None
        return replies.RunsReply(
            runs=[self._summary(row) for row in rows[: request.limit]], total=total, next=following
        )

    def read(self, run_id: str) -> replies.AnyRunReply:
        """Read one run.

        Raises UnknownObject if there is none of that name, or it is damaged; DiskRefused if the database can't be read.
        """
        self._writer.settle()
        row = self._row(run_id, "kind, began, encoding, request, reply, error", "JOIN documents USING (number)")
        if row is None:
            raise _unknown(run_id)
        kind, began, encoding, request, reply, error = row
        written, (request_kind, reply_kind, run_kind) = Encoding(encoding), _KINDS[kind]
        asked = _decode(run_id, "request", request, request_kind, written)
        return run_kind(
            run_id=run_id,
            began=began,
            request=msgspec.structs.replace(asked, run_id=run_id),
            reply=None if reply is None else _decode(run_id, "reply", reply, reply_kind, written),
            error=None if error is None else _decode(run_id, "error", error, replies.ErrorReply, Encoding.JSON),
        )

    def require(self, run_id: str) -> None:
        """Raise UnknownObject if there is no run of that name."""
        if not self.has(run_id):
            self._writer.settle()
            if not self.has(run_id):
                raise _unknown(run_id)

    def delete(self, run_id: str) -> None:
        """Forget one run.

        Raises UnknownObject if there is none of that name; raises DiskRefused if the database can't be written.
        """
        checked_name(run_id, "run_id")

        def drop(db: sqlite3.Connection) -> None:
            rows = db.execute("SELECT number, run_id FROM runs WHERE (owner, run_id) = (?, ?)", (self._owner, run_id))
            found = rows.fetchall()
            if not found:
                raise _unknown(run_id)
            run_rows.drop_runs(self.recordings, found, db)

        self._writer.submit(drop).result()

    def share(self, run_id: str, *, shared: bool) -> None:
        """Let every user read a run, or no other user any more.

        Raises UnknownObject if there is none of that name; raises DiskRefused if the database can't be written.
        """
        share = "UPDATE runs SET shared = ? WHERE (owner, run_id) = (?, ?)"
        if not self._writer.submit(partial(run_rows.execute, share, (shared, self._owner, run_id))).result():
            raise _unknown(run_id)

    def is_shared(self, run_id: str) -> bool:
        """Return whether every user may read a run."""
        with contextlib.suppress(DiskRefused):
            return self._row(run_id, "shared") == (1,)
        return False

    def _row(self, run_id: str, columns: str, joined: str = "") -> tuple[Any, ...] | None:
        """Read columns of a run; None if there is none of that name."""
        checked_name(run_id, "run_id")
        if (self._owner, run_id) in self._database.unended:
            return None
        with self._readers.reading() as db:
            found: tuple[Any, ...] | None = db.execute(
                f"SELECT {columns} FROM runs {joined} WHERE (owner, run_id) = (?, ?)",  # noqa: S608 - ours
                (self._owner, run_id),
            ).fetchone()
        return found

    def _end(self, run: run_rows.NewRun, reply: bytes | None = None, error: bytes | None = None) -> Future[Any]:
        """Write the row of a run that has ended, in place of that of its beginning."""
        begun = run.begun if run.begun is not None and not run.begun.cancel() else None
        run.reply, run.error = reply, error

        def end(db: sqlite3.Connection) -> KeptRecording | None:
            run.ended, recording = time.time(), self.recordings.describe(run.run_id)
            if begun is not None and begun.exception() is None:
                unended = "SELECT number FROM runs WHERE (owner, run_id) = (?, ?) AND ended IS NULL"
                found = db.execute(unended, (run.owner, run.run_id)).fetchone()
                if found is None:
                    return None  # it was deleted while it ran
                number = int(found[0])
                run_rows.complete(number, run, recording, db)
            else:
                run_rows.execute(FORGET, (run.owner, run.run_id), db)  # of an earlier run, whose end wasn't written
                number = run_rows.insert(run, db, recording)
            self._database.make_room(run.owner, number, db)
            return recording

        def settle(done: Future[KeptRecording | None]) -> None:
            if done.exception() is None:
                self._database.unended.discard((run.owner, run.run_id))
                recording = done.result()
                if recording is not None and recording.kind == "owed":
                    self._database.render(run.owner, run.run_id)
            elif begun is not None and begun.exception() is None:
                self._database.unended.add((run.owner, run.run_id))

        done = self._writer.submit(end, size=len(run.request) + len(reply or b""))
        done.add_done_callback(settle)
        return done

    def _summary(self, row: tuple[Any, ...]) -> replies.RunSummary:
        _, owner, run_id, status, message, robot, scene, began, ended, size, recorded = row
        name = run_id if owner == self._owner else f"{owner}:{run_id}"
        if recorded == "owed":  # another process than the service may have rendered it
            recorded = self._database.recordings(owner).describe(run_id).kind
        about = {"ended": ended, "message": message, "bytes": size, "recording": recorded}
        return replies.RunSummary(name, status, robot, scene, began, **about)


Runs = NoRuns | UserRuns  # an engine's store of runs


_KINDS: dict[str, tuple[type[MotionRequest], type[replies.MotionReply], type[replies.AnyRunReply]]] = {
    "plan": (PlanRequest, replies.PlanReply, replies.RunReply),
    "certify": (CertifyRequest, replies.CertifyReply, replies.CertifyRunReply),
}
"""The request, the reply and the run of a kind."""


def answered_before(runs: UserRuns, request: MotionRequest, run_id: str) -> replies.MotionReply:
    """Return the reply of a run to the same request, sent again under its name because the answer may have been lost.

    Raises MalformedRequest if the run of that name had another request; raises the error that ended it.
    """
    kept = runs.read(run_id)
    if kept.request != request or (kept.error is None and kept.reply is None):
        raise name_taken(run_id)
    if kept.error is not None:
        raise replies.make_error(kept.error)
    assert kept.reply is not None, "a run ends with a reply or an error"
    return kept.reply


def name_taken(run_id: str) -> MalformedRequest:
    """Return the refusal of a name that another run has."""
    return MalformedRequest(f"run_id {run_id!r} is taken; leave it out to be given a new one", run_id=run_id)


def _decode(run_id: str, document: str, data: bytes, kind: type[Any], encoding: Encoding) -> Any:
    message = decode_if_whole(data, kind, encoding)
    if message is None:
        fault = f"run {run_id!r} can't be read: its {document} is damaged; `delete` removes it"
        raise UnknownObject(fault, run_id=run_id, document=document)
    return message


def _like_pattern(text: str) -> str:
    for special in "\\%_":
        text = text.replace(special, f"\\{special}")
    return f"%{text}%"


def _unknown(run_id: str) -> UnknownObject:
    return UnknownObject(f"there is no run {run_id[:64]!r} here", run_id=run_id[:64])
