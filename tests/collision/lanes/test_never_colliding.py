"""What is left out as never touching doesn't, at any configuration; what touches is kept."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.collision.lanes.lanes import prune_pairs
from guidefield.collision.lanes.robot_tables import lane_robot
from guidefield.collision.world import World
from guidefield.kernels.collide.layout import LaneBodies
from guidefield.messages import scene as messages
from guidefield.messages.requests import UrdfText
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import build
from tests.collision.lanes.test_cell_grids import distance
from tests.robots import box_arm, group, grouped

TWO_BALLS = """<robot name="balls"><link name="base"/>
<link name="near"><collision><origin xyz="0.1 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="far"><collision><origin xyz="{x} 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="j1" type="continuous"><parent link="base"/><child link="near"/><axis xyz="0 0 1"/></joint>
<joint name="j2" type="continuous"><parent link="base"/><child link="far"/><axis xyz="0 0 1"/></joint></robot>"""
"""Two balls that turn about one axis, at distances 0.1 and x from it: they meet if x < 0.3."""


def meeting(bodies: LaneBodies) -> set[tuple[int, int]]:
    """Pairs of bodies that are asked whether they touch."""
    pairs = bodies.pairs.reshape(-1, 3)
    rows = [pairs[first:last, :2] for first, last in bodies.meetings.reshape(-1, 4)[:, 2:].tolist()]
    return {(a, b) for a, b in np.concatenate([np.empty((0, 2), np.int64), *rows]).tolist()}


def left_out(planned: PlanningGroup) -> tuple[World, set[tuple[int, int]], set[tuple[int, int]]]:
    """The robot among nothing, its pairs, and those of them that are left out."""
    world = World.build(planned, build(messages.Scene(name="nothing")))
    robot = lane_robot(planned, world.pairs.own)
    left = meeting(prune_pairs(robot, planned.nv).bodies)
    every = meeting(robot.bodies)
    assert left <= every
    return world, every, every - left


@pytest.mark.parametrize("robot", ["ur5", "panda", "boxes"])
def test_what_is_left_out_keeps_apart(robot: str) -> None:
    planned = grouped(box_arm("x slide oblique continuous mimic y", 6)) if robot == "boxes" else group(robot)
    world, every, out = left_out(planned)
    rng, nearest = np.random.default_rng(5), dict.fromkeys(every, np.inf)
    for _ in range(100):
        z = planned.chart(planned.random(rng))
        for pair in every:
            nearest[pair] = min(nearest[pair], distance(world, z, *pair))
    assert all(nearest[pair] > 0.0 for pair in out)
    assert min(nearest.values()) <= 0.0, "some pairs touch, and are kept"


@pytest.mark.parametrize(("x", "touch"), [(0.295, True), (0.3009, True), (0.303, False), (0.5, False)])
def test_what_comes_within_a_millimetre_is_kept(x: float, touch: bool) -> None:
    _, every, out = left_out(grouped(UrdfText(text=TWO_BALLS.format(x=x))))
    assert len(every) == 1
    assert out == (set() if touch else every)
