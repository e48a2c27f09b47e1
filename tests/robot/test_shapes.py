"""As what meshes are judged: hulls where they are tight, by exact stand-off."""

from __future__ import annotations

import coal
import numpy as np
import pytest

from guidefield.robot.shapes import HULL_STAND_OFF, triangulation
from tests.geometry import solids
from tests.robots import ARMS, robot


@pytest.mark.parametrize("name", ARMS)
def test_choices_follow_the_stand_off(name: str) -> None:
    model = robot(name)
    for choice, one in zip(model.geometry_choices, model.geometry.geometryObjects, strict=True):
        if choice.judged_as == "convex hull":
            assert isinstance(one.geometry, coal.Convex)
            assert 0.0 <= choice.stand_off <= HULL_STAND_OFF
        elif choice.judged_as == "triangle mesh":
            assert isinstance(one.geometry, coal.BVHModelBase)
            assert choice.stand_off == 0.0
            assert _farthest_probe(one.geometry) > HULL_STAND_OFF


def test_a_hull_from_the_disk_collides_as_one_of_coal() -> None:
    body = next(one.geometry for one in robot("panda").geometry.geometryObjects if one.name == "panda_link5_0")
    vertices, triangles = triangulation(body)
    other = coal.Convex.convexHull(_points(vertices), True, "Qt")
    assert body.num_points == other.num_points
    assert body.computeVolume() == pytest.approx(other.computeVolume())
    assert solids.winding(vertices.mean(axis=0)[None], (vertices, triangles)) == pytest.approx([1.0])
    rng = np.random.default_rng(0)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    for _ in range(200):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        here = coal.Transform3s(turn * np.sign(np.linalg.det(turn)), rng.uniform(-0.4, 0.4, 3))
        found = []
        for shape in (body, other):
            result.clear()
            found.append(
                coal.distance(shape, coal.Transform3s.Identity(), coal.Box(0.1, 0.2, 0.1), here, request, result)
            )
        assert found[0] == pytest.approx(found[1], abs=1e-5)


def _points(vertices: np.ndarray) -> coal.StdVec_Vec3s:
    points = coal.StdVec_Vec3s()
    for vertex in vertices:
        points.append(vertex)
    return points


def _farthest_probe(body: object) -> float:
    """Largest of Coal's distances of points on a mesh's hull from the mesh [m]."""
    hull = triangulation(coal.Convex.convexHull(_points(triangulation(body)[0]), True, "Qt"))
    corners = hull[0][hull[1]]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    widest = corners[np.argsort(-areas)[:60]].mean(axis=1)
    probe, there, request, result = (
        coal.Sphere(1e-9),
        coal.Transform3s.Identity(),
        coal.DistanceRequest(),
        coal.DistanceResult(),
    )
    farthest = 0.0
    for point in np.vstack([widest, solids.on_surface(hull, 400, np.random.default_rng(0))]):
        result.clear()
        here = coal.Transform3s(np.eye(3), point)
        farthest = max(farthest, coal.distance(probe, here, body, there, request, result))
    return farthest
