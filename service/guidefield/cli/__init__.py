"""The command line: `commands.py` declares the commands, each of which ends with an exit code."""

from guidefield.cli.commands import app, main

__all__ = ["app", "main"]
