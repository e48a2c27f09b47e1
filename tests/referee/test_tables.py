"""The tables of robots and of a scene hold what is declared: every triangle is in a leaf and in all about it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from guidefield.collision.world import World
from guidefield.kernels.collide.parts import LINK
from guidefield.kernels.prove.kept_distance import LOG_ROW, ROW_A, ROW_AXIS, ROW_B, ROW_PAIR, ROW_SEGMENT
from guidefield.prove.proof import _Writer
from guidefield.prove.search import Goal
from guidefield.prove.tables import world_tables
from guidefield.referee.judge import Along
from guidefield.referee.replay import _Replay
from guidefield.scene import library
from guidefield.scene.scene import build
from tests.referee.cases import read, straight
from tests.robots import group

SINGLE = 5e-7
"""How far meshes that Assimp reads in single precision may stand out of tables [m]."""


def nodes_below(links: np.ndarray, root: int) -> list[int]:
    found, waiting = [], [root]
    while waiting:
        node = waiting.pop()
        found.append(node)
        waiting += [child for child in links[node, :2].tolist() if child >= 0]
    return found


@pytest.mark.parametrize(("robot", "scene"), [("panda", "bookshelf")])
def test_every_node_holds_what_is_below_it(robot: str, scene: str) -> None:
    world = World.build(group(robot), build(library.read(scene)))
    tables, rows = world_tables(world, in_time=False), list[np.ndarray]()
    obstacles, links = tables.obstacles, tables.robot.parts.links.reshape(-1, LINK)
    for row, body in enumerate(tables.pairs.moving.tolist()):
        for node in nodes_below(links, int(tables.robot.roots[body])):
            for axis in (0.0, 1.0):  # by its sphere, and by its part
                one = np.zeros(LOG_ROW)
                one[[ROW_SEGMENT, ROW_PAIR]] = 1.0, len(tables.pairs.own) + row * len(obstacles.roots)
                one[[ROW_A, ROW_B, ROW_AXIS]] = node, obstacles.roots[0], axis
                rows.append(one)
    motion = straight(world, [np.zeros(world.group.nv), np.full(world.group.nv, 1e-3)])
    goal, segments = Goal(0.0), np.array([[0.0, 1.0, 0.5]])
    proof = _Writer(world, goal, np.array(rows)).proof(np.empty((0, 4)), segments)
    case = read(motion, limits=False)
    out = _Replay(case, proof, Along(case, 0.0, 0.0, math.inf))._slabs.standing_out
    assert len(proof.node_bodies) > len(tables.pairs.moving)
    assert out.max() < SINGLE
