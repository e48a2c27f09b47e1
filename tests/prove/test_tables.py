"""From where own pairs are seen, as the kernels of smallest distances have it: against every choice, one by one."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.bodies import bodies, joint_placements
from guidefield.collision.motion_bound import motion_bound
from guidefield.collision.world import World
from guidefield.prove.tables import body_pairs, robot_bodies
from tests.collision.test_motion_bound import ARMS, world
from tests.planner.problems import scene_of
from tests.robots import group


def listed(row: np.ndarray) -> list[int]:
    """The indices before -1; only that is behind them."""
    count = int((row >= 0).sum())
    assert (row[count:] == -1).all()
    return row[:count].tolist()


@pytest.mark.parametrize("name", [*sorted(ARMS), "panda", "baxter"])
def test_each_pair_is_seen_from_where_its_bodies_move_least(name: str) -> None:
    place = world(name) if name in ARMS else World.build(group(name), scene_of())
    planned, own = place.group, place.pairs.own
    about, bound, pairs = bodies(planned), motion_bound(planned, own.tobytes()), body_pairs(place)
    data = planned.model.createData()
    jacobian = pin.computeJointJacobians(planned.model, data, pin.neutral(planned.model)).reshape(6, -1)
    reach = bound.axis_distances(jacobian[None], about.centres_in_world(joint_placements(data))[None])[0]
    for pair, (first, second) in enumerate(own.tolist()):
        between = [*np.flatnonzero(bound.first_only[pair])[::-1], *np.flatnonzero(bound.second_only[pair])]
        joints = [planned.model.getJointId(planned.model.names[j]) for j in range(1, planned.model.njoints)]
        joint_of = np.repeat(joints, [planned.model.joints[j].nv for j in joints])[between]
        costs = [
            reach[first, between[:at]].sum() + reach[second, between[at:]].sum()
            for at in range(len(between) + 1)
            if not set(joint_of[:at]) & set(joint_of[at:])
        ]
        mine, others = listed(pairs.first_by[pair]), listed(pairs.second_by[pair])
        assert [*mine[::-1], *others] == between
        assert not set(joint_of[: len(mine)]) & set(joint_of[len(mine) :]), "a joint is on one side"
        cost = reach[first, mine].sum() + reach[second, others].sum()
        assert cost == pytest.approx(min(costs), abs=1e-9)


def test_what_moves_a_body_is_told_in_order() -> None:
    place = World.build(group("panda"), scene_of())
    robot, about = robot_bodies(place), bodies(place.group)
    for row, moves in zip(robot.moved_by, about.moved_by, strict=True):
        assert listed(row) == np.flatnonzero(moves).tolist()
