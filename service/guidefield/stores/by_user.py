"""The stores of all users: each has runs, scenes and robots of its own, in a folder of its own.

Names of folders are the format of data folders: existing ones must be found again. Other files write some out, too.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from guidefield.errors import NotAllowed, QuotaExceeded
from guidefield.memory import OPEN_STORES, BoundedMap
from guidefield.messages.identities import DEFAULT_QUOTAS, PLAIN, Quotas
from guidefield.stores.files import checked_name, user_folder, users_in
from guidefield.stores.recordings import Recordings
from guidefield.stores.robots import RobotStore
from guidefield.stores.runs import NoRuns, RunDatabase, Runs
from guidefield.stores.scenes import SceneStore
from guidefield.whole_file import write_whole

MOST_USERS = 1_000  # number of users who may have something stored, beside `PLAIN`
Kind = Literal["runs", "scenes", "robots", "requests"]
"""Kinds of things that belong to a user; requests can't be shared."""


class Shared:
    """Marks of a user's shared things, empty files `<kind>/<name>` in a folder; shared runs are in the database."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def has(self, kind: Kind, name: str) -> bool:
        """Return whether something is shared."""
        return self._mark(kind, name).exists()

    def add(self, kind: Kind, name: str) -> None:
        """Share something."""
        mark = self._mark(kind, name)
        mark.parent.mkdir(parents=True, exist_ok=True)
        write_whole(mark, b"")

    def remove(self, kind: Kind, name: str) -> None:
        """Share it no more, if it was."""
        self._mark(kind, name).unlink(missing_ok=True)

    def _mark(self, kind: Kind, name: str) -> Path:
        return self._folder / kind / checked_name(name, kind.removesuffix("s"))


@dataclass(frozen=True)
class Stores:
    """The stores of one user."""

    runs: Runs
    recordings: Recordings
    scenes: SceneStore
    robots: RobotStore
    shared: Shared


class StoresByUser:
    """The stores of all users in a data folder: those of `PLAIN` in it, all others' below ``users``.

    Several processes may share the folder, and any thread may ask.

    Attributes:
        reading: Whether stores are only read, so that no folder is made.
    """

    def __init__(
        self, data: Path, quotas: Quotas = DEFAULT_QUOTAS, database: RunDatabase | None = None, *, reading: bool = False
    ) -> None:
        self._data, self._quotas, self._database, self.reading = data, quotas, database, reading
        self._open = BoundedMap[str, Stores](OPEN_STORES)
        self._lock = threading.Lock()

    def of(self, user: str) -> Stores:
        """Return the stores of a user, made if they aren't there; QuotaExceeded if too many users have some already."""
        return self._open.find(user, lambda: self._open_stores(user), lambda _: 0)

    def streams_of(self, user: str) -> Path:
        """Return the folder of a user's streams; it may not be there."""
        return self._folder(user) / "streams"

    def byte_quota_of(self, user: str) -> int | None:
        """Return a user's quota of storage [bytes]; None: no quota."""
        return self._quotas.of(user).bytes

    def users(self) -> list[str]:
        """Return the users with stores, in alphabetical order, without `PLAIN`."""
        return users_in(self._data)

    def may_read(self, asking: str, owner: str, kind: Kind, name: str) -> bool:
        """Return whether a user may read another's thing: if it is shared; `PLAIN`, an operator, always may."""
        if asking in (owner, PLAIN):
            return True
        if kind == "runs":
            return self._database is not None and self._database.of(owner).is_shared(name)
        return Shared(self._folder(owner) / "shared").has(kind, name)

    def require_right(self, asking: str, owner: str, kind: Kind, name: str, *, read_only: bool) -> None:
        """Raise NotAllowed, whether the thing exists or not, unless a user may read it, or change it if not read-only.

        Only its owner and `PLAIN` may change it.
        """
        right = self.may_read(asking, owner, kind, name) if read_only else asking in (owner, PLAIN)
        if not right:
            what = "doesn't share it" if read_only else "alone may change it"
            message = f"{kind.removesuffix('s')} {name[:64]!r} belongs to user {owner!r}, who {what}"
            raise NotAllowed(message, user=owner, kind=kind, name=name[:64])

    def require_room(self, user: str, size: int) -> None:
        """Raise QuotaExceeded if a user's quota has no room for a robot or scene of a size [bytes]."""
        most = self.byte_quota_of(user)
        if most is None:
            return
        folders = (self._folder(user) / kind for kind in ("scenes", "robots"))
        taken = sum(file.stat().st_size for folder in folders for file in folder.rglob("*") if file.is_file())
        if taken + size > most:
            raise QuotaExceeded(
                f"this user's scenes and robots take {taken} bytes and may take {most}; delete some",
                bytes=most,
                taken=taken,
            )

    def _open_stores(self, user: str) -> Stores:
        folder = self._folder(user)
        with self._lock:  # one thread at a time counts users, and adds one
            if not (self.reading or folder.is_dir()):
                if user != PLAIN and len(self.users()) >= MOST_USERS:
                    raise QuotaExceeded(f"{MOST_USERS} users have something stored already", limit=MOST_USERS)
                folder.mkdir(parents=True, exist_ok=True)
            return Stores(
                NoRuns() if self._database is None else self._database.of(user),
                Recordings(folder / "recordings"),
                SceneStore(folder / "scenes"),
                RobotStore(folder / "robots"),
                Shared(folder / "shared"),
            )

    def _folder(self, user: str) -> Path:
        return user_folder(self._data, user)
