"""The error for a mesh file that can't be read."""

from __future__ import annotations


class MeshFault(ValueError):
    """A mesh file can't be read; its message continues a sentence that begins with the file's name."""
