"""A robot's meshes, read back from the file in which they are kept."""

from __future__ import annotations

from pathlib import Path

from rerun.chunk import Chunk, RrdReader

UNREADABLE = (OSError, ValueError, KeyError, RuntimeError)
"""What reading a file that isn't there or isn't whole raises."""


def read_meshes(file: Path) -> list[Chunk]:
    """The meshes in a robot's file, as a recording takes them in.

    Raises:
        OSError, ValueError, RuntimeError: if there is no such file, or it isn't whole.
    """
    return [chunk for chunk in read_chunks(file) if chunk.entity_path.startswith("/robot/")]


def read_chunks(file: Path) -> list[Chunk]:
    """All that a robot's file holds; raises as `read_meshes`."""
    if not file.exists():
        raise FileNotFoundError(f"there is no {file}")
    return list(RrdReader(file).stream().to_chunks())
