"""Paths of the stores' files with their checked names, a lock between processes, and reading of files that may lack.

Folders and valid names are the format of data folders: what is there must be found again.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

import msgspec

from guidefield.errors import MalformedRequest
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN

_M = TypeVar("_M", bound=msgspec.Struct)
_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,127}")


def default_data_folder(instance: str) -> Path:
    """Return the default folder of a service's data, below `XDG_DATA_HOME` or `~/.local/share`."""
    base = os.environ.get("XDG_DATA_HOME") or str(Path.home() / ".local" / "share")
    return Path(base) / "guidefield" / checked_name(instance, "instance")


def checked_name(name: str, what: str) -> str:
    """Return the name itself, if it can name a file and cannot lead out of its folder.

    Raises:
        MalformedRequest: otherwise; `what` says whose name it is.
    """
    if not _NAME.fullmatch(name):
        raise MalformedRequest(
            f"{what} {name[:64]!r} must be 1 to 128 of the characters A-Z a-z 0-9 _ . - and must not begin with a dot",
            **{what: name[:64]},
        )
    return name


@contextlib.contextmanager
def lock_file(lock: Path) -> Iterator[None]:
    """Let one process at a time into blocks that name the same file, which is made if it isn't there."""
    file = os.open(lock, os.O_CREAT | os.O_WRONLY, 0o666)
    try:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
    finally:
        os.close(file)


def read_if_any(path: Path) -> bytes | None:
    """Return the content of a file, or None if there is none."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None


def decode_if_whole(data: bytes, kind: type[_M], encoding: Encoding = Encoding.JSON) -> _M | None:
    """Decode a message from a file; None if it can't be: its end is missing, or another version wrote it."""
    try:
        if encoding is Encoding.MSGPACK:
            return msgspec.msgpack.decode(data, type=kind)
        return msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


def user_folder(data: Path, user: str) -> Path:
    """Return the folder of a user in a data folder: for `PLAIN` the data folder itself."""
    return data if user == PLAIN else data / "users" / user


def users_in(data: Path) -> list[str]:
    """Return the users with a folder in a data folder, in alphabetical order, without `PLAIN`."""
    users = data / "users"
    return sorted(folder.name for folder in users.iterdir()) if users.is_dir() else []
