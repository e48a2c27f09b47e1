"""What is kept while a path is spread anew."""

from __future__ import annotations

import dataclasses

import numpy as np

from guidefield.messages import scene as messages
from guidefield.planner.relax.kept_waypoints import KeptWaypoints
from guidefield.planner.task.problem import Problem
from guidefield.scene.guide_plane import build
from tests.planner.problems import problem, scene_of


def made(*at: int) -> tuple[Problem, np.ndarray]:
    """A Panda, a path of ten waypoints, and a plane through the tip at some of them."""
    planned = problem("panda", scene_of(), planes=())
    z = planned.group.chart(planned.q_start)
    path = z + 0.1 * np.random.default_rng(0).normal(size=(10, len(z))).cumsum(axis=0)
    planes = []
    for index in at:
        tip = planned.kinematics.tip_position(planned.group.expand_from_chart(path[index]))
        corners = [tip + np.array([0.1 * a, 0.1 * b, 0.0]) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        planes.append(build(messages.GuidePlane(name="GP", vertices=[tuple(c.tolist()) for c in corners]), 0))
    return dataclasses.replace(planned, guide_planes=tuple(planes)), path


def test_ends_and_fixed_waypoints_stay_and_crossings_keep_their_planes() -> None:
    planned, path = made(4, 9)
    fixed = np.zeros(10, bool)
    fixed[7] = True
    kept = KeptWaypoints.of(planned, path, {0: 4, 1: 9}, fixed)
    assert kept.held == [0, 7, 9]
    assert list(kept.on_planes) == [4]
    assert kept.on_planes[4].plane is planned.guide_planes[0]
    assert kept.marks == {0: 4, 1: 9}


def test_a_waypoint_on_two_planes_stays() -> None:
    planned, path = made(4, 4)
    kept = KeptWaypoints.of(planned, path, {0: 4, 1: 4}, None)
    assert kept.held == [0, 4, 9]
    assert not kept.on_planes
    assert kept.marks == {0: 4, 1: 4}


def test_spreading_again_and_again_never_loses_them() -> None:
    planned, path = made(2, 6)
    fixed = np.zeros(10, bool)
    fixed[4] = True
    kept = KeptWaypoints.of(planned, path, {0: 2, 1: 6}, fixed)
    points = path
    for segments in (50, 17, 8, 3, 40):
        points, kept = kept.spread(points, segments)
        np.testing.assert_array_equal(points[kept.at], path[[0, 2, 4, 6, 9]])
        assert kept.marks == {0: int(kept.at[1]), 1: int(kept.at[3])}
        assert kept.held == [int(kept.at[k]) for k in (0, 2, 4)]
        assert list(kept.on_planes) == [int(kept.at[k]) for k in (1, 3)]
