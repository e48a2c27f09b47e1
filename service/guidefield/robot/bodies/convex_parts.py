"""Convex parts of the links that are judged as meshes: what keeps apart from them keeps apart from the mesh."""

from __future__ import annotations

import logging
import weakref
from collections.abc import Callable
from typing import Any

import coal
import numpy as np

from guidefield.geometry.cache import recalled, remembered
from guidefield.geometry.decomposition import Decomposition, Part, decompose
from guidefield.geometry.entries import Arrays
from guidefield.geometry.nested import filled
from guidefield.geometry.solid import solid
from guidefield.geometry.surfaces import Surface
from guidefield.robot.bodies.sphere_cover import Progress
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.shapes import WIDEST_GAP, triangulation

_log = logging.getLogger(__name__)

TIGHT = 0.005
"""A part that stands off its mesh by no more isn't halved [m]."""

MOST = 8
"""Most parts of a mesh."""

_known: weakref.WeakKeyDictionary[RobotModel, tuple[Decomposition | None, ...]] = weakref.WeakKeyDictionary()


def logged(done: int, of: int, link: str) -> None:
    """Say in the log how far it is."""
    _log.info("cutting link %s into convex parts: %d of %d shapes done", link, done, of)


def convex_parts(robot: RobotModel, progress: Progress = logged) -> tuple[Decomposition | None, ...]:
    """For each collision shape, in the geometry's order, its hull and convex parts that together contain it.

    They take some seconds for each mesh, are found once, and kept on disk. None for a primitive or hull, which is
    convex itself, and for a mesh that is flat. The parts' triangles are those of the mesh, by their place in its list.

    Args:
        robot: The robot.
        progress: Told before each mesh that isn't known yet; what it raises comes through.
    """
    if robot not in _known:
        shapes = list(robot.geometry.geometryObjects)
        found: list[Decomposition | None] = []
        for index, shape in enumerate(shapes):
            if not isinstance(shape.geometry, coal.BVHModelBase):
                found.append(None)
                continue
            question = _question(shape.geometry)
            arrays = recalled(*question)
            if arrays is None:
                progress(index, len(shapes), str(robot.model.frames[shape.parentFrame].name))
                arrays = remembered(*question)
            found.append(_restored(arrays))
        _known[robot] = tuple(found)
    return _known[robot]


def known_parts(robot: RobotModel) -> tuple[Decomposition | None, ...]:
    """What `convex_parts` gives, where it is known without computing anything; None elsewhere, or without parts."""
    if robot in _known:
        return _known[robot]
    kept = (
        recalled(*_question(shape.geometry)) if isinstance(shape.geometry, coal.BVHModelBase) else None
        for shape in robot.geometry.geometryObjects
    )
    return tuple(None if arrays is None else _restored(arrays) for arrays in kept)


def _question(mesh: Any) -> tuple[str, Arrays, Callable[[], Arrays]]:
    """What the parts of a mesh are kept under: a name, what they depend on, and how they are found."""
    vertices, triangles = triangulation(mesh)
    inputs = {
        "vertices": vertices,
        "triangles": triangles,
        "limits": np.array([WIDEST_GAP, TIGHT]),
        "most": np.array(MOST),
    }
    return "parts", inputs, lambda: _stored(_found(vertices, triangles))


def _found(vertices: np.ndarray, triangles: np.ndarray) -> tuple[Part, ...]:
    """The hull and the parts; nothing of what is flat."""
    try:
        found = decompose(filled(solid(vertices, triangles, WIDEST_GAP)), TIGHT, MOST)
    except ValueError:
        return ()
    return (found.hull, *found.parts)


_FIELDS = ("vertices", "faces", "triangles")


def _stored(parts: tuple[Part, ...]) -> Arrays:
    """The parts' arrays one after the other, and how many rows of each are whose."""
    rows = [(part.hull.vertices, part.hull.triangles, part.triangles) for part in parts]
    empty = (np.empty((0, 3)), np.empty((0, 3), np.int64), np.empty(0, np.int64))
    columns = zip(empty, *rows, strict=True)
    return {
        **{name: np.concatenate(column) for name, column in zip(_FIELDS, columns, strict=True)},
        "counts": np.array([[len(array) for array in row] for row in rows], np.int64).reshape(-1, 3),
        "stand_offs": np.array([part.stand_off for part in parts]),
    }


def _restored(arrays: Arrays) -> Decomposition | None:
    if not len(arrays["counts"]):
        return None
    first = np.cumsum(arrays["counts"], axis=0)[:-1]
    columns = [np.split(arrays[name], first[:, k]) for k, name in enumerate(_FIELDS)]
    hull, *parts = (
        Part(Surface(vertices, faces), float(distance), triangles)
        for distance, vertices, faces, triangles in zip(arrays["stand_offs"], *columns, strict=True)
    )
    return Decomposition(tuple(parts), hull)
