"""Balls among meshes, as Coal is asked about them: it finds its own spheres in contact with triangles without area."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry.convex import all_as_met, bvh
from guidefield.robot.model.pairs import scratch_space

CORNERS = np.array([(0.0, 0.0, 0.0), (1.0, 0.2, -0.3), (0.5, 0.1, -0.15)])
"""In a line."""
RADIUS = 0.05


def moving(*shapes: object) -> tuple[pin.Model, pin.GeometryModel]:
    """A model whose first shape stands at the origin and whose second slides along all axes."""
    model, geometry = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "slide")
    for name, carrier, shape in zip("ab", (0, joint), shapes, strict=True):
        geometry.addGeometryObject(pin.GeometryObject(name, carrier, pin.SE3.Identity(), shape))
    geometry.addCollisionPair(pin.CollisionPair(0, 1))
    return model, geometry


def test_a_ball_touches_a_flat_triangle_only_where_it_does() -> None:
    model, geometry = moving(bvh(CORNERS, np.array([[0, 1, 2]])), coal.Sphere(RADIUS))
    met = all_as_met(geometry)
    assert isinstance(geometry.geometryObjects[1].geometry, coal.Sphere)
    assert [(pair.first, pair.second) for pair in met.collisionPairs] == [(0, 1)]
    data, scratch = model.createData(), scratch_space(met)
    a, along = CORNERS[0], CORNERS[1] - CORNERS[0]
    counts = {True: 0, False: 0}
    rng = np.random.default_rng(0)
    for q in a + rng.uniform(-0.2, 1.2, (500, 1)) * along + rng.normal(0.0, 0.04, (500, 3)):
        nearest = a + np.clip((q - a) @ along / (along @ along), 0.0, 1.0) * along
        touches = bool(np.linalg.norm(q - nearest) < RADIUS)
        assert pin.computeCollisions(model, data, met, scratch, q, True) == touches, q
        counts[touches] += 1
    assert min(counts.values()) > 10


def test_without_meshes_balls_stay_balls() -> None:
    _, geometry = moving(coal.Box(0.1, 0.1, 0.1), coal.Sphere(RADIUS))
    assert all_as_met(geometry) is geometry
