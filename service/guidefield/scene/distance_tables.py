"""The obstacles of a scene as the distance kernels read them."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.box_tree import box_tree
from guidefield.geometry.charged import field_tables
from guidefield.geometry.closed import connected_pieces, volume
from guidefield.geometry.distance_bodies import Body, balls_about, body_tables, boxes_in_world, primitive, triangulated
from guidefield.kept import kept_with
from guidefield.kernels.distance.distance import HALF_SPACE, SHEET, SOLID, DistanceTables
from guidefield.kernels.field.field import field_at_points
from guidefield.scene.cloud_tables import cloud_tables
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene


@kept_with
def distance_tables(scene: Scene) -> DistanceTables:
    """Tables of all obstacles of a scene; computed once for each scene.

    A closed mesh is a solid for each of its connected pieces, together with the hollows within it, so that pieces that
    overlap are told apart from hollows.
    """
    bodies = [(index, body) for index, obstacle in enumerate(scene.obstacles) for body in _bodies(obstacle)]
    endless = [pair for pair in bodies if pair[1].kind == HALF_SPACE]
    bounded = [pair for pair in bodies if pair[1].kind != HALF_SPACE]
    nodes = np.empty((0, 6))
    if bounded:
        boxes = boxes_in_world([body for _, body in bounded])
        tree = box_tree(boxes[:, :3], boxes[:, 3:])
        nodes, bounded = tree.nodes, [bounded[k] for k in tree.order]
    ordered = endless + bounded
    return body_tables([body for _, body in ordered], [index for index, _ in ordered], nodes)


def _bodies(obstacle: Obstacle) -> list[Body]:
    rotation, translation = obstacle.placement.rotation, obstacle.placement.translation
    body = primitive(obstacle.shape) if obstacle.facets is None else None
    if body is not None:
        return [body.placed(rotation, translation)]
    if obstacle.cloud is not None:
        return [balls_about(obstacle.cloud.points, obstacle.cloud.radius, cloud_tables(obstacle).address)]
    vertices = (obstacle.vertices - translation) @ rotation
    if not obstacle.solid:
        return [triangulated(vertices, obstacle.triangles, SHEET).placed(rotation, translation)]
    solids = _solids(vertices, obstacle.triangles)
    return [triangulated(vertices, solid, SOLID).placed(rotation, translation) for solid in solids]


def _solids(vertices: np.ndarray, triangles: np.ndarray) -> list[np.ndarray]:
    """Triangles of each solid: a connected piece that encloses a volume, with the hollows that lie within it."""
    labels = connected_pieces(len(vertices), triangles)[triangles[:, 0]]
    parts = [triangles[labels == label] for label in np.unique(labels)]
    solids = sorted((part for part in parts if volume(vertices, part) > 0.0), key=lambda part: volume(vertices, part))
    hollows = [part for part in parts if volume(vertices, part) <= 0.0]
    within: list[list[np.ndarray]] = [[solid] for solid in solids]
    for hollow in hollows:
        inside = vertices[hollow[0]].mean(axis=0)[None]
        around = (k for k, solid in enumerate(solids) if _winding(vertices[solid], inside) > 0.5)
        # a hollow in nothing is the surface of everything else: it belongs to the largest
        within[next(around, len(solids) - 1)].append(hollow)
    return [np.concatenate(group) for group in within]


def _winding(corners: np.ndarray, point: np.ndarray) -> float:
    return float(field_at_points(field_tables(triangles=corners), point).winding[0])
