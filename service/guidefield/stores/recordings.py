"""Recordings of one user's runs: a file for each in a folder, or the log that it will be rendered from.

Theory of operation. A run's log is written before its reply is sent, and deleted once its recording is rendered. While
there is a log, the recording is "owed", whatever process ends. Scenes and robots that many logs need are kept once by
content in a folder beside. Each log has hard links to those that it needs, so that the file system counts the logs that
need a file: none of these is ever swept, whichever process is killed at any moment. Endings of names are the format.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from guidefield.errors import UnknownObject
from guidefield.stores.files import checked_name, read_if_any
from guidefield.whole_file import link_shared, remove_unshared, write_whole

RECORDING, LOG, LOST = ".rrd", ".log", ".lost"
"""Endings of file names: a recording, the log of one that isn't rendered yet, the reason why one never will be."""
PROOF = ".npz"  # ending of the file of a run's proof
SCENE_LINK = ".drawn"  # ending of a recording's link to its large scene, drawn; `recorder/stored.py` makes it
SCENE, ROBOT, OBSTACLES = ".scene", ".robot", (".obstacle1", ".obstacle2", ".obstacle3", ".obstacle4")
"""Endings of the links from a log to the scene and the robot that it needs, and to the largest obstacles."""
NEEDED = (SCENE, ROBOT, *OBSTACLES)  # endings of all links from a log to what it shares with others
EARLIER_MARK, EARLIER_LOSS = ".owed", "the process that wrote it ended"
"""The ending of earlier versions' mark of a recording that is being written, and the reason why it is lost."""
SHARED_UNUSED_S = 600.0  # time after its last use for which a shared file is kept that no log needs [s]
Kind = Literal["none", "owed", "rendered", "lost"]
"""The state of a recording, as `RunSummary.recording`: none; its log alone; rendered; lost, with the reason."""


@dataclass(frozen=True)
class KeptRecording:
    """The state of a run's recording, and its size on the disk [bytes]."""

    kind: Kind
    bytes: int = 0


@dataclass(frozen=True)
class SharedFile:
    """Content that many logs need."""

    digest: str  # hash of the content, its name in the shared folder
    ending: str  # the ending of a log's link to it, one of `NEEDED`
    content: Callable[[], bytes]  # makes the content, if the folder doesn't have it


class Recordings:
    """Recordings as files `<id>.rrd`. Several processes may share the folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def bodies_folder(self) -> Path:
        """Folder of the robots' meshes, which all recordings share."""
        return self.folder.with_name("runs-robots")

    @property
    def shared_folder(self) -> Path:
        """Folder of the scenes and robots that logs need, by content."""
        return self.folder.with_name("runs-shared")

    def path(self, run_id: str) -> Path:
        """Return the path of a run's recording, whether it exists or not; raises as `file`."""
        return self.file(run_id, RECORDING)

    def file(self, run_id: str, ending: str) -> Path:
        """Return the path of one of a run's files; raises MalformedRequest if the name can't be a file's."""
        return self.folder / f"{checked_name(run_id, 'run_id')}{ending}"

    def find(self, run_id: str) -> Path:
        """Return the file of a run's recording; UnknownObject if there is none, or not yet, or it was lost."""
        recording = self.path(run_id)
        if recording.exists():
            return recording
        if self.is_owed(run_id):
            message = f"the recording of run {run_id!r} isn't rendered yet; `guidefield runs render` does it"
            raise UnknownObject(message, run_id=run_id)
        lost = read_if_any(self.file(run_id, LOST))
        why = "" if lost is None else f": {lost.decode()}"
        raise UnknownObject(f"run {run_id!r} has no recording{why}", run_id=run_id)

    def read_proof(self, run_id: str) -> bytes:
        """Return the proof of a run, as the content of a file.

        Raises UnknownObject if it has none; raises OSError if the disk refuses.
        """
        found = read_if_any(self.file(run_id, PROOF))
        if found is None:
            message = f"run {run_id!r} has no proof; a request with `proof` true keeps one, or its reply warns why not"
            raise UnknownObject(message, run_id=run_id)
        return found

    def is_owed(self, run_id: str) -> bool:
        """Return whether a run's recording isn't rendered yet."""
        return self.file(run_id, LOG).exists()

    def list_owed(self) -> list[str]:
        """Return the runs whose recordings aren't rendered yet, the newest first."""
        found = []
        with contextlib.suppress(FileNotFoundError), os.scandir(self.folder) as entries:
            for entry in entries:
                if entry.name.endswith(LOG) and not entry.name.startswith("."):
                    with contextlib.suppress(FileNotFoundError):
                        found.append((entry.stat().st_mtime_ns, entry.name.removesuffix(LOG)))
        return [name for _, name in sorted(found, reverse=True)]

    def describe(self, run_id: str) -> KeptRecording:
        """Return the state of a run's recording; its size includes the proof and shared files."""
        own = str(self.file(run_id, ""))
        proof, log = _size(own + PROOF) or 0, _size(own + LOG)
        if log is not None:
            return KeptRecording("owed", proof + log + sum(_size(own + one) or 0 for one in (*NEEDED, RECORDING)))
        recording = _size(own + RECORDING)
        if recording is not None:
            return KeptRecording("rendered", proof + recording + (_size(own + SCENE_LINK) or 0))
        lost = _size(own + LOST)
        return KeptRecording("none", proof) if lost is None else KeptRecording("lost", proof + lost)

    def store_log(self, run_id: str, log: bytes, shared: Iterable[SharedFile]) -> None:
        """Keep a run's log, and links to the scene and robot that it needs.

        Raises OSError if the disk refuses, or knows no hard links, and leaves nothing.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            for ending in (RECORDING, LOST, SCENE_LINK, *NEEDED):  # of an earlier run of that name
                self.file(run_id, ending).unlink(missing_ok=True)
            for one in shared:
                link_shared(self.file(run_id, one.ending), self.shared_folder / one.digest, one.content)
            write_whole(self.file(run_id, LOG), log, durable=False)
        except OSError:
            with contextlib.suppress(OSError):
                self.drop(run_id)
            raise

    def settle(self, run_id: str, log: os.stat_result, fault: str | None = None) -> None:
        """Delete a log whose recording is there, or keep the `fault` for which it can't be rendered.

        A newer log of the same name, which isn't that of the stat result, stays. Raises OSError if the disk refuses.
        """
        path = self.file(run_id, LOG)
        with contextlib.suppress(FileNotFoundError):
            if not os.path.samestat(path.stat(), log):
                return
            if fault is not None:
                write_whole(self.file(run_id, LOST), fault.encode(), durable=False)
            path.unlink()
            for ending in NEEDED:
                self.file(run_id, ending).unlink(missing_ok=True)

    def give_up(self, run_id: str, fault: str) -> None:
        """Delete a log that can't be rendered, and keep why."""
        with contextlib.suppress(OSError):
            self.settle(run_id, self.file(run_id, LOG).stat(), fault)

    def drop(self, run_id: str) -> None:
        """Delete a recording, or its log with files that no other log needs, and the proof.

        Raises OSError if the disk refuses.
        """
        for ending in (LOG, LOST, RECORDING, SCENE_LINK, PROOF, *NEEDED):
            self.file(run_id, ending).unlink(missing_ok=True)

    def sweep(self) -> None:
        """Delete drafts of killed processes; only the process that holds the data folder may."""
        for draft in self.folder.glob(".*"):
            draft.unlink(missing_ok=True)
        for mark in self.folder.glob(f"*{EARLIER_MARK}"):
            mark.unlink(missing_ok=True)
            write_whole(mark.with_suffix(LOST), EARLIER_LOSS.encode(), durable=False)
        for ending in NEEDED:
            for link in self.folder.glob(f"*{ending}"):
                if not link.with_suffix(LOG).exists():
                    link.unlink(missing_ok=True)
        for link in self.folder.glob(f"*{SCENE_LINK}"):
            if not link.with_suffix(RECORDING).exists():
                link.unlink(missing_ok=True)
        self.sweep_shared(unused=0.0)
        with contextlib.suppress(OSError):  # it isn't empty, or there is none
            self.shared_folder.rmdir()

    def sweep_shared(self, unused: float = SHARED_UNUSED_S) -> None:
        """Delete the shared scenes and robots that no log needs, and that weren't used for some time [s]."""
        remove_unshared(self.shared_folder, unused)


def _size(file: str) -> int | None:
    try:
        return os.stat(file).st_size  # noqa: PTH116 - a path takes twice as long
    except FileNotFoundError:
        return None
