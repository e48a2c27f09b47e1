from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.solid import solid
from guidefield.kernels.cover.inscribed import tangent_balls
from tests.geometry import solids

BODIES = {"box": solids.box((0.1, 0.2, 0.3)), "ring": solids.torus(), "channel": solids.channel()}


@pytest.mark.parametrize("mesh", BODIES.values(), ids=BODIES)
def test_tangent_balls_touch_from_inside_and_cross_nowhere(mesh: solids.Mesh) -> None:
    body = solid(*mesh)
    corners = body.surface.corners
    points = np.ascontiguousarray(corners.mean(axis=1))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = -normals / np.linalg.norm(normals, axis=1, keepdims=True)
    centres = np.empty_like(points)
    tangent_balls(points, inward, body.owners, body.tables, body.spans, 1.0, 0.0, centres)
    radii = np.linalg.norm(centres - points, axis=1)
    depths = solids.distance(centres, mesh)
    assert (solids.winding(centres, mesh) > 0.5).all()
    assert (depths >= radii * (1.0 - 6e-3)).all()
    assert (depths <= radii * (1.0 + 1e-9)).all()
    # along the same normals there is no larger one: a little farther in, another point of the surface is nearer
    farther = centres + 0.02 * radii[:, None] * inward
    assert (solids.distance(farther, mesh) < 1.02 * radii * (1.0 - 1e-4)).all()


def test_the_largest_ball_in_a_box_is_half_as_wide() -> None:
    body = solid(*solids.box((0.1, 0.2, 0.3)))
    point, inward, centre = np.array([[-0.05, 0.01, 0.02]]), np.array([[1.0, 0.0, 0.0]]), np.empty((1, 3))
    tangent_balls(point, inward, np.zeros(1, np.int64), body.tables, body.spans, 5.0, 0.0, centre)
    assert centre[0] == pytest.approx([0.0, 0.01, 0.02], abs=1e-4)


def test_slack_lets_a_ball_grow_past_the_facets_of_a_round_body() -> None:
    mesh = solids.torus()
    body = solid(*mesh)
    corners = body.surface.corners
    points = np.ascontiguousarray(corners.mean(axis=1))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward, slack = -normals / np.linalg.norm(normals, axis=1, keepdims=True), 0.002
    strict, loose = np.empty_like(points), np.empty_like(points)
    for centres, allowed in ((strict, 0.0), (loose, slack)):
        tangent_balls(points, inward, body.owners, body.tables, body.spans, 1.0, allowed, centres)
    assert (solids.winding(loose, mesh) > 0.5).all()
    depths, reach = solids.distance(loose, mesh), np.linalg.norm(loose - points, axis=1)
    assert (depths >= (reach - slack) * (1.0 - 6e-3)).all()
    assert np.median(depths) > 1.2 * np.median(solids.distance(strict, mesh))


@pytest.mark.parametrize("far", [0.0, 1e3, 1e8])
@pytest.mark.parametrize("mesh", [*BODIES.values(), solids.overlapping(), solids.hollow()])
def test_what_is_known_of_a_point_changes_nothing_for_the_next(mesh: solids.Mesh, far: float) -> None:
    vertices, triangles = mesh
    body, rng = solid(far + vertices, triangles), np.random.default_rng(3)
    low, high = body.surface.vertices.min(axis=0), body.surface.vertices.max(axis=0)
    walk = rng.uniform(low, high) + np.cumsum(rng.normal(scale=0.02, size=(300, 3)), axis=0)
    points = np.vstack([walk, rng.uniform(low - 0.05, high + 0.05, (300, 3)), np.repeat(walk[:1], 3, axis=0)])
    for asked in (body.depths, body.distances):
        assert (asked(points) == np.concatenate([asked(point[None]) for point in points])).all()
