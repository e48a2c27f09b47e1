"""Whole plans: real stages, certified results, a connection where planes fail, an honest status for a failure."""

import dataclasses
import time
from types import SimpleNamespace

import msgspec
import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.clearance import clearance_at
from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.handlers.plan import answer_plan
from guidefield.messages import codec, scene as messages
from guidefield.messages.replies import PlanReply
from guidefield.planner import held_paths
from guidefield.planner.connect import Connection
from guidefield.planner.held_paths import connect_to_goal
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.optimization import Optimized, optimize
from guidefield.planner.optimize.settings import OptimizationSettings
from guidefield.planner.optimized_motion import MAX_RETRIES
from guidefield.planner.path_so_far import PathSoFar, time_path_ignoring_jerk
from guidefield.planner.plan import Plan, Planner, make_refused_plan, plan
from guidefield.planner.task.problem import ConfigurationGoal, Problem, TipGoal
from guidefield.planner.task.stages import Ending, Stage, StageFailed
from guidefield.prove.certificate import certify
from guidefield.prove.curve import polyline
from guidefield.robot.group.inverse_kinematics import PoseTarget
from guidefield.scene.scene import build
from guidefield.stores import scenes
from tests.examples import example
from tests.planner.problems import closed_shell, problem, scene_of, to_configuration
from tests.planner.test_connect import wall_between
from tests.robots import box_arm, grouped, robot


def judged_densely(made: Problem, result: Plan, step: float = 1e-3) -> bool:
    """Whether no sample of the trajectory collides, at most `step` apart in every joint."""
    speed = np.abs(result.trajectory.velocities).max() + 1e-9
    count = int(np.ceil(1.5 * speed * result.trajectory.duration / step)) + 2
    times = np.linspace(0.0, result.trajectory.duration, min(count, 20_000))
    return not any(
        made.world.in_collision(made.group.expand_from_local(z)) for z in result.trajectory.evaluate(times)[0]
    )


def is_within_limits(made: Problem, result: Plan) -> bool:
    """Velocities and accelerations on a grid ten times denser than the knots."""
    times = np.linspace(0.0, result.trajectory.duration, 10 * len(result.trajectory.times))
    _, v, a = result.trajectory.evaluate(times)
    return bool(
        np.all(np.abs(v) <= made.group.velocity_limits * (1 + 1e-9))
        and np.all(np.abs(a) <= made.group.acceleration_limits * (1 + 1e-9))
    )


def check_success(made: Problem, result: Plan) -> None:
    assert result.status is Status.SUCCESS, result.message
    assert result.verdict.free
    assert certify(made.world, result.trajectory.bezier(), made.min_clearance).free
    assert judged_densely(made, result, 5e-3)
    assert is_within_limits(made, result)
    assert np.all(result.trajectory.velocities[[0, -1]] == 0.0)
    np.testing.assert_allclose(result.trajectory.positions[0], made.group.to_local(made.q_start), atol=1e-12)


def test_where_no_proof_comes_of_optimising_the_connection_is_proven_before(monkeypatch: pytest.MonkeyPatch) -> None:
    wall, start, goal = wall_between()
    made = dataclasses.replace(
        wall, q_start=wall.group.from_local(start), goal=to_configuration(goal, wall.group), guide_planes=()
    )
    optimized_to = (2 + MAX_RETRIES) * [time_path_ignoring_jerk(wall, np.array([start, goal]))]  # through the wall

    def misled(
        problem: Problem, motion: Trajectory, settings: OptimizationSettings, *_: object, **__: object
    ) -> Optimized:
        result = optimize(problem, motion, settings)
        return dataclasses.replace(result, trajectory=optimized_to.pop()) if optimized_to else result

    monkeypatch.setattr("guidefield.planner.optimized_motion.optimize", misled)
    result = plan(made, Planner.TREE)
    check_success(made, result)
    assert [stage.name for stage in result.stages].count("connect") == 2
    assert [stage.name for stage in result.stages].count("relax") == 3 + MAX_RETRIES


def test_guide_planes_in_the_bookshelf() -> None:
    made = problem("panda", "bookshelf")
    result = plan(made, Planner.GUIDED)
    check_success(made, result)
    assert set(result.crossings) == {0, 1, 2}
    tip = made.kinematics.tip_position(made.group.expand_from_local(result.trajectory.positions[-1]))
    last = made.guide_planes[-1]
    assert abs(last.signed_height(tip)) < 2e-4
    assert last.contains(tip)
    for index, at in result.crossings.items():
        crossed = made.kinematics.tip_position(made.group.expand_from_local(result.path[at]))
        assert abs(made.guide_planes[index].signed_height(crossed)) < 2e-4


def test_a_pose_among_the_boards_without_planes() -> None:
    target = PoseTarget(
        pin.SE3(pin.rpy.rpyToMatrix(0.0, np.pi / 2, 0.0), np.array([0.60, 0.0, 0.55])),
        np.full(3, 5e-3),
        np.full(3, 0.1),
    )
    made = problem("panda", "bookshelf", TipGoal(target), planes=())
    result = plan(made)
    check_success(made, result)
    end = made.kinematics.frame_placement(
        made.group.expand_from_local(result.trajectory.positions[-1]), made.group.tip_id
    )
    assert target.is_reached(end)


def test_a_configuration_behind_a_wall() -> None:
    wall = messages.Box(name="wall", size=(0.5, 0.04, 0.7), position=(0.55, 0.0, 0.35))
    start = np.array([0.9, 0.3, 0.0, -2.356, 0.0, 1.571, 0.785])
    goal = start * np.array([-1, 1, 1, 1, 1, 1, 1])
    made = problem("panda", scene_of(wall), q_start=start)
    made = problem("panda", made.scene, to_configuration(goal, made.group), q_start=start)
    result = plan(made, Planner.TREE)
    check_success(made, result)
    np.testing.assert_allclose(result.trajectory.positions[-1], goal, atol=1e-9)


@pytest.mark.parametrize("name", ["ur5", "xarm7", "kinova"])
def test_other_arms_reach_a_configuration(name: str) -> None:
    made = problem(name, scene_of(messages.HalfSpace(name="floor", normal=(0.0, 0.0, 1.0), offset=-1.5)))
    z = made.group.to_local(made.q_start)
    goal = z.copy()
    goal[0] += 1.0
    goal[2] += 0.2
    made = problem(name, made.scene, to_configuration(goal, made.group))
    check_success(made, plan(made))


def test_a_start_wholly_inside_a_hollow_mesh_is_a_collision() -> None:
    # a closed but not convex shell around the whole robot: Coal sees no contact, the start is inside all the same
    shell = closed_shell(2.0)
    result = plan(problem("panda", scene_of(shell)))
    assert result.status is Status.START_STATE_IN_COLLISION
    assert "inside" in result.message


def test_guided_alone_gives_up_honestly_with_the_motion_so_far() -> None:
    wall = messages.Box(name="wall", size=(0.02, 3.0, 3.0), position=(0.55, 0.0, 0.5))
    plane = messages.GuidePlane(
        name="GP", vertices=[(0.7, -0.1, 0.4), (0.7, 0.1, 0.4), (0.7, 0.1, 0.6), (0.7, -0.1, 0.6)]
    )
    made = problem("panda", scene_of(wall, planes=[plane]))
    result = plan(made, Planner.GUIDED)
    assert result.status is Status.STUCK_IN_MINIMUM
    assert result.details["stage"] == "guide"
    assert result.trajectory is None
    assert len(result.path) > 1
    assert result.verdict.free
    assert certify(made.world, polyline(result.path)).free


def test_auto_goes_on_with_the_tree_where_the_field_is_stuck(monkeypatch) -> None:
    from guidefield.planner import plan as plans
    from guidefield.planner.guide.guide import PlaneCrossing

    made = problem("panda", "wall_with_window")
    real, calls = plans.cross_plane, []

    def stuck_at_the_first(problem, q, plane, index, attempts):
        calls.append(index)
        if index == 0:
            return PlaneCrossing(Status.STUCK_IN_MINIMUM, "stuck", q[None], {"stage": "guide", "distance": 1.0})
        return real(problem, q, plane, index, attempts)

    monkeypatch.setattr(plans, "cross_plane", stuck_at_the_first)
    result = plan(made, Planner.AUTO)
    check_success(made, result)
    assert calls == list(range(len(made.guide_planes)))
    done = [(stage.name, stage.plane) for stage in result.stages]
    assert ("connect", 0) in done
    tip = made.kinematics.tip_position(made.group.expand_from_local(result.path[result.crossings[0]]))
    assert abs(made.guide_planes[0].signed_height(tip)) < 2e-4


def test_auto_crosses_the_planes_and_then_reaches_the_goal() -> None:
    made = problem("panda", "wall_with_window")
    through = plan(made)
    goal = through.trajectory.positions[-1] + np.array([0.05, 0, 0, 0, 0, 0, 0.3])
    made = problem("panda", made.scene, to_configuration(goal, made.group))
    result = plan(made)
    check_success(made, result)
    assert set(result.crossings) == set(range(len(made.guide_planes)))
    np.testing.assert_allclose(result.trajectory.positions[-1], goal, atol=1e-9)


def test_min_clearance_is_certified_or_refused_with_the_place() -> None:
    made = problem("panda", "wall_with_window", min_clearance=0.01)
    result = plan(made)
    check_success(made, result)
    near = problem("panda", scene_of(messages.Sphere(name="ball", radius=0.1, position=(0.5, 0.0, 0.62))))
    distance = clearance_at(near.world, near.q_start).obstacle_distance
    assert 0.0 < distance < 0.1
    refusal = plan(problem("panda", near.scene, min_clearance=distance + 0.01))
    assert refusal.status is Status.CLEARANCE_BELOW_MINIMUM
    assert refusal.details["clearance"] == pytest.approx(distance)
    assert "ball" in refusal.details["pair"]


def test_a_gate_narrower_than_the_clearance_asked_for_is_told_with_the_place() -> None:
    arm, gap = grouped(box_arm("slide", 1)), 0.03
    posts = [
        messages.Box(name=name, size=(1.0, 0.1, 0.05), position=(0.0, side * (0.02 + gap + 0.05), 1.6))
        for name, side in (("left", 1.0), ("right", -1.0))
    ]

    def planned(asked: float) -> Plan:
        goal = ConfigurationGoal((np.array([1.9]),))
        return plan(problem(arm, scene_of(*posts), goal, np.array([0.5]), (), min_clearance=asked))

    assert planned(0.9 * gap).status is Status.SUCCESS
    refusal = planned(1.5 * gap)
    assert refusal.status is Status.CLEARANCE_BELOW_MINIMUM, refusal.message
    assert gap - 1e-6 < refusal.details["clearance"] < 1.5 * gap + 1e-3  # in the gate, or where the motion enters it
    assert refusal.details["pair"][1] in ("left", "right")
    assert 0.9 < refusal.details["configuration"]["j1"] < 1.4
    assert not refusal.verdict.free


STOPPED_AT = 100.0


def _stop_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stop the clock of deadlines, so that what may always take some time is done on a busy machine, too."""
    monkeypatch.setattr("guidefield.deadline.time", SimpleNamespace(monotonic=lambda: STOPPED_AT))


def test_time_up_returns_what_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    _stop_clock(monkeypatch)
    made = problem("panda", "bookshelf", deadline=Deadline(STOPPED_AT))
    result = plan(made)
    assert result.status is Status.TIMED_OUT
    assert len(result.path) == 1
    assert result.verdict.free


def test_a_refused_plan_still_carries_a_verdict_about_its_start() -> None:
    made = problem("panda", scene_of())
    result = make_refused_plan(made, Status.START_STATE_INVALID, "because", {"joint": "j"})
    assert result.verdict.free
    assert result.path.shape == (1, 7)


@pytest.fixture
def made(monkeypatch):
    """A problem whose connections are found from the origin of local coordinates only."""
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


def ask(title: str, minimizer: str, planes: list | None = None, obstacles: tuple = ()) -> PlanReply:
    request = msgspec.json.decode(example(title)) | {"minimizer": minimizer}
    scene = msgspec.to_builtins(scenes.read_packaged(request["scene"]))
    scene["obstacles"] += obstacles
    request["scene"] = scene
    if planes is not None:
        request["guide_planes"] = planes
    message = codec.decode_request(request)
    return answer_plan(message, robot(message.robot), build(message.scene), run_id="r", received=time.monotonic())


def square(x: float, half: float, y: float = 0.0, z: float = 0.0) -> dict:
    corners = [[x, y + a * half, z + b * half] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return {"name": "GP", "vertices": corners}


@pytest.mark.parametrize("minimizer", ["projected", "univariate"])
class TestSeed:
    def test_a_plane_out_of_reach(self, minimizer: str) -> None:
        reply = ask("seed_b_tapered", minimizer, [square(2.4, 0.1)])
        assert reply.status.name == "GUIDE_PLANE_UNREACHABLE"
        assert "the arm reaches" in reply.status.message
        assert reply.status.details["guide_plane"] == "GP"
        assert len(reply.path) == 1

    def test_a_plane_narrower_than_the_robot(self, minimizer: str) -> None:
        reply = ask("seed_e_L_3", minimizer, [square(0.9, 0.02)])
        assert reply.status.name == "GUIDE_PLANE_UNREACHABLE"
        assert "inscribed radius" in reply.status.message

    def test_a_passage_narrower_than_the_robot(self, minimizer: str) -> None:
        """A plug leaves a slit of 30 mm at the bottom of the tube; the links are 50 mm thick."""
        plug = {"type": "box", "name": "plug", "size": [0.02, 0.3, 0.27], "position": [0.85, 0.0, 0.015]}
        reply = ask("seed_e_L_3", minimizer, obstacles=(plug,))
        assert reply.status.name == "STUCK_IN_MINIMUM"
        assert "plug" in reply.status.message
        assert reply.status.details["plane"] == 0
        assert set(reply.status.details["pair"]) == {"link1", "plug"}
        x, y, z = reply.status.details["tip"]
        assert 0.7 < x < 0.85
        assert max(abs(y), abs(z)) < 0.15
        assert reply.certificate.collision_free

    def test_a_start_in_a_pocket(self, minimizer: str) -> None:
        """The tube is closed before and behind the robot."""
        lids = tuple(
            {"type": "box", "name": f"lid{i}", "size": [0.02, 0.3, 0.3], "position": [x, 0.0, 0.0]}
            for i, x in enumerate((0.62, -0.3))
        )
        reply = ask("seed_e_L_3", minimizer, obstacles=lids)
        assert reply.status.name == "STUCK_IN_MINIMUM"
        assert "lid0" in reply.status.message
        assert reply.status.details["tip"][0] < 0.62


def test_a_plane_behind_the_base_is_reached() -> None:
    reply = ask("seed_b_tapered", "projected", [square(-0.6, 0.15)])
    assert reply.status.name == "SUCCESS"
