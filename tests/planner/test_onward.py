"""Going on by a connection: from where guide planes led, else from the start."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from guidefield.errors import Status
from guidefield.planner import onward
from guidefield.planner.connect import Connection
from guidefield.planner.onward import Found, connect_to_goal
from guidefield.planner.stages import Stage, StageFailed
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

    monkeypatch.setattr(onward, "connect", connect)
    return problem("panda", scene_of()), asked


def test_a_connection_begins_where_derived_planes_led_then_at_the_start(made) -> None:
    planned, asked = made
    start, led, goal = np.zeros(7), np.full(7, 0.1), np.full(7, 0.2)
    found = Found(np.array([start, led]), {0: 1})
    connect_to_goal(dataclasses.replace(planned, derived_planes=1), found, goal[None], Stage())
    assert [z.tolist() for z in asked] == [led.tolist(), start.tolist()]
    assert found.path.tolist() == [start.tolist(), goal.tolist()]
    assert found.crossings == {}


def test_planes_that_were_given_are_not_forgotten(made) -> None:
    planned, asked = made
    found = Found(np.array([np.zeros(7), np.full(7, 0.1)]), {0: 1})
    with pytest.raises(StageFailed, match="nothing leads on"):
        connect_to_goal(planned, found, np.full((1, 7), 0.2), Stage())
    assert len(asked) == 1
    assert found.crossings == {0: 1}
