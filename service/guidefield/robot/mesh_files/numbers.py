"""Numbers of text files as arrays, checked."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.robot.mesh_files.fault import MeshFault

Triangles = tuple[np.ndarray, np.ndarray]
"""Vertices (v, 3) [m, the file's frame] and the triangles (t, 3) between them, as the file has them."""


class Objects(NamedTuple):
    """The triangles of a mesh file, and the objects that they belong to.

    Attributes:
        vertices: Shape (v, 3) [m, the file's frame].
        triangles: Shape (t, 3), those of an object one after the other.
        firsts: Name and first triangle of each object, in their order; none where the file divides nothing.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    firsts: tuple[tuple[str, int], ...] = ()


def floats(text: bytes, what: str) -> np.ndarray:
    """Return the numbers of a text that blanks separate, shape (n,).

    Args:
        text: Nothing but numbers.
        what: Their name in an error.

    Raises:
        MeshFault: if a word isn't a number.
    """
    words = text.split()
    try:
        values = np.fromstring(text, np.float64, sep=" ") if words else np.empty(0)
        return values if len(values) == len(words) else np.array(words, np.float64)
    except (ValueError, DeprecationWarning):
        wrong = next(word for word in words if not _is_number(word))
        raise MeshFault(
            f"has {wrong[:40].decode(errors='replace')!r} among its {what}, which is not a number"
        ) from None


def integers(text: bytes, what: str) -> np.ndarray:
    """Return the whole numbers of a text, shape (n,); arguments and errors are those of `floats`."""
    values = floats(text, what)
    if not (np.isfinite(values).all() and (values == np.floor(values)).all() and (np.abs(values) < 2.0**53).all()):
        raise MeshFault(f"has a number among its {what} that is not whole")
    return values.astype(np.int64)


def check_indices(indices: np.ndarray, count: int) -> None:
    """Check that indices, shape (n,), are those of vertices.

    Raises:
        MeshFault: if one is below 0 or not below the count.
    """
    if len(indices) and not (indices.min() >= 0 and indices.max() < count):
        wrong = int(indices.min()) if indices.min() < 0 else int(indices.max())
        raise MeshFault(f"has a face with the vertex {wrong} (counted from 0), but only {count} vertices")


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
