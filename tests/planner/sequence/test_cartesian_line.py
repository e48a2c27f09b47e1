"""Straight steps and rounded corners: certified straight at dense samples, within radii, unchanged elsewhere."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st
from tests.planner.problems import problem, scene_of, to_configuration
from tests.robots import group

from guidefield.collision.world import World
from guidefield.engine import answer
from guidefield.messages.replies import PlanReply
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.sequence.cartesian_line import CartesianLine, certify_straight
from guidefield.planner.sequence.rounding import CurveByLength, round_corners
from guidefield.planner.sequence.segments import PassedGoal
from guidefield.prove.verdict import Reason
from guidefield.robot.group.kinematics import Kinematics

UR5 = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
TURN = {"type": "relative", "quaternion_xyzw": [0, 0, math.sin(0.25), math.cos(0.25)]}


def step(start: tuple[float, ...], goal: dict[str, Any]) -> PlanReply:
    asked = {"robot": "ur5", "scene": {"name": "e"}, "start": dict(zip(UR5, start, strict=True))}
    return answer({**asked, "steps": [{"goal": goal, "linear": True}]})


@pytest.mark.parametrize("goal", [TURN, {**TURN, "frame": "world"}], ids=["tip", "world"])
def test_a_turn_that_a_limit_stops_names_joint_limit_and_share(goal: dict[str, Any]) -> None:
    upper = 6.28318530718
    # the tool looks straight down: about the world's z the last joint turns the other way
    begin = 6.0 if goal is TURN else -6.0
    reply = step((0.0, -1.57, 1.57, -1.57, -math.pi / 2, begin), goal)
    told, details = reply.status.message, reply.status.details
    assert reply.status.name == "NO_IK_SOLUTION"
    assert details["cause"] == "joint limit"
    assert (details["joint"], details["limits"]) == ("wrist_3_joint", [-upper, upper])
    assert "after 0.283 rad of a turn of 0.500 rad (56.6 %) wrist_3_joint reaches its limit of" in told
    assert details["share"] == pytest.approx((upper - 6.0) / 0.5, abs=1e-3 if goal is not TURN else 1e-8)
    assert abs(reply.path[-1][5]) == pytest.approx(upper, abs=1e-6)


def test_a_line_of_one_joint_ends_exactly_at_its_limit() -> None:
    """A slide along x whose limit is a third of the way: the share is that, in closed form."""
    box = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
    limit = '<limit lower="-0.1" upper="0.2" velocity="1" effort="1"/>'
    joint = (
        f'<joint name="slide" type="prismatic"><parent link="w"/><child link="a"/><axis xyz="1 0 0"/>{limit}</joint>'
    )
    text = f'<robot name="r"><link name="w"/><link name="a">{box}</link>{joint}</robot>'
    goal = {"type": "relative", "position": [0.3, 0, 0]}
    asked = {"robot": {"type": "urdf", "text": text}, "scene": {"name": "e"}, "start": {"slide": 0.1}}
    status = answer({**asked, "steps": [{"goal": goal, "linear": True}]}).status
    assert status.details["share"] == pytest.approx(1.0 / 3.0, abs=1e-8)
    assert status.details["share"] < 1.0
    assert status.message.endswith("mm along the straight way of 300.0 mm (33.3 %) slide reaches its limit of 0.2 m")


def test_a_line_just_beyond_reach_says_so_and_never_that_all_of_it_was_gone() -> None:
    goal = {"type": "relative", "frame": "world", "position": [0.100895, 0, 0]}
    reply = step((0.0, -0.5, 1.0, -0.5, -1.57, 0.0), goal)
    details = reply.status.details
    assert details["cause"] == "reach"
    assert 0.98 < details["share"] < 1.0
    assert (
        "99.8 mm along the straight way of 100.9 mm (99.0 %) the way leaves the robot's reach" in reply.status.message
    )
    last = np.array(reply.path[-1])
    assert abs(last[2]) < 0.05  # the elbow is all but stretched there


SEEDS = st.integers(0, 2**32 - 1)


def off(line: CartesianLine, placement: pin.SE3) -> tuple[float, float]:
    """Distance from the segment, and angle from the even turning there, by formulas of their own [m, rad]."""
    along = line.end.translation - line.begin.translation
    share = 0.0
    if along @ along > 0.0:
        share = float((placement.translation - line.begin.translation) @ along / (along @ along))
    inside = float(np.clip(share, 0.0, 1.0))
    nearest = line.begin.translation + inside * along
    even = line.begin.rotation @ pin.exp3(share * pin.log3(line.begin.rotation.T @ line.end.rotation))
    cosine = 0.5 * (np.trace(even.T @ placement.rotation) - 1.0)
    return float(np.linalg.norm(placement.translation - nearest)), float(np.arccos(np.clip(cosine, -1.0, 1.0)))


@given(SEEDS, st.sampled_from(["panda", "ur5"]), st.floats(-3.0, -0.5))
def test_what_is_certified_is_within_its_tolerances_at_dense_samples(seed: int, name: str, size: float) -> None:
    rng = np.random.default_rng(seed)
    arm = group(name)
    kinematics, span = Kinematics(arm), 10.0**size
    middle = arm.to_local(arm.random(rng))
    direction = rng.standard_normal(arm.nv)
    straight = middle + np.linspace(-1.0, 1.0, 4)[:, None] * span * direction / np.linalg.norm(direction)
    curve = straight + 0.02 * span * rng.standard_normal(straight.shape)
    ends = [kinematics.frame_placement(arm.expand_from_local(z), arm.tip_id) for z in (curve[0], curve[-1])]
    t = np.linspace(0.0, 1.0, 101)[:, None]
    samples = sum(c * (1 - t) ** (3 - k) * t**k * curve[k] for k, c in enumerate((1, 3, 3, 1)))
    placed = [kinematics.frame_placement(arm.expand_from_local(z), arm.tip_id) for z in samples]
    loose = CartesianLine(arm.tip, *ends, 1.0, 3.0)
    worst = np.max([off(loose, one) for one in placed], axis=0)
    turns = World.build(arm, scene_of()).bodies.turns
    for factor, free in ((0.9, False), (1.3, True)):
        tolerances = factor * worst + 1e-6
        line = CartesianLine(arm.tip, *ends, *tolerances.tolist())
        verdict = certify_straight(line, arm, turns, curve[None])
        assert verdict.free == free or (free and _beyond(line, placed))
        if not verdict.free:
            assert verdict.reason is Reason.PATH_CONSTRAINT


def _beyond(line: CartesianLine, placed: list[pin.SE3]) -> bool:
    """Whether the frame is turned from the line's own direction beyond an end, where the oracle's share goes on."""
    return any(not 0.0 <= line.share(one) <= 1.0 for one in placed)


def test_turning_on_the_spot_may_take_its_time() -> None:
    """The last joint turns alone: the tip stays, and the pace of the turning is free."""
    arm = group("panda")
    kinematics, z = Kinematics(arm), arm.to_local(arm.random(np.random.default_rng(3)))
    last = z.copy()
    last[-1] = z[-1] + 0.5
    ends = [kinematics.frame_placement(arm.expand_from_local(one), arm.tip_id) for one in (z, last)]
    line = CartesianLine(arm.tip, *ends, 1e-4, 1e-3)
    turns = World.build(arm, scene_of()).bodies.turns
    shares = np.array([0.0, 0.7, 0.8, 1.0])[:, None]
    assert certify_straight(line, arm, turns, (z + shares * (last - z))[None]).free
    aside = z + shares * (last - z)
    aside[1, 3] += 1e-2
    refused = certify_straight(line, arm, turns, aside[None])
    assert refused.reason is Reason.PATH_CONSTRAINT
    assert refused.parameter == pytest.approx(0.0, abs=0.6)


def test_a_refusal_names_the_first_piece_that_leaves_the_line() -> None:
    """The elbow moves aside within the first piece, so that the second begins beside the line."""
    arm = group("panda")
    kinematics, z = Kinematics(arm), arm.to_local(arm.random(np.random.default_rng(3)))
    last = z.copy()
    last[-1] = z[-1] + 0.5
    ends = [kinematics.frame_placement(arm.expand_from_local(one), arm.tip_id) for one in (z, last)]
    aside = z + np.array([0.0, 0.5, 1.0])[:, None] * (last - z)
    aside[1:, 3] += 1e-2
    pieces = np.stack([aside[:-1], aside[1:]], axis=1)
    line = CartesianLine(arm.tip, *ends, 1e-4, 1e-3)
    refused = certify_straight(line, arm, World.build(arm, scene_of()).bodies.turns, pieces)
    assert refused.piece == 0
    assert 0.0 < refused.parameter < 0.1


def straight(begin: np.ndarray, end: np.ndarray) -> Trajectory:
    """A straight motion from rest to rest."""
    return Trajectory(np.array([0.0, 1.0]), np.array([begin, end]), np.zeros((2, len(begin))))


def beside(line: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Distances of places (k, nv) from a segment (2, nv)."""
    along = line[1] - line[0]
    shares = np.clip((places - line[0]) @ along / (along @ along), 0.0, 1.0)
    return np.linalg.norm(places - line[0] - shares[:, None] * along, axis=1)


@given(SEEDS, st.floats(0.005, 1.0))
def test_a_corner_leaves_its_lines_within_the_radius_and_along_them(seed: int, radius: float) -> None:
    rng, arm = np.random.default_rng(seed), group("ur5")
    corners = np.cumsum(rng.uniform(-1.0, 1.0, (4, arm.nv)), axis=0)
    asked = problem(arm, scene_of(), goal=to_configuration(corners[1], arm), q_start=arm.from_local(corners[0]))
    goals = [PassedGoal(asked, z, radius) for z in corners[1:3]]
    curves = [CurveByLength(straight(*line)) for line in pairwise(corners)]
    found = round_corners(curves, goals, [radius, radius], 0.05)
    assert np.array_equal(found.path[[0, -1]], corners[[0, -1]])
    aside = np.min([beside(np.array(line), found.path) for line in pairwise(corners)], axis=0)
    near = np.min([np.abs(found.path - z).max(axis=1) for z in corners[1:3]], axis=0)
    assert aside[near > radius].max(initial=0.0) < 1e-9
    for z, (begin, end) in zip(corners[1:3], found.corners, strict=True):
        bend = found.path[begin : end + 1]
        assert np.abs(bend - z).max() <= radius
        assert np.linalg.norm(bend - z, axis=1).min() < min(np.linalg.norm(bend[[0, -1]] - z, axis=1))
        for line, chord in ((corners, bend[:2]), (corners, bend[-2:])):
            lines = [beside(np.array(one), chord) for one in pairwise(line)]
            assert min(one.max() for one in lines) < 0.05 * np.linalg.norm(chord[1] - chord[0])
