"""Robots that clients stored: texts and meshes on disk, by a hash of all that was sent; names lead to hashes.

What was sent is written once, to a folder named by the hash, and never changed; a name is a small file that holds a
hash. So a robot can be tried before its name is given out, and no reader mixes two robots of one name. A folder that no
name leads to any more is deleted.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import uuid
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import msgspec

from guidefield.errors import RequestTooLarge, RobotInvalid
from guidefield.messages import codec
from guidefield.messages.requests import RobotFiles
from guidefield.messages.values import RootJoint
from guidefield.robot import library
from guidefield.robot.library import SentRobot
from guidefield.robot.mesh_files.sent_meshes import name_by_content
from guidefield.stores.files import checked_name, decode_if_whole, lock_file, read_if_any
from guidefield.whole_file import DRAFT, flush_folder, write_whole

MAX_ROBOTS = 200  # of a user
MAX_BYTES = 4 * 2**30  # largest size of a user's robots together [bytes]
# both are in docs/wire.md by endpoint/rules.py: after a change, `tools/wire_page`

_DESCRIPTION = "robot.json"  # file of a `_Description`
_CONTENT = re.compile(r"[0-9a-f]{64}")  # the hash in a name's file


class NoRobots:
    """The catalog's robots alone, without a data folder."""

    def names(self) -> list[str]:
        """Return no names."""
        return []

    def find(self, _name: str) -> SentRobot | None:
        """Return None."""
        return None

    def write(self, name: str, _files: RobotFiles, _load: Callable[[SentRobot], object]) -> None:
        """Raise RobotInvalid: nothing can be stored here."""
        raise RobotInvalid(
            f"robot {name[:64]!r} cannot be stored: robots are kept only where there is a data folder; "
            "send its text inside the request, or name its file",
            robot=name[:64],
        )

    def delete(self, name: str) -> None:
        """Raise RobotInvalid: nothing is stored here."""
        raise _unknown(name, [])


class _Description(msgspec.Struct, frozen=True):
    """A robot as its folder holds it, beside mesh files."""

    urdf: str
    srdf: str | None
    root_joint: RootJoint
    meshes: dict[str, str]  # files in the folder, by the names in the URDF


class RobotStore:
    """Clients' robots in a folder, made with the first one.

    Several processes may share it. Where the disk refuses, OSError comes through.
    """

    def __init__(self, folder: Path, limit: int = MAX_ROBOTS, limit_bytes: int = MAX_BYTES) -> None:
        self._names, self._contents = folder / "names", folder / "contents"
        self._limit, self._limit_bytes = limit, limit_bytes

    def names(self) -> list[str]:
        """Return the names of robots that clients stored, in alphabetical order."""
        try:
            return sorted(path.name for path in self._names.iterdir() if not path.name.startswith("."))
        except FileNotFoundError:
            return []

    def find(self, name: str) -> SentRobot | None:
        """Return a stored robot, or None.

        Raises MalformedRequest if the name can't be a file's; raises RobotInvalid if a file of it is damaged.
        """
        if name in library.entries():  # what comes with the package isn't stored
            return None
        content = read_if_any(self._path(name))
        return None if content is None else self._read(name, content.decode(errors="replace"))

    def write(self, name: str, files: RobotFiles, load: Callable[[SentRobot], object]) -> None:
        """Keep a robot under a name, in place of an earlier one, if `load` can load it; what that raises comes through.

        Raises MalformedRequest if the name can't be a file's; RobotInvalid if it is the catalog's, which means the same
        everywhere, or a mesh can't be taken; RequestTooLarge if there are too many or too large robots already.
        """
        path = self._path(name)
        if name in library.entries():
            raise RobotInvalid(
                f"robot {name!r} comes with the package and cannot be replaced; choose another name", robot=name
            )
        named = name_by_content(files.meshes)
        described = _Description(files.urdf, files.srdf, files.root_joint, dict(named.names))
        content = hashlib.sha256(msgspec.json.encode(described, order="sorted")).hexdigest()
        with self._lock():
            if not path.exists() and len(self.names()) >= self._limit:
                raise RequestTooLarge(f"{self._limit} robots are stored already; delete one first", limit=self._limit)
            self._write(content, {**named.files, _DESCRIPTION: codec.encode(described)})
            try:
                load(self._read(name, content))
                write_whole(path, content.encode())
            finally:
                self._sweep()

    def delete(self, name: str) -> None:
        """Forget a stored robot; raises RobotInvalid if none of that name was stored."""
        with self._lock():
            try:
                self._path(name).unlink()
            except FileNotFoundError:
                raise _unknown(name, self.names()) from None
            self._sweep()

    def _read(self, name: str, content: str) -> SentRobot:
        folder = self._contents / content
        stored = read_if_any(folder / _DESCRIPTION) if _CONTENT.fullmatch(content) else None
        described = None if stored is None else decode_if_whole(stored, _Description)
        if described is None:
            raise RobotInvalid(f"robot {name!r} can't be read: a file of it is damaged; store it again", robot=name)
        meshes = {uri: folder / file for uri, file in described.meshes.items()}
        return SentRobot(name, content, described.urdf, described.srdf, meshes, described.root_joint)

    def _write(self, content: str, files: dict[str, bytes]) -> None:
        """Write files to the folder of their hash, all of them or none; a damaged file there is written again."""
        folder = self._contents / content
        if folder.exists():
            for file, data in files.items():
                if read_if_any(folder / file) != data:
                    write_whole(folder / file, data)
            return
        taken = sum(path.stat().st_size for path in self._contents.rglob("*") if path.is_file())
        if taken + sum(map(len, files.values())) > self._limit_bytes:
            raise RequestTooLarge(
                f"stored robots would take more than {self._limit_bytes} bytes; delete one first",
                limit=self._limit_bytes,
            )
        draft = self._contents / f".{uuid.uuid4().hex}{DRAFT}"
        draft.mkdir()
        try:
            for file, data in files.items():
                write_whole(draft / file, data)
            draft.rename(folder)
        except OSError:
            shutil.rmtree(draft, ignore_errors=True)
            raise
        flush_folder(self._contents)

    def _sweep(self) -> None:
        used = {(self._names / name).read_text(errors="replace") for name in self.names()}
        for folder in self._contents.iterdir():
            if folder.name not in used:
                shutil.rmtree(folder, ignore_errors=True)

    def _lock(self) -> AbstractContextManager[None]:
        for made in (self._names, self._contents):
            made.mkdir(parents=True, exist_ok=True)
        return lock_file(self._contents.parent / ".lock")

    def _path(self, name: str) -> Path:
        return self._names / checked_name(name, "robot")


Robots = NoRobots | RobotStore  # an engine's store of clients' robots


def _unknown(name: str, names: list[str]) -> RobotInvalid:
    return RobotInvalid(
        f"no robot {name[:64]!r} is stored; stored are {', '.join(names) or 'none'}", robot=name[:64], available=names
    )
