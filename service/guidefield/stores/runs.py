"""Runs on disk: request, reply and recording of each, the oldest dropped when there are too many.

A run's folder appears by one rename, with its request already inside, and is renamed away before it is deleted:
whoever lists the runs sees whole ones only, also after a kill at any moment.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import msgspec

from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages import codec
from guidefield.messages.replies import (
    AnyRunReply,
    CertifyReply,
    CertifyRunReply,
    ErrorReply,
    MotionReply,
    PlanReply,
    RunReply,
    RunSummary,
    is_certify,
)
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest
from guidefield.stores.files import checked_name, decoded, read_if_any
from guidefield.stores.run_folder import ERROR, LOST, OWED, RECORDING, REPLY, REQUEST, has_ended, state, summary
from guidefield.system import is_alive, told_apart
from guidefield.whole_file import DRAFT, flush_folder, write_whole

LONGEST_WRITING = 60.0
"""How long is waited for a recording that is being written [s]."""
LOOKED_EVERY = 0.01
"""How often it is looked for [s]."""

_log = logging.getLogger(__name__)
_M = TypeVar("_M", bound=msgspec.Struct)


@dataclass(frozen=True)
class Retention:
    """How much is kept before the oldest runs are dropped: so many, so large together, so old [s]."""

    runs: int = 1_000
    bytes: int = 20 * 2**30
    seconds: float = float("inf")


DEFAULT_RETENTION = Retention()


class NoRuns:
    """Keeps no run."""

    def begin(self, run_id: str, request: MotionRequest) -> None:
        """Keep nothing."""

    def recording_path(self, run_id: str) -> Path | None:
        """There is no place for a recording."""

    def finish(self, run_id: str, reply: MotionReply) -> None:
        """Keep nothing."""

    def fail(self, run_id: str, error: ErrorReply) -> None:
        """Keep nothing."""

    def discard(self, run_id: str) -> None:
        """Forget nothing: nothing was kept."""

    def summaries(self) -> list[RunSummary]:
        """List none."""
        return []

    def read(self, run_id: str) -> AnyRunReply:
        """Raise UnknownObject."""
        raise _unknown(run_id)

    def recording(self, run_id: str) -> Path:
        """Raise UnknownObject."""
        raise _unknown(run_id)

    def bodies_folder(self) -> Path | None:
        """There is none."""
        return None

    def delete(self, run_id: str) -> None:
        """Raise UnknownObject."""
        raise _unknown(run_id)


class RunStore:
    """Runs in a folder: `<id>/request.json`, `recording.rrd`, and `reply.json` or `error.json`.

    A recording may come after the reply: then `recording.owed` says who is to write it, until it is there.

    Several processes may share the folder. Where the disk refuses, OSError comes through.

    Args:
        folder: Made if it isn't there.
        retention: How much is kept.
    """

    def __init__(self, folder: Path, retention: Retention = DEFAULT_RETENTION) -> None:
        self._folder = folder
        self._retention = retention
        self._summaries: dict[str, tuple[object, RunSummary]] = {}
        folder.mkdir(parents=True, exist_ok=True)

    def begin(self, run_id: str, request: MotionRequest) -> None:
        """Keep the request of a run that begins; the oldest runs make room for it.

        Raises:
            MalformedRequest: if there is a run of that name already.
        """
        final = self._folder / checked_name(run_id, "run_id")
        self._make_room()
        draft = self._folder / f".{uuid.uuid4().hex}{DRAFT}"
        draft.mkdir()
        try:
            write_whole(draft / REQUEST, codec.encode(request))
            draft.rename(final)
        except OSError:
            shutil.rmtree(draft, ignore_errors=True)
            if final.exists():
                raise MalformedRequest(
                    f"run_id {run_id!r} is taken; leave it out to be given a new one", run_id=run_id
                ) from None
            raise
        with self._dropping(final):
            flush_folder(self._folder)

    def recording_path(self, run_id: str) -> Path | None:
        """Where its recording is to be written, at once and whole."""
        return self._folder / run_id / RECORDING

    def finish(self, run_id: str, reply: MotionReply) -> None:
        """Keep the reply; its recording is there already, or owed.

        Raises:
            OSError: if the disk refuses; then the run is dropped, or it would seem to be under way for ever.
        """
        folder = self._folder / run_id
        with self._dropping(folder):
            write_whole(folder / REPLY, codec.encode(reply))

    def fail(self, run_id: str, error: ErrorReply) -> None:
        """Keep the error that ended a run; nothing is done where there is no such run, or it has its reply.

        Raises:
            OSError: if the disk refuses; then the run is dropped.
        """
        folder = self._folder / checked_name(run_id, "run_id")
        if folder.is_dir() and not (folder / REPLY).exists():
            with self._dropping(folder):
                for leftover in folder.glob(".*"):
                    leftover.unlink(missing_ok=True)
                write_whole(folder / ERROR, codec.encode(error))

    def discard(self, run_id: str) -> None:
        """Forget a run whose request was refused."""
        self._drop(self._folder / run_id)

    def sweep(self, error: ErrorReply) -> None:
        """Clear away what a killed process left behind, and end the runs that it was working on with `error`.

        Only for who holds the folder alone: a living process' runs would be ended too.
        """
        for leftover in self._folder.glob(".*"):
            shutil.rmtree(leftover, ignore_errors=True)
        for folder in self._folders():
            if not has_ended(folder):
                try:
                    self.fail(folder.name, error)
                except OSError as refusal:
                    _log.warning("run %s, left behind, is dropped: %s", folder.name, refusal)

    def summaries(self) -> list[RunSummary]:
        """The runs that are kept, newest first; of those that did not change since the last time no file is read."""
        known = self._summaries
        told: dict[str, tuple[object, RunSummary]] = {}
        for folder in self._folders():
            before, now = known.get(folder.name), state(folder)
            run = before[1] if before is not None and before[0] == now else summary(folder)
            if run is not None:
                told[folder.name] = now, run
        self._summaries = told
        return sorted((run for _, run in told.values()), key=lambda run: run.began, reverse=True)

    def read(self, run_id: str) -> AnyRunReply:
        """One run.

        Raises:
            UnknownObject: if there is none of that name, or a file of it is damaged.
        """
        folder = self._existing(run_id)
        try:
            began = (folder / REQUEST).stat().st_mtime
            request = (folder / REQUEST).read_bytes()
        except FileNotFoundError:
            raise _unknown(run_id) from None
        reply, error = read_if_any(folder / REPLY), read_if_any(folder / ERROR)
        ended = None if error is None else _whole(run_id, ERROR, error, ErrorReply)
        if is_certify(request):
            return CertifyRunReply(
                run_id=run_id,
                began=began,
                request=_whole(run_id, REQUEST, request, CertifyRequest),
                reply=None if reply is None else _whole(run_id, REPLY, reply, CertifyReply),
                error=ended,
            )
        return RunReply(
            run_id=run_id,
            began=began,
            request=_whole(run_id, REQUEST, request, PlanRequest),
            reply=None if reply is None else _whole(run_id, REPLY, reply, PlanReply),
            error=ended,
        )

    def recording(self, run_id: str) -> Path:
        """The file of one run's recording, without its robot's meshes; waits while it is being written.

        Raises:
            UnknownObject: if there is no such run, or it has no recording, or not yet, or it was lost.
        """
        folder, until = self._existing(run_id), time.monotonic() + LONGEST_WRITING
        while (owed := read_if_any(folder / OWED)) is not None and time.monotonic() < until:
            if not is_alive(owed.decode()):
                if (folder / OWED).exists():
                    raise UnknownObject(
                        f"the recording of run {run_id!r} is lost: the process that wrote it ended; `guidefield replay"
                        f" {run_id}` plans it again",
                        run_id=run_id,
                    )
                break  # it was done just before it ended
            time.sleep(LOOKED_EVERY)
        recording = folder / RECORDING
        if recording.exists():
            return recording
        lost = read_if_any(folder / LOST)
        why = "" if lost is None else f": {lost.decode()}"
        raise UnknownObject(f"run {run_id!r} has no recording{why}", run_id=run_id)

    def owe_recording(self, run_id: str) -> None:
        """Say that this process will write a run's recording after the reply.

        Raises:
            OSError: if the disk refuses.
        """
        write_whole(self._folder / run_id / OWED, told_apart(os.getpid()).encode(), durable=False)

    def settle_recording(self, run_id: str, fault: str | None) -> None:
        """Say that a recording that was owed is there, or why it won't be; of a run that is gone nothing is said."""
        folder = self._folder / run_id
        with contextlib.suppress(OSError):
            if fault is not None:
                write_whole(folder / LOST, fault.encode(), durable=False)
            (folder / OWED).unlink(missing_ok=True)

    def bodies_folder(self) -> Path | None:
        """Where the meshes of robots are kept: beside the folder of the runs."""
        return self._folder.with_name(f"{self._folder.name}-robots")

    def delete(self, run_id: str) -> None:
        """Forget one run.

        Raises:
            UnknownObject: if there is none of that name.
        """
        self._drop(self._existing(run_id))

    def _existing(self, run_id: str) -> Path:
        folder = self._folder / checked_name(run_id, "run_id")
        if not folder.is_dir():
            raise _unknown(run_id)
        return folder

    def _folders(self) -> list[Path]:
        with os.scandir(self._folder) as entries:
            return [Path(entry.path) for entry in entries if not entry.name.startswith(".") and entry.is_dir()]

    def _drop(self, folder: Path) -> None:
        grave = self._folder / f".{uuid.uuid4().hex}.old"
        try:
            folder.rename(grave)
        except FileNotFoundError:  # another process dropped it first
            return
        shutil.rmtree(grave, ignore_errors=True)

    @contextlib.contextmanager
    def _dropping(self, folder: Path) -> Iterator[None]:
        """Drop a run if the disk refuses what the block writes of it; a full disk still lets go of files."""
        try:
            yield
        except OSError:
            self._drop(folder)
            raise

    def _make_room(self) -> None:
        """Drop ended runs that are too old, and the oldest until one more fits."""
        kept = (_extent(folder) for folder in self._folders() if has_ended(folder))
        ended = sorted((extent for extent in kept if extent is not None), key=lambda extent: extent.ended)
        count, size = len(ended), sum(extent.bytes for extent in ended)
        too_old = time.time() - self._retention.seconds
        for extent in ended:
            if count < self._retention.runs and size < self._retention.bytes and extent.ended >= too_old:
                return
            self._drop(extent.folder)
            count, size = count - 1, size - extent.bytes


Runs = NoRuns | RunStore
"""What an engine keeps runs in; a run is named by its id."""


@dataclass(frozen=True)
class _Extent:
    """When an ended run ended, and how much room it takes."""

    folder: Path
    ended: float
    bytes: int


def _extent(folder: Path) -> _Extent | None:
    try:
        return _Extent(folder, folder.stat().st_mtime, sum(file.stat().st_size for file in folder.iterdir()))
    except FileNotFoundError:  # dropped meanwhile, by another process
        return None


def _whole(run_id: str, file: str, data: bytes, kind: type[_M]) -> _M:
    """The message that a file of a run holds.

    Raises:
        UnknownObject: if it holds none.
    """
    message = decoded(data, kind)
    if message is None:
        raise UnknownObject(
            f"run {run_id!r} can't be read: its {file} is damaged; `delete` removes it", run_id=run_id, file=file
        )
    return message


def _unknown(run_id: str) -> UnknownObject:
    return UnknownObject(f"there is no run {run_id[:64]!r} here", run_id=run_id[:64])
