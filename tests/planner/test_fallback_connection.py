"""Going on by a connection: from where guide planes led, else from the start."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner import held_paths
from guidefield.planner.connect import Connection
from guidefield.planner.held_paths import connect_to_goal
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.task.stages import Ending, Stage, StageFailed
from tests.planner.problems import problem, scene_of


@pytest.fixture
def made(monkeypatch):
    """A problem whose connections are found from the origin of the chart only."""
    asked = []

    def connect(problem, z_start, goals, rng, *, prove):
        asked.append(z_start)
        if np.any(z_start):
            return Connection(Status.PLANNING_FAILED, "nothing leads on", z_start[None])
        return Connection(Status.SUCCESS, "found", np.array([z_start, goals[0]]), prove)

    monkeypatch.setattr(held_paths, "connect", connect)
    return problem("panda", scene_of()), asked


def test_a_connection_begins_where_derived_planes_led_then_at_the_start(made) -> None:
    planned, asked = made
    start, led, goal = np.zeros(7), np.full(7, 0.1), np.full(7, 0.2)
    found = PathSoFar(np.array([start, led]), {0: 1})
    reached = connect_to_goal(dataclasses.replace(planned, derived_planes=1), found, goal[None], Stage())
    assert [z.tolist() for z in asked] == [led.tolist(), start.tolist()]
    assert reached.failure is None
    assert reached.path.tolist() == [start.tolist(), goal.tolist()]
    assert reached.crossings == {}
    assert found.path.tolist() == [start.tolist(), led.tolist()]
    assert found.crossings == {0: 1}


def test_planes_that_were_given_are_not_forgotten(made) -> None:
    planned, asked = made
    found = PathSoFar(np.array([np.zeros(7), np.full(7, 0.1)]), {0: 1})
    reached = connect_to_goal(planned, found, np.full((1, 7), 0.2), Stage())
    assert (reached.failure.message, reached.failure.details) == ("nothing leads on", {"stage": "connect"})
    assert len(asked) == 1
    assert reached.crossings == {0: 1}
    assert reached.path.tolist() == found.path.tolist()


def test_a_plane_that_nothing_leads_to_leaves_the_path_as_far_as_the_approach_came(made, monkeypatch) -> None:
    """Also where the connection began anew at the start: the approach went on from where derived planes led."""
    planned, _ = made
    corners = [(0.7, -0.2, 0.3), (0.7, 0.25, 0.3), (0.7, 0.1, 0.7), (0.7, -0.1, 0.7)]
    given = problem("panda", scene_of(planes=[messages.GuidePlane(name="GP", vertices=corners)]))
    planned = dataclasses.replace(planned, guide_planes=given.guide_planes * 2, derived_planes=1)
    start, led, came = np.full(7, 0.05), np.full(7, 0.1), np.full(7, 0.15)
    found = PathSoFar(np.array([start, led]), {0: 1})
    stuck = found.extend(np.array([led, came])).with_failure(Ending(Status.STUCK_IN_MINIMUM, "stuck", {"plane": 1}))
    monkeypatch.setattr(held_paths, "find_tip_points", lambda *_: np.full((1, 7), 0.2))
    stage = Stage()
    reached = held_paths.connect_to_plane(planned, found, stuck, 1, stage)
    assert reached.failure.status is Status.STUCK_IN_MINIMUM
    assert reached.failure.message == "stuck; the tree got no further either: nothing leads on"
    assert reached.failure.details == {"plane": 1}
    assert stage.outcome == "nothing leads on"
    assert reached.path.tolist() == [start.tolist(), led.tolist(), came.tolist()]
    assert reached.crossings == {0: 1}


def test_where_the_nearest_place_of_a_plane_is_blocked_the_tip_may_be_elsewhere_on_it(made, monkeypatch) -> None:
    corners = [(0.7, -0.2, 0.3), (0.7, 0.25, 0.3), (0.7, 0.1, 0.7), (0.7, -0.1, 0.7)]
    planned = problem("panda", scene_of(planes=[messages.GuidePlane(name="GP", vertices=corners)]))
    (plane,), targets = planned.guide_planes, []

    def tip_points(problem, target):
        targets.append(target)
        if len(targets) == 1:
            raise StageFailed(Status.NO_IK_SOLUTION, "blocked")
        return np.full((1, 7), 0.2)

    monkeypatch.setattr(held_paths, "find_tip_points", tip_points)
    stuck = PathSoFar.at_start(planned).with_failure(Ending(Status.STUCK_IN_MINIMUM, "stuck"))
    held_paths.connect_to_plane(planned, PathSoFar(np.zeros((1, 7))), stuck, 0, Stage())
    nearest, square = targets
    assert not nearest.position_tolerance.any()
    half = square.position_tolerance[0]
    assert half > 0.02
    assert square.position_tolerance.tolist() == [half, half, 0.0]
    for x, y in ((-half, -half), (half, -half), (half, half), (-half, half)):
        corner = square.placement.act(np.array([x, y, 0.0]))
        assert plane.contains(corner)
        assert abs(plane.signed_height(corner)) < 1e-12
