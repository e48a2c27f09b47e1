"""Plans within path constraints: kept between the samples too, as the bare kinematics see it."""

import math

import msgspec
import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.clearance import contacts_at
from guidefield.collision.world import World
from guidefield.errors import MalformedRequest, UnknownFrame
from guidefield.messages import scene as messages
from guidefield.messages.replies import PlanReply
from guidefield.messages.values import Placement
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.robot.group.reduced_model import select
from guidefield.scene.scene import build
from tests.handlers.motions import Bare, frames_along
from tests.handlers.test_plan import READY, ask as plan
from tests.robots import robot

TURNED = {**READY, "panda_joint1": 1.1}
TIP = "panda_hand"
CORNERS = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
POST = messages.Box(name="post", size=(0.06, 0.06, 0.5), position=(0.42, 0.27, 0.25))


def ask(*obstacles, **request) -> PlanReply:
    return plan({"name": "s", "obstacles": msgspec.to_builtins(obstacles)}, start=READY, **request)


def placements(reply: PlanReply) -> list[pin.SE3]:
    """The hand's placements, densely along the certified curve."""
    return frames_along(reply, TIP, np.linspace(0.0, reply.trajectory.times[-1], 1500))


def hand_at(positions: dict[str, float]) -> pin.SE3:
    bare = Bare(list(positions))
    bare.stand(np.array(list(positions.values())))
    return bare.frame(TIP)


CONE = {"type": "orientation_cone", "frame": TIP, "axis": (0, 0, 1), "target_axis": (0, 0, -1), "half_angle": 0.25}


def test_an_axis_stays_within_its_cone() -> None:
    goal = {"type": "joints", "positions": TURNED}
    free = ask(POST, goal=goal)
    assert free.status.name == "SUCCESS"
    kept = ask(POST, goal=goal, path_constraints=[CONE])
    assert kept.status.name == "SUCCESS", kept.status.message
    assert kept.certificate.collision_free
    angles = [np.arccos(np.clip(-T.rotation[2, 2], -1.0, 1.0)) for T in placements(kept)]
    assert max(angles) <= 0.25


@pytest.mark.parametrize("tolerance", [0.02, 0.005])
def test_the_hand_stays_near_a_plane(tolerance) -> None:
    height = float(hand_at(READY).translation[2])
    plane = {"type": "plane", "frame": TIP, "point": (0, 0, height), "normal": (0, 0, 2.0), "tolerance": tolerance}
    kept = ask(POST, goal={"type": "joints", "positions": TURNED}, path_constraints=[plane])
    assert kept.status.name == "SUCCESS", kept.status.message
    assert max(abs(T.translation[2] - height) for T in placements(kept)) <= tolerance


def test_the_hand_stays_near_a_line() -> None:
    here = hand_at(READY)
    goal = {
        "type": "pose",
        "position": (here.translation + np.array([0.0, 0.25, 0.0])).tolist(),
        "quaternion_xyzw": (1, 0, 0, 0),
    }
    goal["orientation_tolerance"] = (None, None, None)
    line = {"type": "line", "frame": TIP, "point": here.translation.tolist(), "direction": (0, 1, 0), "tolerance": 0.01}
    kept = ask(goal=goal, tip=TIP, path_constraints=[line, CONE])
    assert kept.status.name == "SUCCESS", kept.status.message
    away = [np.linalg.norm((T.translation - here.translation)[[0, 2]]) for T in placements(kept)]
    assert max(away) <= 0.01
    assert max(np.arccos(np.clip(-T.rotation[2, 2], -1.0, 1.0)) for T in placements(kept)) <= 0.25


def test_of_a_poses_configurations_those_are_taken_that_keep_them() -> None:
    here = hand_at(TURNED)
    goal = {"type": "pose", "position": here.translation.tolist(), "quaternion_xyzw": (1, 0, 0, 0)}
    goal["orientation_tolerance"] = (None, None, None)
    kept = ask(goal=goal, tip=TIP, path_constraints=[CONE])  # one in a hundred orientations is within the cone
    assert kept.status.name == "SUCCESS", kept.status.message
    assert max(np.arccos(np.clip(-T.rotation[2, 2], -1.0, 1.0)) for T in placements(kept)) <= 0.25
    sideways = {**goal, "quaternion_xyzw": (0.0, 0.7071067811865476, 0.0, 0.7071067811865476)}
    sideways["orientation_tolerance"] = (0.01, 0.01, 0.01)
    refused = ask(goal=sideways, tip=TIP, path_constraints=[CONE])
    assert refused.status.name == "GOAL_VIOLATES_PATH_CONSTRAINTS", refused.status.message


def test_ends_that_violate_them_are_told_apart() -> None:
    above = {"type": "plane", "frame": TIP, "point": (0, 0, 0.2), "normal": (0, 0, 1), "tolerance": 0.01}
    start = ask(goal={"type": "joints", "positions": TURNED}, path_constraints=[above])
    assert start.status.name == "START_STATE_VIOLATES_PATH_CONSTRAINTS"
    assert start.status.details["frame"] == TIP
    off = 1e3 * start.status.details["value"]
    assert f"`path_constraints[0]`: {TIP!r} is {off:.1f} mm from the plane, 10.0 mm are allowed" in start.status.message
    bent = {**READY, "panda_joint6": 2.2}
    goal = ask(goal={"type": "joints", "positions": bent}, path_constraints=[CONE])
    assert goal.status.name == "GOAL_VIOLATES_PATH_CONSTRAINTS"
    assert goal.status.details["value"] > 0.25
    assert f"the axis of {TIP!r} is {goal.status.details['value']:.4g} rad off" in goal.status.message


def test_constraints_that_make_no_sense_are_refused() -> None:
    goal = {"type": "joints", "positions": TURNED}
    with pytest.raises(UnknownFrame, match="nowhere"):
        ask(goal=goal, path_constraints=[{**CONE, "frame": "nowhere"}])
    with pytest.raises(MalformedRequest, match=r"path_constraints\[0\]\.axis"):
        ask(goal=goal, path_constraints=[{**CONE, "axis": (0, 0, 0)}])
    with pytest.raises(MalformedRequest, match="planner 'guided' makes none"):
        ask(goal=goal, planner="guided", path_constraints=[CONE])


@pytest.mark.parametrize("planes", ["given", "last", "auto"])
@pytest.mark.parametrize("moves", [False, True])
def test_guide_planes_are_crossed_within_constraints(moves: bool, planes: str) -> None:
    """A door between the ends goes up; the hand passes a square beside it, its axis within the cone."""
    here = hand_at({**READY, "panda_joint1": 0.85}).translation
    centre, out = here + np.array([0.0, 0.0, 0.1]), here * (0.08, 0.08, 0.0) / np.linalg.norm(here[:2])
    corners = [centre + a * out + np.array([0.0, 0.0, 0.08 * b]) for a, b in CORNERS]
    square = {"name": "square", "vertices": [corner.tolist() for corner in corners]}
    turned = {"quaternion_xyzw": (0.0, 0.0, math.sin(0.275), math.cos(0.275))}
    below, door, above = (np.array([0.8 * np.cos(0.55), 0.8 * np.sin(0.55), z]).tolist() for z in (-0.7, 0.8, 2.6))
    obstacle = messages.Box(name="door", size=(1.02, 0.02, 1.6), position=below, **turned)
    if moves:
        way = [Placement(position=place, **turned) for place in (door, above)]
        obstacle = msgspec.structs.replace(obstacle, trajectory=messages.ObstacleTrajectory([1.0, 2.0], way))
    obstacles = [obstacle]
    asked = {"goal": {"type": "guide_plane"} if planes == "last" else {"type": "joints", "positions": TURNED}}
    asked["guide_planes"] = "auto" if planes == "auto" else [square]
    kept = ask(*obstacles, tip=TIP, path_constraints=[CONE], limits={"panda_joint1": {"jerk": 500.0}}, **asked)
    assert kept.status.name == "SUCCESS", kept.status.message
    assert kept.certificate.collision_free
    places = placements(kept)
    assert max(np.arccos(np.clip(-T.rotation[2, 2], -1.0, 1.0)) for T in places) <= 0.25
    if planes != "auto":
        offsets = np.array([T.translation - centre for T in places])
        across = np.cross(out, (0.0, 0.0, 1.0)) / np.linalg.norm(out)
        assert np.linalg.norm(offsets[np.abs(offsets @ across) < 2e-3], axis=1).min() < 0.08 * np.sqrt(2.0)
    group = select(robot("panda"), None, TIP, robot("panda").rest, pin.SE3.Identity())
    scene = build(messages.Scene(name="s", obstacles=obstacles))
    motion = Trajectory(*(np.array(getattr(kept.trajectory, name)) for name in ("times", "positions", "velocities")))
    samples = np.linspace(0.0, max(motion.duration, scene.end), 80)
    for now, z in zip(samples.tolist(), motion.evaluate(np.minimum(samples, motion.duration))[0], strict=True):
        assert not contacts_at(World.build(group, scene.at(now)), group.expand_from_local(z)), now
    assert not moves or motion.duration > 1.0, "the door is in the way until then"
