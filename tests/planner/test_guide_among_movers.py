"""The guided planner among obstacles that move: it waits, gives way, keeps to its limits, and says why it can't."""

import dataclasses

import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.planner.guide.guide import ATTEMPTS
from guidefield.planner.held_paths import find_quick_paths
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.plan import Plan, Planner, plan
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Ending
from tests.planner.guide.test_guide import plane_at
from tests.planner.problems import problem, scene_of, seed_problem


def planned(made: Problem) -> Plan:
    return plan(made, Planner.GUIDED, ATTEMPTS["projected"](made.group))


def touches(made: Problem, found: Plan, count: int = 80, frozen: float | None = None) -> bool:
    """Whether a sample of the motion touches the obstacles as they then stand (or as they stood at one time)."""
    for time in np.linspace(0.0, found.trajectory.duration, count):
        z = found.trajectory.evaluate(np.array([time]))[0][0]
        if contacts_at(made.at(time if frozen is None else frozen).world, made.group.from_chart(z)):
            return True
    return False


@pytest.mark.parametrize("title", ["door", "conveyor"])
def test_it_waits_for_what_moves_and_is_certified(title: str) -> None:
    made = seed_problem(title)
    found = planned(made)
    assert found.status is Status.SUCCESS, found.message
    assert found.verdict.free
    assert not touches(made, found)
    assert any(touches(made, found, frozen=time) for time in (0.0, 4.0, 6.0)), "it would have been in the way"
    samples = found.trajectory.evaluate(np.linspace(0.0, found.trajectory.duration, 4000))
    assert np.all(np.abs(samples[1]) <= made.group.velocity_limits)
    assert np.all(np.abs(samples[2]) <= made.group.acceleration_limits)
    for index, plane in enumerate(made.guide_planes):
        q = made.group.from_chart(found.path[found.crossings[index]])
        assert abs(plane.signed_height(made.kinematics.tip_position(q))) <= 1e-4


@pytest.mark.parametrize("title", ["door", "conveyor"])
def test_optimised_in_time_it_is_sooner_and_does_not_rest_at_waypoints(title: str) -> None:
    made = seed_problem(title)
    shaped, found = planned(made), planned(dataclasses.replace(made, optimization_iterations=0))
    assert found.status is Status.SUCCESS
    assert shaped.trajectory.times[-1] < 0.9 * found.trajectory.times[-1]
    speeds = np.abs(shaped.trajectory.velocities).max(axis=1)
    assert (speeds[2:-1] > 0.0).all(), "but for a wait at the start and the end"
    assert shaped.crossings.keys() == found.crossings.keys() == set(range(len(made.guide_planes)))
    for index, plane in enumerate(made.guide_planes):
        tip = made.kinematics.tip_position(made.group.from_chart(shaped.path[shaped.crossings[index]]))
        assert abs(plane.signed_height(tip)) <= 2e-6
        assert plane.distance(tip) <= 2e-6
    clearances = [
        min(
            clearance_at(made.at(now).world, made.group.from_chart(z)).obstacle_distance
            for now, z in zip(times, one.trajectory.evaluate(times)[0], strict=True)
        )
        for one in (shaped, found)
        for times in (np.linspace(0.0, one.trajectory.times[-1], 60),)
    ]
    assert clearances[0] > min(0.02, 0.5 * clearances[1]), "room is bought, but not all of it"


@pytest.mark.parametrize(("jerk", "steps"), [(50.0, None), (500.0, 0)])
def test_jerk_limits_are_kept_in_time(jerk: float, steps: int | None) -> None:
    made = seed_problem("door")
    limits = np.full(made.group.nv, jerk)
    found = planned(dataclasses.replace(made, jerk_limits=limits, optimization_iterations=steps))
    assert found.status is Status.SUCCESS, found.message
    assert found.verdict.free
    assert not touches(made, found)
    samples = found.trajectory.evaluate(np.linspace(0.0, found.trajectory.times[-1], 4001))
    assert np.all(np.abs(samples[1]) <= made.group.velocity_limits)
    assert np.all(np.abs(samples[2]) <= made.group.acceleration_limits)
    # no jump of the acceleration either: between two samples it changes by what the jerk allows
    apart = found.trajectory.times[-1] / 4000.0
    assert np.abs(np.diff(samples[2], axis=0)).max() <= jerk * apart * (1.0 + 1e-6)
    assert np.abs(samples[2][[0, -1]]).max() <= 1e-9
    for index, plane in enumerate(made.guide_planes):
        tip = made.kinematics.tip_position(made.group.from_chart(found.path[found.crossings[index]]))
        assert abs(plane.signed_height(tip)) <= 1e-4


def test_a_plane_is_the_goal_where_nothing_comes_to_the_robot_any_more() -> None:
    """A ball passes where the arm ends: it is there before that, or after."""
    still = problem("panda", scene_of(planes=[plane_at(0.6)]))
    end = planned(still).trajectory
    tip = still.kinematics.tip_position(still.group.from_chart(end.positions[-1]))
    way = [Placement(position=tuple((tip + aside).tolist())) for aside in ([0.0, -0.8, 0.0], [0.0, 0.8, 0.0])]
    ball = messages.Sphere(name="ball", radius=0.05, trajectory=messages.ObstacleTrajectory([1.0, 3.0], way))
    made = problem("panda", scene_of(ball, planes=[plane_at(0.6)]))
    found = planned(made)
    assert found.status is Status.SUCCESS, found.message
    assert not touches(made, found)
    for now in np.arange(found.trajectory.times[-1], 3.1, 0.02).tolist():
        q = made.group.from_chart(found.trajectory.positions[-1])
        assert not contacts_at(made.at(now).world, q), now


def test_planes_that_are_barred_at_a_time_are_tried_once_and_not_wherever_things_are_until_later() -> None:
    made, asked = seed_problem("door"), []

    def through(among: Problem, found: PathSoFar, _: bool) -> tuple[PathSoFar, None]:
        asked.append(len(among.scene.obstacles))
        return found.with_failure(Ending(Status.STUCK_IN_MINIMUM, "barred", {})), None

    assert not list(find_quick_paths(made, through))
    alone = len(made.scene.obstacles) - 1
    # until 2 s, at two of the moments that are looked at, the door is where it is at first
    assert asked == [alone, alone + 1, alone + 1, alone + 1]


def closing(until: float) -> Problem:
    """A shutter comes down in front of the arm, and stays."""
    down = messages.ObstacleTrajectory(
        times=[0.0, until], placements=[Placement(position=(0.75, 0.0, 1.8)), Placement(position=(0.75, 0.0, 0.5))]
    )
    shutter = messages.Box(name="shutter", size=(0.04, 3.0, 1.3), trajectory=down)
    return problem("panda", scene_of(shutter, planes=[plane_at(0.84, half=0.15, z=0.4)]))


def test_a_way_that_has_closed_is_told_with_the_time() -> None:
    found = planned(closing(0.2))
    assert found.status is Status.STUCK_IN_MINIMUM
    assert found.details["guide_plane"] == "GP"
    assert found.details["time"] == 0.2
    assert "path" not in found.details
    assert found.verdict.free


def test_what_hits_the_robot_is_named() -> None:
    """A wall sweeps through all that the arm can reach."""
    made = problem("panda", scene_of(planes=[plane_at(0.6)]))
    sweep = messages.ObstacleTrajectory(
        times=[0.0, 0.5], placements=[Placement(position=(2.0, 0.0, 0.8)), Placement(position=(-1.0, 0.0, 0.8))]
    )
    wall = messages.Box(name="wall", size=(0.1, 4.0, 2.0), trajectory=sweep)
    hit = problem("panda", scene_of(wall, planes=[made.scene.message.guide_planes[0]]))
    found = planned(hit)
    assert found.status is Status.START_STATE_INVALID
    assert found.details["pair"][1] == "wall"
    assert found.verdict.free
    assert dataclasses.replace(found).trajectory is None
