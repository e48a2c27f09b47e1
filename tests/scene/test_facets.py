"""Facets: the patches of a surface are all of it, and are judged as the whole is."""

from typing import Any

import coal
import numpy as np
import pytest

from guidefield.collision.narrow_phase import NarrowPhase, transform
from guidefield.geometry.surfaces import se3
from guidefield.scene import obstacle_parts
from guidefield.scene.obstacle_parts import Patches


def terrain(side: int) -> tuple[np.ndarray, np.ndarray]:
    """An open surface of 2 side^2 triangles, 2 m wide."""
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(-1.0, 1.0, side + 1)], indexing="ij"))
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    first = np.column_stack([corner, corner + side + 1, corner + 1])
    second = np.column_stack([corner + 1, corner + side + 1, corner + side + 2])
    return np.column_stack([x, y, 0.2 * np.sin(5.0 * x) * np.cos(4.0 * y)]), np.concatenate([first, second])


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Patches of few triangles."""
    monkeypatch.setattr(obstacle_parts, "PATCH", 50)


def _placement(rng: np.random.Generator) -> Any:
    return se3(rng.uniform(-1.0, 1.0, 3).tolist(), rng.normal(size=4).tolist())


@pytest.mark.usefixtures("small")
def test_a_surface_in_patches_is_judged_as_in_one_piece() -> None:
    vertices, triangles = terrain(20)
    body, whole, patches = (
        coal.Capsule(0.05, 0.3),
        obstacle_parts.bvh(vertices, triangles),
        Patches(lambda: (vertices, triangles)),
    )
    rng = np.random.default_rng(4)
    there = _placement(rng)
    touching = 0
    for _ in range(60):
        here = there * _placement(rng)
        here.translation = there.act(rng.uniform([-1.3, -1.3, -0.4], [1.3, 1.3, 0.6]))
        asked = [
            NarrowPhase(lambda b, o=other: (body, o)[b], lambda b, h=here: transform((h, there)[b]))
            for other in (whole, patches)
        ]
        apart, ours = (phase.distance(0, 1).distance for phase in asked)
        assert max(ours, 0.0) == pytest.approx(max(apart, 0.0), abs=1e-7)
        touching += apart <= 0.0
        for margin in (0.0, 0.07):
            one, other = (phase.penetration(0, 1, margin) for phase in asked)
            assert (one is None) == (other is None)
            if one is not None and other is not None and apart > 0.0:
                assert other >= apart - 1e-6
    assert 5 < touching < 55
