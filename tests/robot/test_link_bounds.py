"""Spheres and convex parts of real links: what touches a mesh touches them, judged by Coal and by dense sampling."""

import coal
import numpy as np
import pytest

from guidefield.geometry.convex import convex
from guidefield.geometry.decomposition import TOLERANCE
from guidefield.robot.link_bounds import MOST_PARTS, convex_parts, coverage
from guidefield.robot.link_charges import surface
from guidefield.robot.model.collision_shapes import HULL_STAND_OFF, triangulation
from tests.geometry import solids
from tests.robots import ARMS, robot


def shape(name: str, part: str):
    """A collision shape of a robot, and its balls."""
    geometry = robot(name).geometry.geometryObjects
    index = next(k for k, one in enumerate(geometry) if one.name == part)
    return geometry[index].geometry, coverage(robot(name)).shapes[index]


def distances(balls: np.ndarray, body: object) -> np.ndarray:
    """Coal's signed distance of each ball from a body."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    found = []
    for x, y, z, radius in balls:
        result.clear()
        here, there = coal.Transform3s(np.eye(3), np.array([x, y, z])), coal.Transform3s.Identity()
        found.append(coal.distance(coal.Sphere(radius), here, body, there, request, result))
    return np.array(found)


@pytest.mark.parametrize("name", ARMS)
def test_inner_balls_touch_what_coal_says_is_there(name: str) -> None:
    model = robot(name)
    hulls = 0
    for one, found in zip(model.geometry.geometryObjects, coverage(model).shapes, strict=True):
        if not len(found.inner):
            continue
        mesh = surface(one.geometry)
        on_balls = solids.around(found.inner, 5, np.random.default_rng(2)).reshape(-1, 3)
        assert (np.abs(solids.winding(np.vstack([found.inner[:, :3], on_balls]), mesh)) > 0.5).all()
        if isinstance(one.geometry, coal.Convex):
            hulls += 1
            assert (found.inner[:, 3] < solids.distance(found.inner[:, :3], mesh)).all()
            assert (distances(found.inner, one.geometry) <= -2.0 * found.inner[:, 3] + 1e-5).all()
    assert hulls == sum(choice.judged_as == "convex hull" for choice in model.geometry_choices)


def test_whatever_touches_a_mesh_touches_its_cover_and_what_touches_inside_touches_it() -> None:
    body, found = shape("ur5", "upper_arm_link_0")
    rng = np.random.default_rng(3)
    low, high = (extreme(triangulation(body)[0], axis=0) for extreme in (np.min, np.max))
    obstacle, request, result = coal.Box(0.03, 0.05, 0.08), coal.CollisionRequest(), coal.CollisionResult()
    touched = 0
    for _ in range(400):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        here = coal.Transform3s(turn, rng.uniform(low - 0.05, high + 0.05))
        result.clear()
        if coal.collide(body, coal.Transform3s.Identity(), obstacle, here, request, result):
            touched += 1
            local = (found.cover.spheres[:, :3] - here.getTranslation()) @ turn
            gaps = np.linalg.norm(np.maximum(np.abs(local) - [0.015, 0.025, 0.04], 0.0), axis=1)
            reached = gaps <= found.cover.spheres[:, 3]
            assert reached.any()
            # and the group of a sphere that is reached is reached
            groups = np.repeat(np.arange(len(found.cover.groups)), np.diff(found.cover.first))
            outer = (found.cover.groups[:, :3] - here.getTranslation()) @ turn
            outer_gaps = np.linalg.norm(np.maximum(np.abs(outer) - [0.015, 0.025, 0.04], 0.0), axis=1)
            assert (outer_gaps <= found.cover.groups[:, 3])[np.unique(groups[reached])].all()
    assert touched > 50


def test_meshes_have_parts_and_what_is_convex_has_none() -> None:
    assert all(found is None for found in convex_parts(robot("panda")))
    model = robot("ur5")
    for choice, found in zip(model.geometry_choices, convex_parts(model), strict=True):
        assert (found is not None) == (choice.judged_as == "triangle mesh")
        if found is not None:
            assert found.hull.stand_off > HULL_STAND_OFF
            assert 1 <= len(found.parts) <= MOST_PARTS
            assert found.stand_off <= found.hull.stand_off + TOLERANCE  # by which either may be given too large


@pytest.mark.parametrize("part", ["upper_arm_link_0", "wrist_1_link_0"])
def test_what_touches_a_mesh_touches_one_of_its_parts(part: str) -> None:
    model = robot("ur5")
    index = next(k for k, shape in enumerate(model.geometry.geometryObjects) if shape.name == part)
    mesh, found = model.geometry.geometryObjects[index].geometry, convex_parts(model)[index]
    hulls = [convex(*one.hull) for one in (found.hull, *found.parts)]
    vertices = triangulation(mesh)[0]
    rng, request, result = np.random.default_rng(0), coal.CollisionRequest(), coal.CollisionResult()
    obstacle, here = coal.Box(0.02, 0.03, 0.04), coal.Transform3s.Identity()
    touched = clear = 0
    for _ in range(1500):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        there = coal.Transform3s(turn, rng.uniform(vertices.min(axis=0) - 0.02, vertices.max(axis=0) + 0.02))
        answers = []
        for body in (mesh, *hulls):
            result.clear()
            answers.append(bool(coal.collide(body, here, obstacle, there, request, result)))
        exact, hull, *parts = answers
        touched += exact
        clear += hull and not any(parts)
        assert any(parts) or not exact
        assert hull or not any(parts)
    assert touched > 100
    assert clear > 0, "the parts tell more than the hull"
