"""The collision shapes of a robot as bodies that distances are taken to."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.distance_bodies import Body, body_rows, body_tables, primitive, triangulated
from guidefield.geometry.edges import edge_counts
from guidefield.kernels.distance.distance import SHEET, SOLID, DistanceTables
from guidefield.memo import memoized
from guidefield.robot.bodies.charges import surface
from guidefield.robot.model.model import RobotModel


@memoized
def link_bodies(robot: RobotModel) -> DistanceTables:
    """A body for every collision shape, in the geometry's order, each in the shape's own frame; without a tree.

    A mesh is solid if its triangles close around a volume, else a sheet. Computed once for each robot.
    """
    bodies = [_body(shape.geometry) for shape in robot.geometry.geometryObjects]
    return body_tables(body_rows(bodies), range(len(bodies)), np.empty((0, 6)))


def _body(shape: object) -> Body:
    body = primitive(shape)
    if body is not None:
        return body
    vertices, triangles = surface(shape)
    return triangulated(vertices, triangles, SOLID if _closes(vertices, triangles) else SHEET)


def _closes(vertices: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether every edge is run through once in each direction, around a positive volume."""
    up, down = edge_counts(triangles)
    if not ((up == 1) & (down == 1)).all():
        return False
    a, b, c = np.moveaxis(vertices[triangles] - vertices.mean(axis=0), 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) > 0.0
