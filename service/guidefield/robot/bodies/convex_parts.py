"""Convex parts of the links that are judged as meshes: what keeps apart from them keeps apart from the mesh."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from guidefield.geometry.cache import Arrays
from guidefield.geometry.decomposition import ConvexPart, Decomposition, decompose
from guidefield.geometry.solid import fill_solid_of_mesh
from guidefield.geometry.surfaces import Surface
from guidefield.robot.bodies.by_shape import ByShape, Question, log_task
from guidefield.robot.model.collision_shapes import WIDEST_GAP, triangulation
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.size import scale

TIGHT = 0.005  # a part that stands off its mesh by no more isn't halved [m], at size 1
MOST = 4  # most parts of a mesh for a plan, which asks its triangles next. With 8, connections of a UR5 take as long


def convex_parts(robot: RobotModel, most: int = MOST) -> tuple[Decomposition | None, ...]:
    """Return for each shape, in the geometry's order, its hull and convex parts that together contain it; kept on disk.

    A mesh has at most `most` parts. None for a primitive or hull, which is convex itself, and for a mesh that is flat.
    """
    return PARTS.all(robot, most, log_task)


def recall_parts(robot: RobotModel) -> tuple[Decomposition | None, ...]:
    """What `convex_parts` gives, where it is known without computing anything; None elsewhere, or without parts."""
    return PARTS.recall(robot, MOST)


def _question(shape: Any, most: int, unit: float) -> Question | None:
    """What the parts of a mesh, in a unit [m], are kept under: a name, what they depend on, how they are found."""
    if not isinstance(shape, coal.BVHModelBase):
        return None
    vertices, triangles = triangulation(shape)
    vertices = vertices if unit == 1.0 else vertices / unit
    inputs = {
        "vertices": vertices,
        "triangles": triangles,
        "limits": np.array([WIDEST_GAP, TIGHT]),
        "most": np.array(most),
    }
    return "parts", inputs, lambda: _store(_find_parts(vertices, triangles, most))


def _find_parts(vertices: np.ndarray, triangles: np.ndarray, most: int) -> tuple[ConvexPart, ...]:
    try:
        found = decompose(fill_solid_of_mesh(vertices, triangles, WIDEST_GAP), TIGHT, most)
    except ValueError:
        return ()
    return (found.hull, *found.parts)


_FIELDS = ("vertices", "faces")


def _store(parts: tuple[ConvexPart, ...]) -> Arrays:
    rows = [(part.hull.vertices, part.hull.triangles) for part in parts]
    empty = (np.empty((0, 3)), np.empty((0, 3), np.int64))
    columns = zip(empty, *rows, strict=True)
    return {
        **{name: np.concatenate(column) for name, column in zip(_FIELDS, columns, strict=True)},
        "counts": np.array([[len(array) for array in row] for row in rows], np.int64).reshape(-1, 2),
        "stand_offs": np.array([part.stand_off for part in parts]),
    }


def _restore(arrays: Arrays, unit: float) -> Decomposition | None:
    if not len(arrays["counts"]):
        return None
    arrays = scale(arrays, unit, "vertices", "stand_offs")
    first = np.cumsum(arrays["counts"], axis=0)[:-1]
    columns = [np.split(arrays[name], first[:, k]) for k, name in enumerate(_FIELDS)]
    hull, *parts = (
        ConvexPart(Surface(vertices, faces), float(distance))
        for distance, vertices, faces in zip(arrays["stand_offs"], *columns, strict=True)
    )
    return Decomposition(tuple(parts), hull)


PARTS = ByShape("cutting", _question, _restore)  # by robot and by how many parts a mesh may have
