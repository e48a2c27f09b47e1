"""What stands for links in SIMD batches: hulls about all of a mesh, and points of its surface in each piece."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.convex_parts import PartsTable
from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.lanes.robot_tables import SPREAD_POINTS, _add_hulls, _surface_of
from guidefield.collision.world import World
from guidefield.geometry import surfaces
from guidefield.geometry.convex import bvh, convex_hull, hull_planes
from guidefield.geometry.decomposition import ConvexPart, decompose
from guidefield.geometry.solid import solid
from guidefield.kernels.collide.parts import BLOCKS, FIRST_BLOCK, KIND, LINK, OWN, POLYTOPE, SHAPE, SURFACE, Parts
from guidefield.kernels.simd.packing import BLOCK
from guidefield.messages import scene as messages
from guidefield.prove.tables import robot_bodies
from guidefield.scene.scene import build
from tests.geometry import solids
from tests.robots import group


def points_of(parts: Parts, part: int) -> np.ndarray:
    _, first, blocks = parts.shapes.reshape(-1, SHAPE)[part, [KIND, FIRST_BLOCK, BLOCKS]]
    some = parts.vertices[BLOCK * first : BLOCK * (first + blocks)]
    found: np.ndarray = some.reshape(blocks, 3, -1).swapaxes(1, 2).reshape(-1, 3)
    return found


def test_a_sliver_of_a_hull_takes_no_triangle_from_a_part() -> None:
    box = surfaces.box((0.2, 0.2, 0.2))
    a, b = box.vertices[0], box.vertices[-1]  # through the middle: a plane that holds the line has half of it beyond
    for side in np.vstack([np.eye(3), -np.eye(3)]):
        thin = surfaces.surface(
            np.vstack([box.vertices, 0.5 * (a + b) + 1e-14 * side]),
            np.vstack([[[0, 7, 8]], [[7, 0, 8]], box.triangles]),
        )
        found = _surface_of(box.vertices, box.triangles, ConvexPart(thin, 0.0))
        assert {row.tobytes() for row in found} == {row.tobytes() for row in box.vertices}


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


def test_the_hull_of_a_flat_mesh_is_about_it() -> None:
    rng, table = np.random.default_rng(0), PartsTable()
    corners = np.column_stack([rng.normal(size=(300, 2)), np.zeros(300)])
    placement = pin.SE3.Random()
    root, pieces = _add_hulls(table, bvh(corners, np.arange(300).reshape(-1, 3)), None, placement)
    assert pieces.tolist() == [root]
    parts, there = table.tables(), np.array([placement.act(corner) for corner in corners])
    for direction in rng.normal(size=(100, 3)):
        assert (points_of(parts, 0) @ direction).max() >= (there @ direction).max() - 1e-6


@pytest.mark.usefixtures("own_memory")
def test_bodies_themselves_are_those_that_proofs_read() -> None:
    """Megabytes of triangles are there once."""
    world = World.build(group("ur5"), build(messages.Scene(name="empty", obstacles=[])))
    lanes = BatchCollision.build(world)
    assert lanes.tables.surfaces is robot_bodies(world).parts
    assert sum(array.nbytes for array in lanes.tables.parts) < 0.05 * sum(a.nbytes for a in lanes.tables.surfaces)
