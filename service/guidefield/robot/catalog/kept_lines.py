"""The lines about the robots that come with the package, kept on disk: finding them takes a process seconds."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
from collections.abc import Iterable
from pathlib import Path

import msgspec
import pinocchio as pin

from guidefield.geometry.cache import folder
from guidefield.messages.replies import RobotSummary
from guidefield.robot.catalog.library import Entry
from guidefield.robot.catalog.summary import summarize
from guidefield.whole_file import write_whole

_log = logging.getLogger(__name__)
_SOURCES = Path(__file__).parent.parent


def lines_of(entries: Iterable[Entry]) -> list[RobotSummary]:
    """A line about each robot, in their order; from disk if they were found before, from the same files."""
    known = list(entries)
    path = folder() / f"robots-{_key(known)}"
    with contextlib.suppress(OSError, msgspec.MsgspecError):
        return msgspec.json.decode(path.read_bytes(), type=list[RobotSummary])
    lines = [summarize(entry) for entry in known]
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(path, msgspec.json.encode(lines), durable=False)
    except OSError as error:
        _log.warning("cannot keep %s: %s", path, error)
    return lines


def _key(entries: Iterable[Entry]) -> str:
    """Changes with each robot's files and card, and with what reads them."""
    digest = hashlib.sha256(f"{_sources()} {pin.__version__}".encode())
    for entry in entries:
        digest.update(f"\0{entry}".encode())
        for name in (entry.card.urdf, entry.card.srdf):
            if name is not None:
                status = (entry.folder / name).stat()
                digest.update(f"\0{status.st_mtime_ns} {status.st_size}".encode())
    return digest.hexdigest()


@functools.cache
def _sources() -> str:
    """Changes with every file of the robot room."""
    digest = hashlib.sha256()
    for source in sorted(_SOURCES.rglob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()
