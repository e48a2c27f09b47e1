"""Grids of cells: what they call apart or touching is so wherever in the cell; no answer depends on earlier ones."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.lanes import Lanes
from guidefield.collision.world import World
from guidefield.kernels.lane_cells import APART, TOUCHING, UNJUDGED
from guidefield.kernels.lane_tables import GRID_NUMBERS, GRID_PLACES, GRID_SIDES
from guidefield.messages import scene as messages
from guidefield.messages.requests import UrdfText
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


@pytest.mark.parametrize(("robot", "verdict"), [("panda", APART), ("boxes", APART), ("boxes", TOUCHING)])
def test_verdicts_hold_at_the_corners_of_cells(robot: str, verdict: int) -> None:
    world, lanes = alone(arm(robot))
    lanes.touching(draw(world.group, 400, 1))
    bodies, rng, seen = lanes.tables.bodies, np.random.default_rng(0), 0
    grids, numbers = bodies.grids.reshape(-1, GRID_PLACES), bodies.grid_numbers.reshape(-1, GRID_NUMBERS)
    pairs, meetings = bodies.pairs.reshape(-1, 3), bodies.meetings.reshape(-1, 4)
    for places, row, meeting in zip(grids, numbers, meetings, strict=True):
        drivers, counts, start = places[0:-1:2], places[1:-1:2], places[-1]
        verdicts = bodies.verdicts[start : start + counts.prod()]
        for cell in rng.permutation(np.flatnonzero(verdicts == verdict))[:30]:
            index = np.array(np.unravel_index(cell, counts)) + rng.integers(0, 2, GRID_SIDES)
            z = world.group.chart(world.group.random(rng))  # any corner of the cell, any value of other coordinates
            for side in np.flatnonzero(row[1:-1:3] > 0.0):
                z[drivers[side]] = row[3 * side] + index[side] / row[3 * side + 1]
            distances = [
                distance(world, z, first, second) for first, second, _ in pairs[meeting[2] : meeting[3]].tolist()
            ]
            assert min(distances) > 0.0 if verdict == APART else min(distances) <= 0.0
            seen += 1
    assert seen > (20 if verdict == APART else 5)


@pytest.mark.parametrize("robot", ["panda", "ur5", "boxes"])
def test_answers_do_not_depend_on_what_was_asked_before(robot: str) -> None:
    world, lanes = alone(arm(robot))
    zs = draw(world.group, 200, 2)
    first = lanes.touching(zs)
    judged = lanes.tables.bodies.verdicts.copy()
    np.testing.assert_array_equal(Lanes.build(world).touching(zs), first)
    np.testing.assert_array_equal(lanes.tables.bodies.verdicts, judged)
    lanes.tables.bodies.verdicts[:] = UNJUDGED
    np.testing.assert_array_equal(lanes.touching(zs[::-1]), first[::-1])
    np.testing.assert_array_equal(lanes.tables.bodies.verdicts, judged)
    assert (judged == APART).any()


@pytest.mark.filterwarnings("error")
def test_a_follower_that_nothing_moves_has_an_end() -> None:
    text = box_arm("continuous slide y", 3).text.replace(
        '<joint name="j2" type="prismatic">', '<joint name="j2" type="prismatic"><mimic joint="j1" multiplier="0"/>'
    )
    world, lanes = alone(grouped(UrdfText(text=text)))
    zs = draw(world.group, 200, 3)
    np.testing.assert_array_equal(lanes.touching(zs), [world.in_collision(world.group.from_chart(z)) for z in zs])
