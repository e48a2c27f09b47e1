"""Hulls stand in for meshes: they contain them, and answers that begin with them are those of the meshes."""

import coal
import numpy as np
import pytest

from guidefield.collision.clearance import contacts_at
from guidefield.messages import scene as messages
from tests.collision.listed import touching
from tests.collision.scenery import scattered, world_of
from tests.robots import group
from tests.scene.solids import l_prism, mesh_message


def surfaces_and_hulls(world):
    bodies = [body for body in range(len(world.body_names)) if world.is_surface(body)]
    return [(world.exact.shape(body), world.hulls.shape(body)) for body in bodies]


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_hulls_contain_their_meshes(name):
    shelf = mesh_message(*l_prism(), position=(0.5, 0.5, 0.5))
    world = world_of(group(name), [shelf])
    replaced = surfaces_and_hulls(world)
    assert replaced
    for shape, hull in replaced:
        corners = np.array(hull.points())
        faces = np.array([[hull.polygons(k)[i] for i in range(3)] for k in range(hull.num_polygons)])
        a, b, c = np.moveaxis(corners[faces], 1, 0)
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        heights = np.array(shape.vertices()) @ normals.T - np.einsum("ij,ij->i", normals, a)
        assert heights.max() < 1e-9


def test_what_is_flat_keeps_its_place():
    wall = messages.Polygon(name="wall", vertices=[(0.6, -0.5, 0.2), (0.7, 0.5, 0.2), (0.7, 0.5, 0.9)])
    world = world_of(group("panda"), [wall])
    assert isinstance(world.hulls.shape(len(world.body_names) - 1), coal.BVHModelBase)


@pytest.mark.parametrize("seed", range(3))
def test_contacts_are_those_of_the_meshes(seed):
    arm, rng = group("ur5"), np.random.default_rng(seed)
    world = world_of(arm, scattered(rng, 12))
    seen = 0
    for _ in range(15):
        q = arm.random(rng)
        expected = [world.pair_names(k) for k in touching(world, arm.expand(q))]
        assert [contact.pair for contact in contacts_at(world, q)] == expected
        seen += len(expected)
    assert seen
