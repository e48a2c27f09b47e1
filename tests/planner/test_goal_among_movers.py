"""Plans to configurations and poses among obstacles that move: free at dense times, or told what meets when."""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin
import pytest

import guidefield
from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.collision.world import World
from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.messages.requests import AttachedObject, PlanRequest
from guidefield.messages.values import JointsGoal
from guidefield.planner.finish import STOPS
from guidefield.planner.plan import Plan, plan
from guidefield.planner.slices import SCHEDULE
from guidefield.planner.task.effort import EffortLimit, tree_of
from guidefield.planner.task.motion_limits import frame_limit
from guidefield.planner.task.problem import ConfigurationGoal, Problem, TipGoal
from guidefield.planner.task.trace import StageEntered
from guidefield.robot.group.inverse_kinematics import PoseTarget
from guidefield.robot.group.path_constraints import Cone
from guidefield.scene.guide_plane import build
from tests.planner.problems import Listener, problem, scene_of, to_configuration
from tests.planner.test_schedule import flight, require_within
from tests.robots import group, rest

PANDA = group("panda")
REST = PANDA.to_local(rest(PANDA))
LEFT, RIGHT = (REST + np.array([sign * 0.8, 0.2, 0.0, 0.2, 0.0, 0.0, 0.0]) for sign in (1.0, -1.0))

DOOR = messages.Box(
    name="door", size=(1.4, 0.05, 1.6), trajectory=flight([2.0, 3.0], (0.85, 0.0, 0.8), (2.6, 0.0, 0.8))
)
"""Between left and right until it slides away."""


def asked(*obstacles: messages.Obstacle, goal: Any = RIGHT, start: np.ndarray = LEFT, **options: Any) -> Problem:
    goal = to_configuration(goal, PANDA) if isinstance(goal, np.ndarray) else goal
    return problem(PANDA, scene_of(*obstacles), goal, PANDA.from_local(start), planes=(), **options)


def require_free(made: Problem, found: Plan, step: float = 0.05) -> None:
    """Certified, within limits, from the start to the goal, and free of all as it stands at dense times."""
    assert found.status is Status.SUCCESS, found.message
    assert found.verdict.free
    motion = found.trajectory
    assert motion.times[0] == 0.0
    np.testing.assert_array_equal(motion.positions[0], made.z_start)
    require_within(made, motion)
    until = max(float(motion.times[-1]), made.scene.end) + step
    for now in np.arange(0.0, until, step):  # beyond its end it stands at the goal
        z = motion.evaluate(np.array([now]))[0][0]
        world = World.build(made.group, made.scene.at(now), made.allowed_collisions)
        assert not contacts_at(world, made.group.expand_from_local(z)), now
        if made.min_clearance:
            apart = clearance_at(world, made.group.expand_from_local(z)).obstacle_distance
            assert apart >= made.min_clearance - 1e-5


@pytest.mark.parametrize("jerk", [None, 300.0])
def test_it_waits_for_a_door_and_arrives_sooner_than_if_it_waited_until_all_rest(jerk: float | None) -> None:
    slow = messages.Sphere(name="slow", radius=0.05, trajectory=flight([0.0, 9.0], (0.0, 1.5, 0.5), (0.0, 2.5, 0.5)))
    limits = None if jerk is None else np.full(7, jerk)
    made = asked(DOOR, slow, min_clearance=0.01, jerk_limits=limits)
    found = plan(made)
    require_free(made, found)
    np.testing.assert_allclose(found.trajectory.positions[-1], RIGHT, atol=1e-12)
    assert 2.0 < found.trajectory.times[-1] < 6.0


POST = messages.Box(name="post", size=(0.12, 0.12, 1.6))
PASSING = messages.Sphere(name="ball", radius=0.15, trajectory=flight([0.0, 4.5], (0.45, -1.2, 0.6), (0.45, 1.2, 0.6)))


def post_and_door() -> tuple[messages.Obstacle, ...]:
    """A post comes to the start and goes again, long before the door opens."""
    x, y, _ = made_tip(LEFT).translation
    path = flight([1.0, 2.0, 2.5, 3.5], (x, y + 1.2, 0.8), (x, y, 0.8), (x, y, 0.8), (x, y + 1.2, 0.8))
    late = msgspec.structs.replace(DOOR, trajectory=flight([6.0, 7.0], (0.85, 0.0, 0.8), (2.6, 0.0, 0.8)))
    return msgspec.structs.replace(POST, trajectory=path), late


def efforts(*most: float) -> EffortLimit:
    """Limits of the first joints of a Panda [N m]."""
    tree = tree_of(PANDA)
    return EffortLimit(tree, np.r_[most, np.full(7 - len(most), np.inf)], tuple(PANDA.velocity_names))


def test_where_it_waits_on_its_way_it_keeps_the_speed_and_acceleration_of_the_hand() -> None:
    """By dense differences of places."""
    limit = frame_limit(PANDA, "panda_hand_tcp", 0.5, 2.0)
    made = asked(*post_and_door(), cartesian_limits=(limit,))
    found = plan(made)
    require_free(made, found, step=0.2)
    times, step = np.linspace(0.0, found.trajectory.times[-1], 4001, retstep=True)
    data, frame = PANDA.model.createData(), PANDA.model.getFrameId("panda_hand_tcp")
    places = []
    for z in found.trajectory.evaluate(times)[0]:
        pin.framesForwardKinematics(PANDA.model, data, PANDA.expand_from_local(z))
        places.append(data.oMf[frame].translation.copy())
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / step
    accelerations = np.linalg.norm(np.diff(places, 2, axis=0), axis=1) / step**2
    assert 0.4 < speeds.max() <= 0.5
    assert 1.5 < accelerations.max() <= 2.0


@pytest.mark.parametrize("jerk", [None, 300.0])
def test_among_what_moves_torques_keep_their_limits(jerk: float | None) -> None:
    """By Pinocchio's inverse dynamics."""
    limit = efforts(12.0, 30.0, 20.0, 26.0)
    obstacles = post_and_door() if jerk is None else (PASSING,)
    made = asked(*obstacles, effort_limit=limit, jerk_limits=None if jerk is None else np.full(7, jerk))
    found = plan(made)
    require_free(made, found, step=0.2)
    data = PANDA.model.createData()
    taken = [
        pin.rnea(PANDA.model, data, PANDA.expand_from_local(z), PANDA.expand_velocity @ v, PANDA.expand_velocity @ a)
        for z, v, a in zip(*found.trajectory.evaluate(np.linspace(0.0, found.trajectory.times[-1], 3001)), strict=True)
    ]
    shares = np.abs(taken)[:, :7].max(axis=0) / limit.limits
    assert 0.7 < shares.max() <= 1.0


def test_where_it_may_not_wait_it_gives_way_and_waits_elsewhere() -> None:
    made = asked(*post_and_door())
    assert any(contacts_at(made.at(t).world, PANDA.expand_from_local(LEFT)) for t in np.arange(1.0, 3.1, 0.05))
    found = plan(made)
    require_free(made, found)
    assert 6.0 < found.trajectory.times[-1] < 10.0


def test_poses_and_sets_are_goals() -> None:
    placement = made_tip(RIGHT)
    made = asked(DOOR, goal=TipGoal(PoseTarget(placement, np.full(3, 1e-3), np.full(3, 1e-2))))
    found = plan(made)
    require_free(made, found)
    reached = made_tip(found.trajectory.positions[-1])
    assert np.linalg.norm(reached.translation - placement.translation) <= 2e-3
    others = (PANDA.from_local(RIGHT), PANDA.from_local(LEFT + 0.3 * np.eye(7)[0]))
    near = plan(asked(DOOR, goal=ConfigurationGoal(others)))
    require_free(asked(DOOR), near)
    np.testing.assert_allclose(near.trajectory.positions[-1], PANDA.to_local(others[1]), atol=1e-9)
    assert near.trajectory.times[-1] < 2.0, "the one on this side of the door"


def made_tip(z: np.ndarray) -> Any:
    return asked(DOOR).kinematics.frame_placement(PANDA.expand_from_local(z), PANDA.tip_id)


# ---- refusals


def test_what_runs_into_the_waiting_robot_is_told_with_its_time() -> None:
    """A wall sweeps through all that the arm can reach, and the only way opens after that."""
    wall = messages.Box(
        name="wall", size=(0.1, 4.0, 3.0), trajectory=flight([1.0, 3.0], (2.0, 0.0, 1.0), (-1.0, 0.0, 1.0))
    )
    late = msgspec.structs.replace(DOOR, trajectory=flight([8.0, 9.0], (0.85, 0.0, 0.8), (2.6, 0.0, 0.8)))
    made = asked(wall, late)
    found = plan(made)
    assert found.status is Status.START_STATE_INVALID, found.message
    assert found.details["pair"][1] == "wall"
    times = np.arange(1.0, 3.0, 0.02)
    met_at = next(t for t in times if contacts_at(made.at(t).world, PANDA.expand_from_local(made.z_start)))
    assert met_at - 0.1 <= found.details["time"] <= met_at
    assert "wall" in found.message
    assert found.trajectory is None
    assert found.verdict.free, "where it starts, at time 0"


def test_a_goal_in_which_something_comes_to_rest_is_refused() -> None:
    at = made_tip(RIGHT).translation
    inside = messages.Sphere(
        name="ball", radius=0.1, trajectory=flight([0.0, 5.0], (0.4, -2.0, 0.6), tuple(at.tolist()))
    )
    found = plan(asked(inside))
    assert found.status is Status.GOAL_IN_COLLISION, found.message
    assert "ball" in found.message
    assert "5.00 s" in found.message


def test_a_start_that_is_free_at_first_is_judged_as_it_is_at_time_0() -> None:
    """The obstacle began elsewhere, before time 0: there it would touch the robot, or wouldn't."""
    at = tuple(made_tip(LEFT).translation.tolist())
    gone = messages.Sphere(name="ball", radius=0.1, trajectory=flight([-2.0, -1.0], at, (0.0, 3.0, 0.5)))
    require_free(asked(gone), plan(asked(gone)))
    come = messages.Sphere(name="ball", radius=0.1, trajectory=flight([-2.0, -1.0], (0.0, 3.0, 0.5), at))
    assert plan(asked(come)).status is Status.START_STATE_IN_COLLISION


# ---- what is kept besides


def test_path_constraints_are_kept_all_along() -> None:
    """The hand stays upright while it waits for the door and swings past."""
    start, goal = (REST + sign * 0.7 * np.eye(7)[0] for sign in (1.0, -1.0))
    axis = made_tip(REST).rotation.T @ np.array([0.0, 0.0, 1.0])
    upright = Cone(PANDA.tip, axis, np.array([0.0, 0.0, 1.0]), 0.2)
    made = asked(DOOR, start=start, goal=goal, path_constraints=(upright,))
    found = plan(made)
    require_free(made, found)
    for z in found.trajectory.evaluate(np.linspace(0.0, found.trajectory.times[-1], 300))[0]:
        assert np.arccos(np.clip((made_tip(z).rotation @ axis)[2], -1.0, 1.0)) <= 0.2 + 1e-9
    assert found.trajectory.times[-1] > 2.0


def test_pairs_that_may_touch_may_touch_as_they_move() -> None:
    names = frozenset((link, "ball") for link in PANDA.robot.links)
    at = tuple(made_tip(LEFT).translation.tolist())
    ball = messages.Sphere(name="ball", radius=0.1, trajectory=flight([0.0, 4.0], at, (0.3, -0.5, 0.6)))
    scene = scene_of(ball, DOOR)
    made = dataclasses.replace(
        problem(PANDA, scene, to_configuration(RIGHT, PANDA), PANDA.from_local(LEFT), planes=()),
        allowed_collisions=names,
        world=World.build(PANDA, scene, names),
    )
    require_free(made, plan(made))


def test_what_is_held_is_kept_free_and_the_recording_has_the_motion(tmp_path: Path) -> None:
    rod = messages.Capsule(name="rod", radius=0.02, length=0.3, position=(0.0, 0.0, 0.15))
    ends = [dict(zip(PANDA.position_names, PANDA.wire_positions(z), strict=True)) for z in (LEFT, RIGHT)]
    held = AttachedObject(link="panda_hand", obstacle=rod, touch_links=["panda_leftfinger", "panda_rightfinger"])
    request = PlanRequest(
        robot="panda",
        scene=scene_of(DOOR).message,
        start=ends[0],
        goal=JointsGoal(ends[1]),
        attached_objects=[held],
        allowed_planning_time=600.0,
    )
    reply = guidefield.answer(request, record_to=tmp_path / "run.rrd")
    assert reply.status.name == "SUCCESS", reply.status
    assert reply.certificate.collision_free
    assert reply.clearance.minimum > 0.0
    assert reply.trajectory.times[-1] > 2.0
    bare = guidefield.answer(msgspec.structs.replace(request, attached_objects=[]))
    assert bare.status.name == "SUCCESS"
    assert reply.trajectory.positions != bare.trajectory.positions, "what is held counts"
    recorded = guidefield.run_arrays(tmp_path / "run.rrd")
    np.testing.assert_allclose(recorded.times, reply.trajectory.times)


# ---- what moves of other kinds, and motions that go on from where another ends


def test_floors_that_rise_and_clouds_that_slide_away_are_kept_from() -> None:
    """A cloud of so many points that fewer stand for it is the door; the floor comes up to the hand, and sinks."""
    points = np.random.default_rng(2).uniform((-0.7, -0.03, -0.8), (0.7, 0.03, 0.8), (2 * SCHEDULE.most_points, 3))
    cloud = messages.PointCloud(
        name="cloud", points=points.tolist(), radius=0.03, trajectory=flight([2.0, 3.0], (0.85, 0, 0.8), (2.6, 0, 0.8))
    )
    floor = messages.HalfSpace(
        name="floor", normal=(0.0, 0.0, 1.0), trajectory=flight([0.5, 2.0, 3.0], (0, 0, -0.6), (0, 0, 0), (0, 0, -0.6))
    )
    made = asked(cloud, floor, min_clearance=0.005)
    found = plan(made)
    require_free(made, found, step=0.05)
    assert found.trajectory.times[-1] > 2.0


def test_guide_planes_lead_to_a_goal() -> None:
    corners = [(0.3, -0.3, 0.2), (0.8, -0.3, 0.2), (0.8, -0.3, 0.9), (0.3, -0.3, 0.9)]
    made = asked(DOOR)
    made = dataclasses.replace(made, guide_planes=(build(messages.GuidePlane(name="p", vertices=corners), 0),))
    found = plan(made)
    require_free(made, found)
    np.testing.assert_allclose(found.trajectory.positions[-1], RIGHT, atol=1e-12)
    (crossed,) = found.crossings.values()
    tip = made.kinematics.tip_position(PANDA.expand_from_local(found.path[crossed]))
    assert abs(tip[1] + 0.3) <= 1e-4


def test_a_robot_in_motion_stops_before_it_waits_and_may_arrive_in_motion() -> None:
    rate = 0.4 * np.eye(7)[0]
    made = asked(DOOR, start_velocity=-rate, end_velocity=-rate)
    found = plan(made)
    require_free(made, found)
    np.testing.assert_array_equal(found.trajectory.velocities[[0, -1]], [-rate, -rate])
    assert STOPS in found.warnings
    refused = plan(asked(DOOR, start=LEFT - 0.33 * np.eye(7)[0], start_velocity=-2.0 * np.eye(7)[0]))
    assert refused.status is Status.START_STATE_INVALID
    assert "door" in refused.message


# ---- random scenes, as `tools/bench timed` draws them


@pytest.mark.parametrize("seed", [5])
def test_wherever_the_planner_among_obstacles_at_rest_finds_a_motion_there_is_one_in_time(seed, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "tools"))
    from benchmarks import timed

    loaded = timed.Loaded.of(timed.Robot(catalog="panda"), Path(), timed.Engine())
    drawn = timed.problem_of(loaded, seed, 600.0)
    replies = [timed.time_answer(request)[0] for request in (drawn.resting, drawn.request)]
    assert [reply.status.name for reply in replies] == ["SUCCESS", "SUCCESS"]
    assert replies[1].certificate.collision_free
    assert not timed.touches(loaded, drawn, replies[1])
    assert replies[1].metrics.duration <= drawn.scene.end + replies[0].metrics.duration + 0.5


@functools.cache
def planned(jerk: float | None, iterations: int | None) -> tuple[Problem, Plan]:
    """A Panda that has to wait for a door."""
    limits = None if jerk is None else np.full(7, jerk)
    made = asked(DOOR, min_clearance=0.01, jerk_limits=limits, observer=Listener())
    made = dataclasses.replace(made, optimization_iterations=iterations)
    return made, plan(made)


@pytest.mark.parametrize("jerk", [None, 300.0])
def test_it_arrives_sooner_than_the_schedule_and_stays_free_and_within_limits(jerk: float | None) -> None:
    (_, scheduled), (made, shaped) = planned(jerk, 0), planned(jerk, None)
    require_free(made, shaped)
    assert shaped.trajectory.times[-1] < 0.9 * scheduled.trajectory.times[-1]
    told = [event.message for event in made.observer.events if isinstance(event, StageEntered)]
    assert any("among what moves" in message for message in told)


def test_it_does_not_arrive_before_its_end_is_free_for_good() -> None:
    """A bar passes over the goal; the robot comes after it, though nothing but that is in its way."""
    x, y, z = made_tip(RIGHT).translation
    path = flight([0.0, 3.0], (x, y - 0.9, z), (x, y + 0.9, z))
    made = asked(messages.Sphere(name="ball", radius=0.08, trajectory=path), min_clearance=0.005)
    found = plan(made)
    require_free(made, found)
    assert found.trajectory.times[-1] > 1.4
