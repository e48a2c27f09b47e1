"""The folder of one run: the files in it, and what they say at a glance."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

from guidefield.messages.replies import RunSummary
from guidefield.messages.store_requests import RUNNING, UNREADABLE
from guidefield.stores.files import decoded, read_if_any

REQUEST, REPLY, ERROR, RECORDING = "request.json", "reply.json", "error.json", "recording.rrd"
OWED, LOST = "recording.owed", "recording.lost"
"""Who is to write a recording that isn't there yet: a process, as `system.told_apart` knows it; why it won't be."""


class _SceneHead(msgspec.Struct):
    name: str = ""
    base: str = ""


class _RequestHead(msgspec.Struct):
    """Just enough of a request for a list."""

    robot: str | dict[str, msgspec.Raw]
    scene: str | _SceneHead


class _Status(msgspec.Struct):
    name: str


class _ReplyHead(msgspec.Struct):
    """Just enough of a reply for a list."""

    status: _Status


_UNREADABLE_HEAD = _RequestHead(robot=UNREADABLE, scene=UNREADABLE)


def state(folder: Path) -> tuple[tuple[int, int, int] | None, ...]:
    """What tells whether a summary still holds: number, size and last change of each file that it is made of."""
    return tuple(_file_state(f"{folder}/{name}") for name in (REQUEST, REPLY, ERROR))


def _file_state(file: str) -> tuple[int, int, int] | None:
    try:
        found = os.stat(file)  # noqa: PTH116 - a Path for each file takes longer than to look at it
    except FileNotFoundError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


def summary(folder: Path) -> RunSummary | None:
    """One line about a run; None if it was dropped meanwhile."""
    try:
        head = decoded((folder / REQUEST).read_bytes(), _RequestHead) or _UNREADABLE_HEAD
        began = (folder / REQUEST).stat().st_mtime
    except FileNotFoundError:  # dropped meanwhile, by another process
        return None
    return RunSummary(
        run_id=folder.name,
        status=_status(folder),
        robot=head.robot if isinstance(head.robot, str) else "urdf",
        scene=head.scene if isinstance(head.scene, str) else head.scene.name or head.scene.base,
        began=began,
    )


def _status(folder: Path) -> str:
    reply, error = read_if_any(folder / REPLY), read_if_any(folder / ERROR)
    if reply is not None:
        head = decoded(reply, _ReplyHead)
        return UNREADABLE if head is None else head.status.name
    if error is None:
        return RUNNING
    ending = decoded(error, _Status)
    return UNREADABLE if ending is None else ending.name


def has_ended(folder: Path) -> bool:
    """Whether the run has a reply, or an error in its place."""
    return (folder / REPLY).exists() or (folder / ERROR).exists()
