"""Grids of cells: what they call apart is so everywhere in the cell; no answer depends on what was asked before."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.lanes import Lanes
from guidefield.collision.world import World
from guidefield.kernels.lane_cells import APART, UNJUDGED
from guidefield.kernels.lane_tables import GRID_NUMBERS, GRID_PLACES
from guidefield.messages import scene as messages
from guidefield.robot.group import PlanningGroup
from guidefield.scene.scene import build
from tests.collision.test_lanes import draw
from tests.robots import box_arm, group, grouped


def alone(planned: PlanningGroup) -> tuple[World, Lanes]:
    """A robot that only has itself, none of whose cells have been judged."""
    world = World.build(planned, build(messages.Scene(name="nothing")))
    lanes = Lanes.build(world)
    lanes.tables.bodies.verdicts[:] = UNJUDGED
    return world, lanes


def arm(name: str) -> PlanningGroup:
    return grouped(box_arm("x slide oblique continuous mimic y", 6)) if name == "boxes" else group(name)


def distance(world: World, z: np.ndarray, first: int, second: int) -> float:
    """Between two bodies, by Coal."""
    shapes = world.group.geometry.geometryObjects
    pin.forwardKinematics(world.model, world.data, world.group.expand(world.group.from_chart(z)))
    placed = []
    for index in (first, second):
        placement = world.data.oMi[shapes[index].parentJoint] * shapes[index].placement
        placed += [shapes[index].geometry, coal.Transform3s(placement.rotation, placement.translation)]
    return float(coal.distance(*placed, coal.DistanceRequest(), coal.DistanceResult()))


@pytest.mark.parametrize("robot", ["panda", "boxes"])
def test_cells_that_are_apart_are_so_at_their_corners(robot: str) -> None:
    world, lanes = alone(arm(robot))
    lanes.touching(draw(world.group, 300, 1))
    bodies, rng, seen = lanes.tables.bodies, np.random.default_rng(0), 0
    grids, numbers = bodies.grids.reshape(-1, GRID_PLACES), bodies.grid_numbers.reshape(-1, GRID_NUMBERS)
    pairs, meetings = bodies.pairs.reshape(-1, 3), bodies.meetings.reshape(-1, 4)
    for (u, count_u, v, count_v, start), row, meeting in zip(grids, numbers, meetings, strict=True):
        verdicts = bodies.verdicts[start : start + count_u * count_v]
        for cell in rng.permutation(np.flatnonzero(verdicts == APART))[:30]:
            corner = rng.integers(0, 2, 2)  # any corner of the cell, any value of all other coordinates
            z = world.group.chart(world.group.random(rng))
            z[u] = row[0] + (cell // count_v + corner[0]) / row[1]
            if row[4] > 0.0:
                z[v] = row[3] + (cell % count_v + corner[1]) / row[4]
            for first, second, _ in pairs[meeting[2] : meeting[3]].tolist():
                assert distance(world, z, first, second) > 0.0
            seen += 1
    assert seen > 20


@pytest.mark.parametrize("robot", ["panda", "ur5", "boxes"])
def test_answers_do_not_depend_on_what_was_asked_before(robot: str) -> None:
    world, lanes = alone(arm(robot))
    zs = draw(world.group, 200, 2)
    first = lanes.touching(zs)
    judged = lanes.tables.bodies.verdicts.copy()
    lanes.forget()
    np.testing.assert_array_equal(lanes.touching(zs), first)
    np.testing.assert_array_equal(lanes.tables.bodies.verdicts, judged)
    lanes.tables.bodies.verdicts[:] = UNJUDGED
    np.testing.assert_array_equal(lanes.touching(zs[::-1]), first[::-1])
    np.testing.assert_array_equal(lanes.tables.bodies.verdicts, judged)
    assert (judged == APART).any()
