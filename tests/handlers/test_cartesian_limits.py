"""Limits of speed in space as a client meets them: kept by plans and steps, judged by certify, refused by name."""

import numpy as np
import pytest

from guidefield.engine import answer
from guidefield.errors import MalformedRequest, UnknownFrame
from guidefield.messages.replies import PlanReply
from tests.handlers.motions import frames_along
from tests.handlers.test_certify import certify, motion_of
from tests.handlers.test_plan import PATIENT, READY, ask, joints

TIP = {"frame": "panda_hand_tcp", "speed": 0.25}
THERE = {"start": READY, "goal": joints(panda_joint1=1.2, panda_joint4=-1.6), "guide_planes": [], "recording": "off"}


def fastest(reply: PlanReply) -> float:
    """The largest speed of the tip by dense differences of its places [m/s]."""
    times = np.linspace(0.0, reply.trajectory.times[-1], 3001)
    places = [placed.translation for placed in frames_along(reply, "panda_hand_tcp", times)]
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).max() / times[1])


def test_a_plan_keeps_the_speed_of_the_tip_and_is_faster_than_when_it_is_slowed_as_a_whole() -> None:
    free, slow = ask(**THERE), ask(**THERE, cartesian_limits=[TIP])
    assert slow.status.name == "SUCCESS"
    (use,) = slow.cartesian
    assert (use.frame, use.link, use.speed_limit) == ("panda_hand_tcp", None, 0.25)
    assert 0.24 < fastest(slow) <= 0.25
    assert use.speed == pytest.approx(fastest(slow), rel=1e-3)
    assert slow.metrics.duration < 0.9 * free.metrics.duration * fastest(free) / 0.25
    assert not free.cartesian


def test_a_motion_is_judged_by_the_speed_of_a_link_and_of_its_acceleration() -> None:
    free = ask(**THERE)
    slowed = ask(**THERE, cartesian_limits=[{"link": "panda_hand", "speed": 0.3, "acceleration": 0.8}])
    motion = {**motion_of(slowed), "start": READY}
    kept = certify(**motion, cartesian_limits=[{"link": "panda_hand", "speed": 0.3, "acceleration": 0.8}])
    assert kept.status.name == "SUCCESS"
    (use,) = kept.cartesian
    assert use.acceleration <= 0.8
    refused = certify(**motion_of(free), start=READY, cartesian_limits=[{"link": "panda_hand", "speed": 0.3}])
    assert refused.status.name == "INVALID_MOTION_PLAN"
    assert refused.certificate.collision_free
    assert "link 'panda_hand' reaches" in refused.status.message
    assert refused.status.details["limit"] == "cartesian_speed"
    steep = certify(**motion_of(slowed), start=READY, cartesian_limits=[{**TIP, "speed": 9.0, "acceleration": 0.1}])
    assert steep.status.details["limit"] == "cartesian_acceleration"


def test_a_held_object_is_as_slow_as_asked_for() -> None:
    ball = {"type": "sphere", "name": "load", "radius": 0.02, "position": [0, 0, 0.2]}
    asked = {"attached_objects": [{"obstacle": ball, "link": "panda_hand"}], "start": READY}
    asked["cartesian_limits"] = [{"link": "load", "speed": 0.3}]
    made = ask(**{**THERE, **asked})
    (use,) = made.cartesian
    assert (use.link, use.speed_limit) == ("load", 0.3)
    assert 0.29 < use.speed <= 0.3
    assert certify(**motion_of(made), **asked).cartesian == made.cartesian


def test_straight_pieces_are_as_fast_as_they_are() -> None:
    names = ["panda_joint1"]
    motion = {"trajectory": {"times": [0.0, 1.0], "positions": [[0.0], [0.5]]}, "position_names": names}
    limits = [{**TIP, "speed": 0.5, "acceleration": 1e-3}]  # turning alone takes more, and who draws it any
    reply = certify(**motion, start=READY, interpolation="linear", cartesian_limits=limits)
    assert reply.status.name == "SUCCESS"
    (use,) = reply.cartesian
    assert use.speed == pytest.approx(0.5 * 0.307, abs=1e-2)  # of the radius at which it goes round
    assert use.acceleration is None


def test_each_step_keeps_its_own() -> None:
    steps = [
        {"goal": joints(panda_joint1=0.6), "cartesian_limits": [{"frame": "panda_hand_tcp", "speed": 0.1}]},
        {"goal": joints(panda_joint1=1.2), "stop": False, "radius": 0.1},
        {"goal": {"type": "relative", "position": [0, 0, 0.05]}, "linear": True},
        {"goal": joints(panda_joint1=0.0), "cartesian_limits": []},
    ]
    reply = answer(
        {"robot": "panda", "scene": "table", "start": READY, "steps": steps, "cartesian_limits": [TIP], **PATIENT}
    )
    assert reply.status.name == "SUCCESS"
    assert [[use.speed_limit for use in step.cartesian] for step in reply.steps] == [[0.1], [0.25], [0.25], []]
    assert all(use.speed <= use.speed_limit * (1.0 + 1e-6) for step in reply.steps for use in step.cartesian)
    assert reply.steps[0].cartesian[0].speed > 0.09


def test_past_goals_a_motion_is_timed_for_limits_along_its_path(monkeypatch) -> None:
    """Faster than with stops, and than what is slowed down as a whole, or is timed round corners of straight paths."""
    offsets = ([0, 0.1, 0], [0.1, 0, 0], [0, 0, 0.1], [0, -0.15, 0])
    steps = [{"goal": {"type": "relative", "position": by}, "linear": True} for by in offsets]
    past = [*({**one, "stop": False, "radius": 0.08} for one in steps[:-1]), steps[-1]]
    limits = [{**TIP, "acceleration": 1.0}]  # the optimiser knows the speed, timing the acceleration too
    asked = {"robot": "panda", "scene": "table", "start": READY, "recording": "off", "cartesian_limits": limits}
    stopping, passing = (answer({**asked, **PATIENT, "steps": made}) for made in (steps, past))
    monkeypatch.setattr("guidefield.planner.sequence.rounding._retime", lambda *_: None)
    slowed = answer({**asked, **PATIENT, "steps": past})
    assert [one.status.name for one in (stopping, passing, slowed)] == ["SUCCESS"] * 3
    assert fastest(passing) <= 0.25
    assert passing.metrics.duration < 0.998 * slowed.metrics.duration < 0.95 * stopping.metrics.duration


@pytest.mark.parametrize(
    ("fields", "error", "words"),
    [
        ({"cartesian_limits": [{"speed": 0.2}]}, MalformedRequest, "give a `frame` or a `link`, got neither"),
        ({"cartesian_limits": [{**TIP, "link": "panda_hand"}]}, MalformedRequest, "`frame` or a `link`, got both"),
        ({"cartesian_limits": [{"speed": 0.0, "frame": "panda_hand"}]}, MalformedRequest, "cartesian_limits"),
        ({"cartesian_limits": [{"speed": 1e-300, "frame": "panda_hand"}]}, MalformedRequest, "at least 1e-09"),
        ({"cartesian_limits": [{"speed": 0.2, "frame": "nose"}]}, UnknownFrame, "no frame 'nose'"),
        ({"cartesian_limits": [{"speed": 0.2, "link": "nose"}]}, UnknownFrame, "no link 'nose'"),
    ],
)
def test_what_is_not_served_is_refused_by_name(fields, error, words) -> None:
    with pytest.raises(error, match=words):
        ask(**{**THERE, **fields})


@pytest.mark.parametrize("interpolation", ["linear", "cubic", "quintic", "first_order_hold"])
def test_what_a_controller_draws_keeps_them(interpolation) -> None:
    execution = {"interpolation": interpolation, "rate": 125}
    reply = ask(**THERE, cartesian_limits=[TIP], execution=execution)
    assert reply.status.name == "SUCCESS", reply.status
    assert 0.24 < reply.cartesian[0].speed <= 0.25


def test_what_is_too_slow_to_flee_is_told_so() -> None:
    placements = [{"position": [0.8, y, 0.6]} for y in (1.4, -0.2)]
    bar = {"type": "box", "name": "bar", "size": [0.9, 0.1, 1.2]}
    scene = {"name": "b", "obstacles": [{**bar, "trajectory": {"times": [0.6, 2.5], "placements": placements}}]}
    asked = {"robot": "panda", "scene": scene, **THERE, "goal": joints(panda_joint1=-2.0), **PATIENT}
    assert answer(asked).status.name == "SUCCESS"
    slow = answer({**asked, "cartesian_limits": [{**TIP, "speed": 0.01}]})
    assert slow.status.name == "START_STATE_INVALID"
    assert "no way was found that leaves before, where panda_hand_tcp keeps its speed" in slow.status.message
