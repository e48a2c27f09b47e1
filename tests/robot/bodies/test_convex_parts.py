"""Convex parts of real links: what touches a mesh touches a part, by Coal."""

from __future__ import annotations

import coal
import numpy as np
import pytest

from guidefield.geometry.convex import convex
from guidefield.geometry.decomposition import TOLERANCE
from guidefield.robot.bodies.bounding import MOST_PARTS, convex_parts
from guidefield.robot.model.collision_shapes import HULL_STAND_OFF, triangulation
from tests.robots import robot


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
