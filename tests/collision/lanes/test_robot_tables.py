"""What stands for links in SIMD batches: hulls about all of a mesh, and points of its surface in each piece."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.lanes.robot_tables import SPREAD_POINTS, _add_hulls
from guidefield.collision.part_tables import PartsTable
from guidefield.geometry.convex import bvh, convex_hull, hull_planes
from guidefield.geometry.decomposition import decompose
from guidefield.geometry.solid import solid
from guidefield.kernels.collide.parts import BLOCKS, FIRST_BLOCK, KIND, LINK, OWN, POLYTOPE, SHAPE, SURFACE, Parts
from guidefield.kernels.simd.packing import BLOCK
from tests.geometry import solids


def points_of(parts: Parts, part: int) -> np.ndarray:
    _, first, blocks = parts.shapes.reshape(-1, SHAPE)[part, [KIND, FIRST_BLOCK, BLOCKS]]
    some = parts.vertices[BLOCK * first : BLOCK * (first + blocks)]
    found: np.ndarray = some.reshape(blocks, 3, -1).swapaxes(1, 2).reshape(-1, 3)
    return found


@pytest.mark.parametrize("seed", range(3))
def test_pieces_are_about_all_of_a_mesh_and_their_points_are_of_its_surface(seed: int) -> None:
    vertices, triangles = solids.lying([solids.torus(), solids.channel(), solids.overlapping()][seed], seed)
    cut, placement, table = decompose(solid(vertices, triangles), 0.001, 8), pin.SE3.Random(), PartsTable()
    table.add_shape(coal.Sphere(0.1), pin.SE3.Identity())
    root, pieces = _add_hulls(table, bvh(vertices, triangles), cut, placement)
    parts = table.tables()
    corners = np.array([placement.act(vertex) for vertex in vertices])
    assert root == 1
    assert len(pieces) > 3
    held = np.zeros(len(corners), bool)
    for node in (root, *pieces):
        part = int(parts.links.reshape(-1, LINK)[node, OWN])
        assert parts.shapes.reshape(-1, SHAPE)[part, KIND] == POLYTOPE
        planes = hull_planes(convex_hull(points_of(parts, part).astype(float)), 1000)
        inside = (corners @ planes[:, :3].T - planes[:, 3]).max(axis=1) < 1e-6
        assert node != root or inside.all()
        held |= inside & (node != root)
        if node != root:
            assert parts.shapes.reshape(-1, SHAPE)[part + 1, KIND] == SURFACE
            points = points_of(parts, part + 1)
            assert len(np.unique(points, axis=0)) <= SPREAD_POINTS
            assert np.linalg.norm(points[:, None] - corners, axis=2).min(axis=1).max() < 1e-6
    assert held.all()
