"""Points on links: dense enough, denser where a link is slim, and not too many."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.robot.bodies import charges as module
from guidefield.robot.bodies.charges import (
    SMALLEST_SPACING,
    SPACING,
    SPACING_OF_RADIUS,
    robot_charges,
    surface,
    surface_samples,
)
from tests.robots import ARMS, box_arm, load, robot


@pytest.mark.parametrize("name", ARMS)
def test_every_surface_is_covered_to_within_its_spacing(name: str) -> None:
    model = robot(name)
    rng = np.random.default_rng(0)
    samples = surface_samples(model)
    assert surface_samples(model) is samples
    widest = max(1.0, np.sqrt(sum(map(len, samples)) / module.MOST))
    for shape, points, charged in zip(
        model.geometry.geometryObjects, samples, robot_charges(model).shapes, strict=True
    ):
        vertices, triangles = surface(shape.geometry)
        spacing = np.clip(SPACING_OF_RADIUS * charged.capsule.radius, SMALLEST_SPACING, SPACING) * widest
        corners = vertices[triangles[rng.integers(0, len(triangles), 200)]]
        anywhere = np.einsum("tk,tkj->tj", rng.dirichlet(np.ones(3), len(corners)), corners)
        gaps = np.linalg.norm(anywhere[:, None] - points[None], axis=2).min(axis=1)
        assert gaps.max() <= 1.6 * spacing
        assert not points.flags.writeable


def test_a_robot_with_much_surface_gets_a_bounded_number() -> None:
    counts = [sum(map(len, surface_samples(load(box_arm("y", links, size=2.0))))) for links in (3, 60)]
    assert counts[1] < 2.5 * module.MOST
    assert counts[0] < 2.5 * module.MOST
