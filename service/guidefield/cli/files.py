"""Check before the work begins that the files of a command can be written."""

from __future__ import annotations

import os
from pathlib import Path

import typer


def require_writable(file: Path | None) -> Path | None:
    """Callback of an option or argument that names an output file: return the file if it can be written.

    Raises:
        typer.BadParameter: otherwise.
    """
    if file is None:
        return None
    if file.is_dir():
        raise typer.BadParameter(f"{str(file)!r} is a folder")
    if not file.parent.is_dir():
        raise typer.BadParameter(f"there is no folder {str(file.parent)!r}")
    if not os.access(file if file.exists() else file.parent, os.W_OK):
        raise typer.BadParameter(f"{str(file)!r} can't be written")
    return file
