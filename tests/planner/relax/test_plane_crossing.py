"""Crossings: the tip is brought back to its plane and its polygon, and held there."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.messages import scene as messages
from guidefield.planner.relax.plane_crossing import PlaneCrossing
from guidefield.planner.relax.settings import CROSSING
from guidefield.planner.task.problem import Problem
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.guide_plane import GuidePlane, build
from tests.planner.problems import problem, scene_of
from tests.robots import box_arm, group, grouped

GROUPS = {
    "panda": lambda: group("panda"),
    "floating": lambda: grouped(box_arm("floating x y", 0)),
    "planar": lambda: grouped(box_arm("planar x y", 0)),
}


def plane_through(tip: np.ndarray, half: float = 0.1, shift: float = 0.0) -> GuidePlane:
    """A square across (1, 1, 0) around a point, moved within its plane by a share of its half side."""
    across, up = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0), np.array([0.0, 0.0, 1.0])
    middle = tip + shift * half * across
    corners = [middle + half * (a * across + b * up) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return build(messages.GuidePlane(name="GP", vertices=[tuple(c.tolist()) for c in corners]), 0)


def made(name: str, seed: int = 0) -> tuple[Problem, np.ndarray, np.ndarray]:
    """A problem, a chart point and the tip there."""
    planned: PlanningGroup = GROUPS[name]()
    made_for = problem(planned, scene_of(), planes=())
    z = 0.8 * planned.chart(planned.random(np.random.default_rng(seed)))
    z = np.clip(z, planned.lower + 0.1, planned.upper - 0.1)
    return made_for, z, made_for.kinematics.tip_position(planned.expand_from_chart(z))


@pytest.mark.parametrize("name", GROUPS)
@pytest.mark.parametrize("seed", range(4))
def test_a_waypoint_is_brought_back(name: str, seed: int) -> None:
    made_for, z, tip = made(name, seed)
    crossing = PlaneCrossing.through(made_for, plane_through(tip), z)
    pushed = z + 0.05 * np.random.default_rng(seed).normal(size=len(z))
    back = crossing.brought_back(pushed)
    assert back is not None
    reached = made_for.kinematics.tip_position(made_for.group.expand_from_chart(back))
    assert crossing.plane.distance(reached, crossing.inset) <= CROSSING.on_plane
    assert abs(crossing.plane.signed_height(reached)) <= CROSSING.on_plane
    assert (back >= made_for.group.lower).all()
    assert (back <= made_for.group.upper).all()
    assert np.linalg.norm(back - pushed) < 1.0


def test_a_plane_out_of_reach_is_given_up() -> None:
    made_for, z, tip = made("panda")
    crossing = PlaneCrossing(made_for, plane_through(tip + np.array([3.0, 0.0, 0.0])), 0.0)
    assert crossing.brought_back(z) is None


@pytest.mark.parametrize("name", GROUPS)
def test_moving_across_what_is_held_keeps_the_tip_on_the_plane(name: str) -> None:
    made_for, z, tip = made(name)
    crossing = PlaneCrossing.through(made_for, plane_through(tip), z)
    held = crossing.held_directions(z, np.zeros(len(z)))
    assert len(held) == 1
    np.testing.assert_allclose(held @ held.T, np.eye(len(held)), atol=1e-12)
    move = np.random.default_rng(3).normal(size=len(z))
    move = 1e-4 * (move - held.T @ (held @ move))
    moved = made_for.kinematics.tip_position(made_for.group.expand_from_chart(z + move))
    assert np.linalg.norm(moved - tip) > 1e-6
    assert abs(crossing.plane.signed_height(moved)) < 1e-6


def test_at_an_edge_only_ways_out_are_held() -> None:
    made_for, z, tip = made("panda")
    plane = plane_through(tip, shift=-1.0)  # the tip is on the edge where `across` is largest
    crossing = PlaneCrossing.through(made_for, plane, z)
    assert crossing.inset == pytest.approx(0.0, abs=1e-9)
    J = made_for.kinematics.tip_jacobian(made_for.group.expand_from_chart(z))[:3]
    outwards = J.T @ (tip - plane.centroid)
    assert len(crossing.held_directions(z, outwards)) == 2
    assert len(crossing.held_directions(z, -outwards)) == 1


def test_the_inset_is_what_the_crossing_had_where_that_is_less() -> None:
    made_for, z, tip = made("panda")
    near_edge = PlaneCrossing.through(made_for, plane_through(tip, shift=-0.98), z)
    assert near_edge.inset == pytest.approx(0.02 * 0.1, rel=1e-6)
    assert PlaneCrossing.through(made_for, plane_through(tip), z).inset > 0.004
