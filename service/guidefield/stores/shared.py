"""Marks of the robots and scenes that a user shares: others may read them."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from guidefield.stores.files import checked_name
from guidefield.whole_file import write_whole

Kind = Literal["runs", "scenes", "robots", "requests"]
"""What somebody may have; requests can't be shared."""


class Shared:
    """Marks in a folder: an empty file for each thing that is shared.

    Args:
        folder: Made when something is shared.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def has(self, kind: Kind, name: str) -> bool:
        """Whether something is shared."""
        return self._mark(kind, name).exists()

    def add(self, kind: Kind, name: str) -> None:
        """Share something."""
        mark = self._mark(kind, name)
        mark.parent.mkdir(parents=True, exist_ok=True)
        write_whole(mark, b"")

    def remove(self, kind: Kind, name: str) -> None:
        """Share it no more; nothing is done where it wasn't."""
        self._mark(kind, name).unlink(missing_ok=True)

    def _mark(self, kind: Kind, name: str) -> Path:
        return self._folder / kind / checked_name(name, kind.removesuffix("s"))
