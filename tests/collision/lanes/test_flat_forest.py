"""The parts of flat surfaces made together are those of each alone, without hulls that say the same."""

from __future__ import annotations

import numpy as np

from guidefield.collision.convex_parts import PartsTable
from guidefield.collision.lanes.surface_tables import flat_forest
from guidefield.geometry.mesh_tree import mesh_tree
from guidefield.kernels.collide.parts import BLOCKS, FIRST_BLOCK, KIND, LINK, OWN, PART, SHAPE, TRIANGLE, Parts
from guidefield.kernels.simd.packing import BLOCK
from guidefield.kernels.simd.vector_model import LANES


def part_corners(parts: Parts, part: int) -> set[tuple[float, ...]]:
    """The corners of a part, in single precision."""
    kind, first, blocks = parts.shapes.reshape(-1, SHAPE)[part, [KIND, FIRST_BLOCK, BLOCKS]]
    if kind == TRIANGLE:
        corners = parts.numbers.reshape(-1, PART)[part, :9].reshape(3, 3).astype(np.float32)
    else:
        some = parts.vertices[BLOCK * first : BLOCK * (first + blocks)]
        corners = some.reshape(-1, 3, LANES).swapaxes(1, 2).reshape(-1, 3)
    return set(map(tuple, corners.tolist()))


def test_each_of_a_forest_is_as_its_tree_alone() -> None:
    rng = np.random.default_rng(3)
    surfaces = []
    for count in (1, 2, 1, 4, 5, 6, 21, 22, 100, 3):
        flat = np.cumsum(rng.uniform(0.1, 1.0, (count + 2, 2)) * [1.0, 0.0], axis=0) + rng.uniform(0.0, 1.0, (1, 2))
        flat[::2, 1] += 1.0
        corners = (flat @ np.linalg.qr(rng.normal(size=(3, 3)))[0][:2]) + rng.normal(size=3)
        surfaces.append(corners[np.arange(count)[:, None] + np.arange(3)])
    for corners, found in zip(surfaces, flat_forest(surfaces), strict=True):
        table = PartsTable()
        table.add_tree(mesh_tree(corners))
        expected = table.tables()
        np.testing.assert_array_equal(found.parts.balls, expected.balls)
        links, known = found.parts.links.reshape(-1, LINK), expected.links.reshape(-1, LINK)
        np.testing.assert_array_equal(links[:, :OWN], known[:, :OWN])
        np.testing.assert_array_equal(links[:, OWN] < 0, known[:, OWN] < 0)
        for own, other in zip(links[:, OWN].tolist(), known[:, OWN].tolist(), strict=True):
            if own >= 0:
                assert part_corners(found.parts, own) == part_corners(expected, other)
        assert len(found.parts.vertices) <= len(expected.vertices)
        assert len(found.nodes) == len(found.rows) >= 1
