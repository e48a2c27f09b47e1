"""Recordings of one user's runs: a file for each in a folder, and marks for those that come after the reply."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

from guidefield.errors import UnknownObject
from guidefield.stores.files import checked_name, read_if_any
from guidefield.system import is_alive, told_apart
from guidefield.whole_file import write_whole

RECORDING, OWED, LOST = ".rrd", ".owed", ".lost"
"""Endings of file names: a recording, the mark of the process that writes it, the reason why none was written."""
SCENE_LINK = ".drawn"
"""Ending of a recording's link to the file of its scene, where that is large."""
LONGEST_WRITING_S = 60.0
"""Longest wait for a recording that is being written [s]."""
POLL_INTERVAL_S = 0.01


class Recordings:
    """Recordings as files `<id>.rrd`. Several processes may share the folder.

    Args:
        folder: Its folder; whoever writes makes it.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def bodies_folder(self) -> Path:
        """Folder of the robots' meshes, which all recordings share."""
        return self.folder.with_name("runs-robots")

    def path(self, run_id: str) -> Path:
        """The path of a run's recording, whether it exists or not.

        Raises:
            MalformedRequest: if the name can't be a file's.
        """
        return self._file(run_id, RECORDING)

    def find(self, run_id: str) -> Path:
        """The file of a run's recording; waits while it is being written.

        Raises:
            UnknownObject: if there is none, or it was lost.
        """
        recording, owed_mark, until = self.path(run_id), self._file(run_id, OWED), time.monotonic() + LONGEST_WRITING_S
        while (owed := read_if_any(owed_mark)) is not None and time.monotonic() < until:
            if not is_alive(owed.decode()):
                if owed_mark.exists():
                    raise UnknownObject(
                        f"the recording of run {run_id!r} is lost: the process that wrote it ended; `guidefield replay"
                        f" {run_id}` plans it again",
                        run_id=run_id,
                    )
                break  # it was done just before it ended
            time.sleep(POLL_INTERVAL_S)
        if recording.exists():
            return recording
        lost = read_if_any(self._file(run_id, LOST))
        why = "" if lost is None else f": {lost.decode()}"
        raise UnknownObject(f"run {run_id!r} has no recording{why}", run_id=run_id)

    def is_owed(self, run_id: str) -> bool:
        """Return whether a process announced a run's recording that isn't finished."""
        return self._file(run_id, OWED).exists()

    def size(self, run_id: str) -> int | None:
        """The size of a run's recording [bytes]: 0 if there is none, None while a living process still writes it."""
        owed = read_if_any(self._file(run_id, OWED))
        if owed is not None and is_alive(owed.decode()):
            return None
        try:
            return self.path(run_id).stat().st_size
        except FileNotFoundError:
            return 0

    def owe(self, run_id: str) -> None:
        """Say that this process will write a run's recording after the reply.

        Raises:
            OSError: if the disk refuses.
        """
        write_whole(self._file(run_id, OWED), told_apart(os.getpid()).encode(), durable=False)

    def settle(self, run_id: str, fault: str | None) -> None:
        """Say that a recording that was owed is there, or why it won't be; one that was dropped meanwhile goes."""
        with contextlib.suppress(OSError):
            if not self._file(run_id, OWED).exists():
                self.drop(run_id)
                return
            if fault is not None:
                write_whole(self._file(run_id, LOST), fault.encode(), durable=False)
            self._file(run_id, OWED).unlink()

    def drop(self, run_id: str) -> None:
        """Delete a recording with its marks.

        Raises:
            OSError: if the disk refuses.
        """
        for ending in (OWED, LOST, RECORDING, SCENE_LINK):
            self._file(run_id, ending).unlink(missing_ok=True)

    def sweep(self) -> None:
        """Delete what killed processes left half-written; only for who holds the data folder alone."""
        for draft in self.folder.glob(".*"):
            draft.unlink(missing_ok=True)

    def _file(self, run_id: str, ending: str) -> Path:
        return self.folder / f"{checked_name(run_id, 'run_id')}{ending}"
