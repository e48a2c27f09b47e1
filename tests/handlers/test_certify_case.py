"""A certify request as the referee reads it: both certifiers say the same of it."""

import functools
import json
import time
from typing import Any

import numpy as np
import pytest

from guidefield import case_file
from guidefield.handlers.certify import answer_certify, motions_of
from guidefield.messages import codec
from guidefield.messages.replies import to_plain_data
from guidefield.referee.case import Answer, Verdict
from guidefield.referee.judge import judge
from guidefield.referee.loading import case_of
from guidefield.scene.scene import build
from tests.handlers.test_plan import READY, ask, joints
from tests.robots import robot

NAMES = list(READY)
HOME = np.array(list(READY.values()))
POST = {"type": "sphere", "name": "post", "radius": 0.1, "position": [0.25, 0.35, 0.6]}
FLOOR = {"type": "half_space", "name": "floor", "normal": [0, 0, 1], "offset": -0.05}


@functools.cache
def planned() -> dict[str, Any]:
    reply = ask(start=READY, goal=joints(panda_joint1=0.6, panda_joint4=-1.6), guide_planes=[])
    return {"trajectory": to_plain_data(reply.trajectory), "position_names": reply.position_names}


def both(obstacles: list[dict[str, Any]], **request: Any) -> tuple[str, list[Verdict]]:
    """What the certificate and the referee say of a motion of a Panda."""
    scene = {"name": "s", "obstacles": obstacles}
    message = codec.decode_request({"type": "certify", "robot": "panda", "scene": scene, "allowed_time": 60, **request})
    built = build(message.scene)
    reply = answer_certify(message, robot("panda"), built, run_id="run", received=time.monotonic())
    cases = json.loads(json.dumps(case_file.make_cases(*motions_of(message, robot("panda"), built))))
    return reply.status.name, [judge(case_of(case)) for case in cases]


def path(*steps: Any) -> dict[str, Any]:
    return {"path": [(HOME + step).tolist() for step in steps], "position_names": NAMES}


def test_our_own_plan_is_free_to_both() -> None:
    status, verdicts = both([FLOOR], **planned())
    assert status == "SUCCESS"
    assert [verdict.answer for verdict in verdicts] == [Answer.FREE]


@pytest.mark.parametrize(
    ("limits", "about"),
    [
        ({"panda_joint1": {"velocity": 0.3}}, ("panda_joint1", "velocity")),
        ({"panda_joint4": {"acceleration": 0.5}}, ("panda_joint4", "acceleration")),
        ({"panda_joint1": {"jerk": 1.0}}, ("panda_joint1", "jerk")),
    ],
)
def test_limits_of_a_request_are_limits_to_both(limits, about) -> None:
    status, (verdict,) = both([FLOOR], **planned(), limits=limits)
    assert status == "INVALID_MOTION_PLAN"
    assert (verdict.answer, verdict.finding.about) == (Answer.BEYOND_LIMIT, about)


def test_waypoints_samples_and_straight_samples() -> None:
    turn = np.array([1.4, 0, 0, 0, 0, 0, 0])
    for request, name, answer in (
        (path(0.0, 0.1), "SUCCESS", Answer.FREE),
        (path(0.0, turn), "INVALID_MOTION_PLAN", Answer.CONTACT),
    ):
        samples = {"position_names": NAMES, "trajectory": {"positions": request["path"], "times": [0.0, 4.0]}}
        for asked in (request, samples, samples | {"interpolation": "linear"}):
            status, (verdict,) = both([POST], **asked)
            assert (status, verdict.answer) == (name, answer)


def test_a_path_constraint_is_one_to_both() -> None:
    upright = {"type": "orientation_cone", "frame": "panda_hand_tcp", "axis": [0, 0, 1], "target_axis": [0, 0, -1]}
    tilt = np.array([0, 0, 0, 0, 0, 0.3, 0])
    for half_angle, name, answer in (
        (0.31, "SUCCESS", Answer.FREE),
        (0.29, "INVALID_MOTION_PLAN", Answer.CONSTRAINT_BROKEN),
    ):
        status, (verdict,) = both([], **path(0.0, tilt), path_constraints=[upright | {"half_angle": half_angle}])
        assert (status, verdict.answer) == (name, answer)


def test_a_moving_obstacle_is_judged_at_its_time() -> None:
    stops = [{"position": [0.35, -1.0, 0.55]}, {"position": [0.35, 1.0, 0.55]}]
    for times, name, answer in (
        ([0.0, 0.4], "INVALID_MOTION_PLAN", Answer.CONTACT),
        ([8.0, 9.0], "SUCCESS", Answer.FREE),
    ):
        ball = POST | {"trajectory": {"times": times, "placements": stops}}
        status, (verdict,) = both([ball], **planned())
        assert (status, verdict.answer) == (name, answer)


def test_a_contact_that_is_left_is_free_from_then_on() -> None:
    block = {"type": "box", "name": "block", "size": [0.2, 0.2, 0.2]}
    places = [block | {"position": [0.31, y, 0.6]} for y in np.arange(0.3, 0.1, -0.004)]
    reach = next(one for one in places if both([one], **path(0.0, 1e-9))[0] != "SUCCESS")
    away = np.array([-0.5, 0, 0, 0, 0, 0, 0])
    status, (verdict,) = both([reach], **path(0.0, away))
    assert (status, verdict.answer) == ("INVALID_MOTION_PLAN", Answer.CONTACT)
    status, verdicts = both([reach], **path(0.0, away), leave_start_contact=True)
    assert status == "SUCCESS"
    assert [verdict.answer for verdict in verdicts] == [Answer.FREE, Answer.FREE]
    excused = [pair for pair in verdicts[0].left_out if "block" in pair and "touch" in pair[2]]
    assert excused
    assert not any("block" in pair and "touch" in pair[2] for pair in verdicts[1].left_out)
