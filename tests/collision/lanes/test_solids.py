"""A mesh of several solids is what its solids are, one by one: convex ones parts, others trees, hollows free."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.world import World
from guidefield.geometry import surfaces
from guidefield.messages import scene as messages
from guidefield.scene.scene import Scene, build
from tests.collision.lanes.test_lanes import torus
from tests.robots import group, random_configuration
from tests.scene.solids import box_mesh, l_prism, mesh_message, room

Mesh = tuple[np.ndarray, np.ndarray]


def moved(mesh: Mesh, scale: object, place: object) -> Mesh:
    return np.asarray(mesh[0], float) * scale + place, np.asarray(mesh[1])


@functools.cache
def solids() -> dict[str, Mesh]:
    """Boards that share corners and edges, as those of a shelf do; a ball, an L, a hollow box, a ring."""
    ball = surfaces.sphere(0.1, subdivisions=2)
    points, triangles = torus()
    return {
        "side": moved(box_mesh(), (0.25, 0.125, 0.5), (0.625, -0.3125, 0.5)),
        "shelf": moved(box_mesh(), (0.25, 0.5, 0.125), (0.625, 0.0, 0.8125)),
        "corner": moved(box_mesh(), (0.125, 0.125, 0.125), (0.8125, -0.4375, 0.1875)),
        "ball": moved((ball.vertices, ball.triangles), 1.0, (0.2, 0.5, 0.6)),
        "bend": moved(l_prism(), 0.125, (-0.5, 0.25, 0.25)),
        "room": moved(room(0.5, 0.375), 1.0, (-0.5, -0.5, 0.5)),
        "ring": moved((np.array(points), np.array(triangles)), 1.0, (0.1, 0.1, 1.1)),
    }


@functools.cache
def scenes() -> tuple[Scene, Scene]:
    """All solids as one mesh, and each as a mesh of its own."""
    meshes = list(solids().values())
    firsts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes[:-1])])
    triangles = np.concatenate([rows + first for (_, rows), first in zip(meshes, firsts, strict=True)])
    one = mesh_message(np.concatenate([vertices for vertices, _ in meshes]), triangles, name="all")
    each = [mesh_message(*mesh, name=name) for name, mesh in solids().items()]
    return build(messages.Scene(name="one", obstacles=[one])), build(messages.Scene(name="each", obstacles=each))


@pytest.mark.parametrize("robot", ["panda", "ur5"])
def test_a_robot_touches_one_mesh_where_it_touches_its_solids(robot: str) -> None:
    planned = group(robot)
    zs = np.array([planned.chart(random_configuration(planned, seed)) for seed in range(400)])
    one, each = (BatchCollision.build(World.build(planned, scene)) for scene in scenes())
    for clearance in (0.0, 0.03):
        first, second = one.touching(zs, clearance), each.touching(zs, clearance)
        assert 20 < second.sum() < 380
        # within a convex solid a body touches it; surfaces alone leave what is wholly inside to `enclosure`
        assert not (second & ~first).any()
        assert (first & ~second).sum() <= 2
