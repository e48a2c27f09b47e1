"""Answers in large scenes are among what the robot can meet, and the same as among all of it."""

import time
from typing import Any

import numpy as np
import pytest
import trimesh

from guidefield.collision.bodies import reach_ball
from guidefield.deadline import Deadline, DeadlineExpired
from guidefield.handlers import preparation
from guidefield.handlers.certify import answer_certify
from guidefield.handlers.certify_problem import certify_problem
from guidefield.handlers.plan import answer_plan
from guidefield.handlers.preparation import crop_to_reach
from guidefield.messages import codec, scene as messages
from guidefield.messages.replies import PlanReply
from guidefield.messages.values import Placement
from guidefield.planner.task.problem import Conditions
from guidefield.scene import crop as room
from guidefield.scene.crop import Ball, crop, nearest_obstacles
from guidefield.scene.scene import Scene, build
from tests.handlers.test_plan import PATIENT, READY
from tests.robots import group, random_configuration, robot
from tests.scene.test_crop import grid, mesh

COUNT = 90  # squares a side: more than ten thousand triangles


def ground() -> Scene:
    vertices, triangles = grid((-6.0, -6.0, -0.15), (12.0, 0.0, 0.0), (0.0, 12.0, 0.0), COUNT)
    rng = np.random.default_rng(2)
    vertices[:, 2] += 0.05 * rng.uniform(size=len(vertices))
    points = rng.uniform(-6.0, 6.0, (12_000, 3)) * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
    scene = {"name": "yard", "obstacles": [{"type": "point_cloud", "name": "roof", "points": points, "radius": 0.02}]}
    decoded = codec.decode_request({"robot": "panda", "scene": scene, "goal": {"type": "joints", "positions": {}}})
    return build(
        type(decoded.scene)(name="yard", obstacles=[mesh("ground", vertices, triangles), *decoded.scene.obstacles])
    )


def ask(scene: Scene, **request: Any) -> PlanReply:
    asked = {"robot": "panda", "scene": "yard", "start": READY, "guide_planes": [], **PATIENT, **request}
    asked.setdefault("goal", {"type": "joints", "positions": {**READY, "panda_joint1": 1.2, "panda_joint2": 0.3}})
    message = codec.decode_request(asked)
    return answer_plan(message, robot("panda"), scene, run_id="run", received=time.monotonic())


def leave_whole(monkeypatch: pytest.MonkeyPatch, asked: str) -> None:
    """Have no scene cropped for having many obstacles, or large ones."""
    for module in (room, preparation):
        monkeypatch.setattr(module, asked, lambda _: False)


def require_same_among_all(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, cropped_for: str, off: float, closer: float, **asked: Any
) -> None:
    """Ask in what the robot can meet and in all: motions are off each other by so much, clearances [m] by so much."""
    met = ask(scene, **asked)
    leave_whole(monkeypatch, cropped_for)
    whole = ask(scene, **asked)
    assert met.status.name == whole.status.name == "SUCCESS"
    assert met.certificate.collision_free
    np.testing.assert_allclose(met.trajectory.times, whole.trajectory.times, atol=off)
    np.testing.assert_allclose(met.trajectory.positions, whole.trajectory.positions, atol=off)
    assert met.clearance.pair == whole.clearance.pair
    assert met.clearance.minimum == pytest.approx(whole.clearance.minimum, abs=closer)


@pytest.fixture(scope="module")
def yard() -> Scene:
    return ground()


def test_answers_are_those_among_all_of_it(yard: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    require_same_among_all(yard, monkeypatch, "has_large", 1e-3, 2e-4)


def test_what_is_touched_is_named_as_among_all_of_it(yard: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    goals = [random_configuration(group("panda"), seed).tolist() for seed in range(40)]
    asked = [{"type": "joints", "positions": dict(zip(READY, goal, strict=True))} for goal in goals]
    impatient = {"allowed_planning_time": 30.0, "optimization_iterations": 0}
    some = [goal for goal in asked if ask(yard, goal=goal, **impatient).status.name == "GOAL_IN_COLLISION"]
    met = [ask(yard, goal=goal).status for goal in some]
    leave_whole(monkeypatch, "has_large")
    assert [ask(yard, goal=goal).status.message for goal in some] == [status.message for status in met]
    named = " ".join(status.message for status in met)
    assert "and ground" in named
    assert "and roof" in named


def test_a_judgement_is_among_what_is_met(yard: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    positions = [[*READY.values()], [*{**READY, "panda_joint1": 1.0}.values()]]
    request = codec.decode_request(
        {"type": "certify", "robot": "panda", "scene": "yard", "path": positions, "recording": "off"}
    )
    found = [answer_certify(request, robot("panda"), yard, run_id="run", received=time.monotonic())]
    leave_whole(monkeypatch, "has_large")
    found.append(answer_certify(request, robot("panda"), yard, run_id="run", received=time.monotonic()))
    assert found[0].status == found[1].status
    assert found[0].clearance.minimum == pytest.approx(found[1].clearance.minimum, abs=2e-4)


def test_a_robot_inside_of_a_solid_of_which_it_sees_one_side_is_in_collision() -> None:
    block = trimesh.creation.box((20.0, 20.0, 10.0))
    for _ in range(5):
        block = block.subdivide()
    uneven = np.random.default_rng(0).uniform(-0.02, 0.02, block.vertices.shape)  # what is convex is judged as its hull
    vertices = block.vertices + uneven - [0.0, 0.0, 5.0 - 1.4]
    scene = build(messages.Scene(name="yard", obstacles=[mesh("block", vertices, block.faces)]))
    reach = reach_ball(group("panda"))
    assert reach is not None
    met = crop(scene, reach)[0]
    assert met.obstacles[0].faces < 0.5 * scene.obstacles[0].faces
    assert ask(scene).status.name == "START_STATE_IN_COLLISION"
    positions = [[*READY.values()], [*{**READY, "panda_joint1": 1.0}.values()]]
    request = codec.decode_request(
        {"type": "certify", "robot": "panda", "scene": "yard", "path": positions, "recording": "off"}
    )
    judged = answer_certify(request, robot("panda"), scene, run_id="run", received=time.monotonic())
    assert not judged.certificate.collision_free


def test_time_that_is_up_before_is_told() -> None:
    yard = ground()
    request = codec.decode_request(
        {"type": "certify", "robot": "panda", "scene": "yard", "path": [[*READY.values()]] * 2}
    )
    problem, _ = certify_problem(request, robot("panda"), yard, Deadline())
    with pytest.raises(DeadlineExpired, match="in reach of scene yard"):
        crop_to_reach(problem, Deadline(0.0))
    assert crop_to_reach(problem, Deadline()).scene.obstacles[0].faces < yard.obstacles[0].faces


def shelves(seed: int, wide: float = 3.0) -> Scene:
    """Crumbs in so many metres about a robot, and a box that is in its way."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-wide, wide, (1500, 3))
    clear = places[(np.hypot(places[:, 0], places[:, 1]) > 0.75) | (places[:, 2] > 1.4)].tolist()
    crumbs = [messages.Box(name=f"c{k}", size=(0.03, 0.02, 0.04), position=tuple(at)) for k, at in enumerate(clear)]
    post = messages.Box(name="post", size=(0.06, 0.06, 0.5), position=(0.35, 0.42, 0.6))
    return build(messages.Scene("yard", obstacles=[*crumbs, post]))


@pytest.mark.parametrize("seed", range(3))
def test_answers_among_very_many_are_those_among_all(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = shelves(seed)
    near = min(scene.obstacles, key=lambda one: float(np.linalg.norm(one.placement.translation))).name
    allowed = [["panda_hand", scene.obstacles[0].name], ["panda_link4", near], ["panda_hand", near]]
    assert len(nearest_obstacles(scene, reach_ball(group("panda")) or Ball(0, 0, 0, 0)).chosen) < len(scene.obstacles)
    asked = {"allowed_collisions": allowed, "seed": seed}
    require_same_among_all(scene, monkeypatch, "has_many", 1e-9, 1e-9, **asked)


def of(scene: Scene) -> Conditions:
    """A judgement in a scene."""
    motion = {"times": [0.0, 1.0], "positions": [[*READY.values()]] * 2, "velocities": [[0.0] * len(READY)] * 2}
    asked = {"type": "certify", "robot": "panda", "scene": "yard", "trajectory": motion}
    return certify_problem(codec.decode_request(asked), robot("panda"), scene, Deadline())[0]


def drifting(name: str, begin: np.ndarray, end: np.ndarray) -> messages.Box:
    """A crumb that slides for 4 s."""
    places = [Placement(tuple(begin.tolist())), Placement(tuple(end.tolist()))]
    return messages.Box(name=name, size=(0.05, 0.04, 0.03), trajectory=messages.ObstacleTrajectory([0.0, 4.0], places))


def crowd(seed: int) -> Scene:
    """Sixty crumbs that move, most of them far away, boxes that rest, and one that comes across the robot's way."""
    rng = np.random.default_rng(seed)
    away = rng.uniform([3.0, -9.0, -9.0], [21.0, 9.0, 9.0], (60, 3))
    crumbs = [drifting(f"c{k}", at, at + rng.uniform(-0.5, 0.5, 3)) for k, at in enumerate(away)]
    across = drifting("across", np.array([0.55, 0.9, 0.5]), np.array([0.55, -0.6, 0.5]))
    posts = [messages.Box(name=f"p{k}", size=(0.1, 0.1, 0.1), position=(0.2 * k, -3.0, 0.0)) for k in range(300)]
    return build(messages.Scene("yard", obstacles=[*crumbs, across, *posts]))


@pytest.mark.parametrize("seed", range(2))
def test_answers_among_many_that_move_are_those_among_all(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = crowd(seed)
    left = crop_to_reach(of(scene), Deadline()).scene
    assert left.moves
    assert len(left.obstacles) < 0.5 * len(scene.obstacles)
    asked = {"allowed_collisions": [["panda_hand", "c0"], ["panda_hand", "p7"]], "seed": seed}
    require_same_among_all(scene, monkeypatch, "has_many", 1e-9, 1e-6, **asked)


def test_of_what_is_large_a_part_is_met_where_something_moves_too(yard: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    across = drifting("across", np.array([0.55, 0.9, 0.5]), np.array([0.55, -0.6, 0.5]))
    scene = build(messages.Scene("yard", obstacles=[*yard.message.obstacles, across]))
    left = crop_to_reach(of(scene), Deadline()).scene
    assert left.moves
    assert left.resting.obstacles[0].faces == left.at(1.0).obstacles[0].faces < 0.5 * yard.obstacles[0].faces
    require_same_among_all(scene, monkeypatch, "has_large", 1e-3, 2e-4)


def test_what_is_touched_among_very_many_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = shelves(0, 1.8)
    goals = [random_configuration(group("panda"), seed).tolist() for seed in range(30)]
    asked = [{"type": "joints", "positions": dict(zip(READY, goal, strict=True))} for goal in goals]
    impatient = {"allowed_planning_time": 30.0, "optimization_iterations": 0}
    met = [ask(scene, goal=goal, **impatient).status for goal in asked]
    assert any(status.name == "GOAL_IN_COLLISION" and " and c" in status.message for status in met)
    leave_whole(monkeypatch, "has_many")
    assert [ask(scene, goal=goal, **impatient).status for goal in asked] == met
