"""The command line: arguments in, exit code out."""

from guidefield.cli.commands import app, main

__all__ = ["app", "main"]
