"""Check the tables that a search over a motion asks: each node holds all that its body has below it."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from guidefield.case_file import Motion, make_cases
from guidefield.collision.world import World
from guidefield.kernels.collide.parts import LINK
from guidefield.kernels.prove.kept_distance import LOG_ROW, ROW_A, ROW_AXIS, ROW_B, ROW_PAIR, ROW_SEGMENT
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.prove.proof import _Writer
from guidefield.prove.search import SearchQuery
from guidefield.prove.tables import world_tables
from guidefield.referee.judge import Along
from guidefield.referee.loading import case_of
from guidefield.referee.replay import _Replay
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import build

SINGLE = 1e-6
"""How far a mesh that Assimp reads in single precision may stand out of its table, for each metre of its size [m]."""


def check_tables(world: World) -> dict[str, float]:
    """How far each moving link and each obstacle stands out of its nodes at most, as a share of 1 m and its size.

    It is infinite where a triangle is in no leaf, and there is nothing where no link moves that has a shape. Every node
    is put into a slab, once by its sphere and once by its part: so the referee asks of each triangle whether it is in a
    leaf and in all that holds this one.

    Args:
        world: The robot among at least one obstacle.
    """
    tables = world_tables(world, in_time=False)
    robot, obstacles, pairs = tables.robot, tables.obstacles, tables.pairs
    first, count, rows = len(pairs.own), len(obstacles.roots), list[np.ndarray]()
    for row, body in enumerate(pairs.moving.tolist()):
        nodes = _below(robot.parts.links, int(robot.roots[body]))
        rows.append(_rows(first + row * count, nodes, np.full(len(nodes), obstacles.roots[0])))
    for index, root in enumerate(obstacles.roots.tolist() if len(pairs.moving) else ()):
        nodes = _below(obstacles.parts.links, root)
        rows.append(_rows(first + index, np.full(len(nodes), robot.roots[pairs.moving[0]]), nodes))
    if not rows:
        return {}
    straight = np.outer([0.0, 1e-6], np.ones(world.group.nv))
    motion = Motion(world, Placement(), (), None, straight, None)
    proof = _Writer(world, SearchQuery(0.0), np.concatenate(rows)).proof(np.empty((0, 4)), np.array([[0.0, 1.0, 0.5]]))
    case = case_of(make_cases(motion)[0])
    out = _Replay(case, proof, Along(case, 0.0, 0.0, math.inf))._slabs.standing_out
    found: dict[str, float] = {}
    for one, far in zip(case.bodies, out.tolist(), strict=True):
        found[one.name] = max(found.get(one.name, 0.0), far / (1.0 + float(np.ptp(one.corners, axis=0).max())))
    return found


def robot_alone(robot: RobotModel) -> World:
    """A robot with all its joints, far from the one thing that stands in its world."""
    far = messages.Box(name="far away", size=(1.0, 1.0, 1.0), position=(0.0, 0.0, -1e3))
    group = select(robot, None, None, robot.rest, pin.SE3.Identity())
    return World.build(group, build(messages.Scene(name="alone", obstacles=[far])))


def _below(links: np.ndarray, root: int) -> np.ndarray:
    """A node and all below it."""
    table, found, waiting = links.reshape(-1, LINK)[:, :2], [], np.array([root])
    while len(waiting):
        found.append(waiting)
        waiting = table[waiting].ravel()
        waiting = waiting[waiting >= 0]
    return np.concatenate(found)


def _rows(pair: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Slabs between nodes of a pair (n,), by their spheres and by their parts, as a search writes them down."""
    rows = np.zeros((2, len(first), LOG_ROW))
    rows[..., ROW_SEGMENT], rows[..., ROW_PAIR] = 1.0, pair
    rows[..., ROW_A], rows[..., ROW_B], rows[1, :, ROW_AXIS] = first, second, 1.0
    return rows.reshape(-1, LOG_ROW)
