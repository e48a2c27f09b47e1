"""Plans with steps that are passed: how near, without a stop, on their paths elsewhere, within limits, free."""

import json
import math
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin
import pytest

from guidefield.messages.replies import PlanReply
from guidefield.messages.scene import Scene
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import build
from tests.examples import example
from tests.handlers.motions import Bare, distance, states
from tests.handlers.test_sequence import PASS, ask, joints
from tests.robots import robot

ARM = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
BENT = dict(zip(ARM, (0.0, -1.57, 1.57, -1.57, -1.57, 0.0), strict=True))
OUT, ASIDE = BENT | {"elbow_joint": 1.0, "wrist_1_joint": -1.2}, BENT | {"shoulder_pan_joint": 0.8, "elbow_joint": 1.1}
EMPTY = {"name": "empty"}


def planned(steps: list[dict[str, Any]], scene: dict[str, Any] = EMPTY, **fields: Any) -> PlanReply:
    reply = ask(steps, "ur5", scene, start=BENT, **fields)
    assert reply.status.name == "SUCCESS", reply.status.message
    assert reply.certificate.covers == "trajectory"
    assert all(step.certificate.collision_free for step in reply.steps)
    return reply


def obstacles_of(scene: dict[str, Any]) -> tuple[Obstacle, ...]:
    return build(msgspec.convert(scene, Scene)).obstacles


def at(reply: PlanReply, moment: float) -> np.ndarray:
    return states(reply, np.array([moment]))[0]


def speed(reply: PlanReply, moment: float) -> float:
    return float(np.abs(reply.trajectory.velocities[reply.trajectory.times.index(moment)]).max())


def duration(reply: PlanReply) -> float:
    return reply.metrics.duration


@pytest.mark.parametrize("jerk", [None, 200.0])
def test_a_goal_of_joints_is_passed_within_its_radius_and_limits(jerk: float | None) -> None:
    fields = {"limits": {name: {"acceleration": 4.0, "jerk": jerk} for name in ARM}}
    way = [joints(**OUT) | PASS | {"radius": 0.2}, joints(**ASIDE)]
    reply, stopped = planned(way, **fields), planned([joints(**OUT), joints(**ASIDE)], **fields)
    passed, last = reply.steps
    away = np.abs(at(reply, passed.end) - [OUT[name] for name in reply.position_names]).max()
    assert passed.passed == pytest.approx(away, abs=1e-9)
    assert 0.0 < away <= 0.2
    assert last.passed is None
    assert speed(reply, passed.end) > 0.1
    assert duration(reply) < duration(stopped)
    assert reply.warnings == stopped.warnings
    within_limits(reply, 4.0, jerk)


@pytest.mark.parametrize("opens", [0.2, 1.5])
def test_a_goal_is_passed_when_nothing_that_moves_is_met(opens: float) -> None:
    """A door stands between the two goals until it rises."""
    turned = {"quaternion_xyzw": [0.0, 0.0, math.sin(0.225), math.cos(0.225)]}
    places = [{"position": [0.75 * math.cos(0.45), 0.75 * math.sin(0.45), z], **turned} for z in (0.45, 1.9)]
    rises = {"times": [opens, opens + 1.0], "placements": places}
    door = {"type": "box", "name": "door", "size": [0.9, 0.02, 0.9], "trajectory": rises}
    scene = {"name": "door", "obstacles": [door]}
    way = [joints(**OUT) | PASS | {"radius": 0.2}, joints(**ASIDE)]
    reply, stopped = planned(way, scene), planned([joints(**OUT), joints(**ASIDE)], scene)
    passed = reply.steps[0]
    assert 0.0 < passed.passed <= 0.2
    assert speed(reply, passed.end) > 0.1
    assert opens < duration(reply) < duration(stopped)
    bare, (obstacle,) = Bare(reply.position_names, "ur5"), obstacles_of(scene)
    for moment in np.linspace(0.0, max(duration(reply), opens + 1.0), 150).tolist():
        bare.stand(at(reply, min(moment, duration(reply))))
        there = obstacle.placement_at(moment)
        assert all(distance(shape, here, obstacle.shape, there) > 0.0 for _, shape, here in bare.bodies()), moment


def within_limits(reply: PlanReply, acceleration: float, jerk: float | None) -> None:
    """Every Hermite piece, by its own polynomial: its velocity's extrema, its acceleration's ends, its jerk."""
    assert reply.trajectory is not None
    t, p, v = (np.array(getattr(reply.trajectory, name)) for name in ("times", "positions", "velocities"))
    h, most = np.diff(t)[:, None], 1.0 + 1e-9
    mean = np.diff(p, axis=0) / h
    first, last = (6 * mean - 4 * v[:-1] - 2 * v[1:]) / h, (2 * v[:-1] + 4 * v[1:] - 6 * mean) / h
    assert max(np.abs(first).max(), np.abs(last).max()) <= acceleration * most
    tops = np.array([robot("ur5").joint(name).velocity[0] for name in reply.position_names])
    turning = np.clip(np.divide(-first, last - first, out=np.zeros_like(first), where=last != first), 0.0, 1.0)
    inner = v[:-1] + h * turning * (first + 0.5 * turning * (last - first))
    assert (np.maximum(np.abs(inner), np.abs(v[1:])) <= tops * most).all()
    if jerk is not None:
        assert np.abs((last - first) / h).max() <= jerk * most


@pytest.mark.parametrize("jerk", [None, 50.0])
def test_straight_steps_are_straight_but_for_their_corners(jerk: float | None) -> None:
    request = json.loads(example("rounded"))
    fields: dict[str, Any] = {"start": request["start"], "max_velocity_scaling_factor": 0.5}
    fields["limits"] = {name: {"acceleration": 4.0, "jerk": jerk} for name in ARM}
    reply = ask(request["steps"], "ur5", request["scene"], **fields)
    assert reply.status.name == "SUCCESS", reply.status.message
    corners = np.array([(0.35, -0.12), (0.35, 0.12), (0.51, 0.12), (0.51, -0.12), (0.35, -0.12)])
    bare, obstacles = Bare(reply.position_names, "ur5"), obstacles_of(request["scene"])
    for step, one, other in zip(reply.steps[1:5], corners, corners[1:], strict=False):
        for moment in np.linspace(step.begin, step.end, 25):
            bare.stand(at(reply, float(moment)))
            tip = bare.frame("tool0")
            spot, along = tip.translation[:2], (other - one) / np.linalg.norm(other - one)
            aside, turned = (spot - one) @ (-along[1], along[0]), pin.log3(np.diag((1.0, -1.0, -1.0)) @ tip.rotation)
            if min(np.linalg.norm(corner - spot) for corner in (one, other)) > 0.05:
                assert abs(aside) < 1.2e-3
                assert np.linalg.norm(turned) < 1.2e-2
                assert abs(tip.translation[2] - 0.1) < 1.2e-3
            for link, shape, there in bare.bodies():
                assert all(distance(shape, there, o.shape, o.placement) > 0.0 for o in obstacles), link
    for step, corner in zip(reply.steps[1:4], corners[1:], strict=False):
        bare.stand(at(reply, step.end))
        assert step.passed is not None
        away = np.linalg.norm(bare.frame("tool0").translation - (*corner, 0.1))
        assert away == pytest.approx(step.passed, abs=1e-3)
        assert away < 0.05
        assert speed(reply, step.end) > 0.1
    stopped = [step | {"stop": True} for step in request["steps"]]
    whole = ask(stopped, "ur5", request["scene"], **fields)
    assert duration(reply) < 0.95 * duration(whole)
    within_limits(reply, 4.0, jerk)


def test_a_corner_that_would_come_too_close_is_rounded_more_tightly() -> None:
    """A ball beside the corner: with stops the robot keeps farther from it than where it cuts the corner.

    Nothing is optimised: an optimised motion goes round the ball.
    """
    ball = {"type": "sphere", "name": "ball", "radius": 0.01, "position": [0.4, 0.07, 0.07]}
    there, (begin, side, across) = {"name": "mine", "obstacles": [ball]}, json.loads(example("rounded"))["steps"][:3]
    wide = [begin, side | {"radius": 0.1}, across | {"stop": True}]
    found: dict[str, Any] = {"optimization_iterations": 0}
    stopped, free = planned([begin, side | {"stop": True}, wide[-1]], there, **found), planned(wide, there, **found)
    kept, cut = nearest(stopped), nearest(free)
    assert cut < kept - 2e-3
    asked = 0.5 * (kept + cut)
    tight = planned(wide, there, min_clearance=asked, **found)
    assert tight.steps[1].passed < 0.7 * free.steps[1].passed
    bare, (obstacle,) = Bare(tight.position_names, "ur5"), obstacles_of(there)
    for moment in np.linspace(tight.steps[1].begin, duration(tight), 100):
        bare.stand(at(tight, float(moment)))
        for link, shape, placed in bare.bodies():
            assert distance(shape, placed, obstacle.shape, obstacle.placement) > asked, link


def nearest(reply: PlanReply) -> float:
    figures = [step.clearance for step in reply.steps[1:]]
    return min(one.minimum for one in figures if one is not None and one.minimum is not None)


def test_the_slower_of_two_steps_is_minded_past_their_goal() -> None:
    slow = joints(**ASIDE) | {"max_velocity_scaling_factor": 0.1}
    reply = planned([joints(**OUT) | PASS, slow])
    tops = [0.1 * robot("ur5").joint(name).velocity[0] for name in reply.position_names]
    since = reply.trajectory.times.index(reply.steps[0].end)
    assert (np.abs(reply.trajectory.velocities[since:]).max(axis=0) <= np.array(tops) * (1.0 + 1e-9)).all()


def test_a_straight_line_that_turns_is_passed() -> None:
    """The tip turns by half a radian about its own axis while it goes to the side."""
    turned = {"quaternion_xyzw": [0.0, 0.0, np.sin(0.25), np.cos(0.25)]}
    side = {"linear": True, "goal": {"type": "relative", "position": [0.0, 0.15, 0.0], **turned}}
    out = {"linear": True, "goal": {"type": "relative", "frame": "world", "position": [0.0, 0.0, -0.12]}}
    fields = {"limits": {name: {"jerk": 50.0} for name in ARM}}
    reply, stopped = planned([side | PASS | {"radius": 0.04}, out], **fields), planned([side, out], **fields)
    assert duration(reply) < duration(stopped)
    assert speed(reply, reply.steps[0].end) > 0.0
    within_limits(reply, np.inf, 50.0)


def test_goals_within_large_radii_are_passed_in_their_order() -> None:
    request = json.loads(example("rounded"))
    steps = [step | {"radius": 50.0} if step.get("stop") is False else step for step in request["steps"]]
    reply = ask(steps, "ur5", request["scene"], start=request["start"])
    assert reply.status.name == "SUCCESS", reply.status.message
    spans = [time for step in reply.steps for time in (step.begin, step.end)]
    assert spans == sorted(spans)
