"""Derived guide planes: where they stand, that they are free, and that the seed's scenes are solved through them."""

import time

import msgspec
import numpy as np
import pinocchio as pin
import pytest

from guidefield.errors import Status
from guidefield.handlers.plan import answer_plan
from guidefield.messages import codec, scene as messages
from guidefield.planner.guide.auto_planes import (
    LONGEST_RAY,
    derive_planes,
    find_free_section,
    find_tip_path,
    is_in_passage,
    measure_point_clearances,
)
from guidefield.planner.guide.guide import ATTEMPTS, cross_plane
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.scene import build
from guidefield.stores import scenes
from tests.examples import example
from tests.planner.problems import library_scene, problem, scene_of, seed_problem
from tests.robots import robot

NINE = (
    *("seed_a_gates", "seed_b_tapered", "seed_c_blocked", "seed_d_passage_3", "seed_d_passage_6"),
    *("seed_e_L_3", "seed_e_L_6", "seed_e_S_3", "seed_e_S_6"),
)
WALL = [
    messages.Box(name="left", size=(0.1, 1.0, 2.0), position=(0.5, 0.7, 0.0)),
    messages.Box(name="right", size=(0.1, 1.0, 2.0), position=(0.5, -0.7, 0.0)),
    messages.Box(name="above", size=(0.1, 0.4, 0.8), position=(0.5, 0.0, 0.6)),
    messages.Box(name="below", size=(0.1, 0.4, 0.8), position=(0.5, 0.0, -0.6)),
]
"""A window of 0.4 by 0.4 m about (0.5, 0, 0)."""


def test_a_section_is_convex_free_and_as_large_as_the_window() -> None:
    tables = distance_tables(scene_of(*WALL))
    across = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    corners = find_free_section(tables, np.array([0.5, 0.05, 0.0]), across)
    inside = np.array([0.5, 0.05, 0.0]) + 0.97 * corners @ across
    assert measure_point_clearances(tables, inside).min() > 0.0
    x, y = corners.T
    area = 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))
    assert 0.8 * 0.16 < area <= 0.16 + 1e-6
    edges = np.roll(corners, -1, axis=0) - corners
    after = np.roll(edges, -1, axis=0)
    assert np.all(edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0] > -1e-9)
    open_air = find_free_section(tables, np.array([-3.0, 0.0, 0.0]), across)
    np.testing.assert_allclose(np.linalg.norm(open_air, axis=1), LONGEST_RAY)


@pytest.mark.parametrize("title", ["seed_d_passage_3", "seed_d_passage_6"])
def test_a_goal_inside_a_tube_is_reached_through_the_tube(title: str) -> None:
    """The tube is open at both ends, and the goal next to the far one: outside there is more room, and a way in."""
    made = seed_problem(title)
    planes, tables = derive_planes(made, made.guide_planes[-1]), distance_tables(made.scene)
    assert planes
    assert all(is_in_passage(tables, plane.centroid, plane.normal[None]) for plane in planes)
    places = [plane.centroid[0] for plane in (*planes, made.guide_planes[-1])]
    assert places == sorted(places), "the tube leads along x"


@pytest.mark.parametrize("title", NINE)
def test_the_seeds_scenes_are_solved_with_the_goal_plane_alone(title: str) -> None:
    made = seed_problem(title)
    goal = made.guide_planes[-1]
    planes = derive_planes(made, goal)
    assert planes
    assert [plane.name for plane in planes] == [f"GP-auto-{i}" for i in range(1, len(planes) + 1)]
    tables, q = distance_tables(made.scene), made.q_start
    for index, plane in enumerate((*planes, goal)):
        if index < len(planes):
            inner = plane.centroid + 0.9 * (plane.vertices - plane.centroid)
            assert measure_point_clearances(tables, np.vstack([inner, plane.centroid])).min() > 0.0
        crossing = cross_plane(made, q, plane, index, ATTEMPTS["projected"](made.group))
        assert crossing.status is Status.SUCCESS, crossing.message
        q = crossing.path[-1]


def ask(title: str, **changes):
    request = codec.decode_request(msgspec.json.decode(example(title)) | changes)
    scene = library_scene(request.scene)
    return answer_plan(request, robot(request.robot), scene, run_id="r", received=time.monotonic())


def test_a_goal_next_to_the_start_needs_no_planes() -> None:
    made = seed_problem(NINE[0])
    tip = made.kinematics.tip_position(made.group.expand_from_local(made.z_start))
    assert derive_planes(made, tip + np.array([0.0, 0.0, 0.01])) == ()


@pytest.mark.parametrize("thickness", [0.001, 0.015])
def test_no_path_leads_through_a_sheet_to_a_goal_next_to_the_start(thickness: float) -> None:
    """It is thinner than the grid is fine; the thick one reaches the goal."""
    sheet = messages.Box(name="sheet", size=(thickness, 2.0, 2.0), position=(0.005, 0.0, 0.0))
    tables, goal = distance_tables(build(messages.Scene("sheet", obstacles=[sheet]))), np.array([0.01, 0.0, 0.0])
    assert find_tip_path(tables, np.array([-0.01, 0.0, 0.0]), goal, 0.05, np.zeros(3), np.inf) is None
    assert find_tip_path(tables, np.array([-0.05, 0.0, 0.0]), goal - 0.045, 0.05, np.zeros(3), np.inf) is not None


def test_a_tip_without_a_body_finds_a_path() -> None:
    tables = distance_tables(build(messages.Scene("wall", obstacles=WALL)))
    path = find_tip_path(tables, np.zeros(3), np.array([1.0, 0.0, 0.0]), 0.0, np.zeros(3), np.inf)
    assert path.clearances.min() > 0.1


def test_a_reply_names_them_and_they_can_be_sent_again() -> None:
    reply = ask("seed_e_L_3", guide_planes="auto")
    assert reply.status.name == "SUCCESS"
    assert [plane.name for plane in reply.guide_planes[:-1]] == [
        f"GP-auto-{i}" for i in range(1, len(reply.guide_planes))
    ]
    assert reply.guide_planes[-1].name == "GP3"
    assert reply.stages[0].name == "guide"
    assert "derived" in reply.stages[0].outcome
    again = ask("seed_e_L_3", guide_planes=msgspec.to_builtins(reply.guide_planes))
    assert again.path == reply.path


@pytest.mark.parametrize(("kind", "moves"), [("joints", False), ("pose", False), ("joints", True), ("pose", True)])
def test_goals_beyond_the_planes_are_reached_through_derived_ones(kind: str, moves: bool) -> None:
    """The goal is where a plan through a window ended, told as a configuration and as a pose of the tip.

    What moves is a ball that flies through the window to where the robot isn't.
    """
    made = problem("panda", "wall_with_window")
    q = made.q_start
    for index, plane in enumerate(made.guide_planes):
        q = cross_plane(made, q, plane, index, ATTEMPTS["projected"](made.group)).path[-1]
    tip = made.kinematics.frame_placement(q, made.group.tip_id)
    values = {
        joint.name: q[joint.idx_q : joint.idx_q + joint.nq].tolist() if joint.nq > 1 else float(q[joint.idx_q])
        for joint in made.group.joints
    }
    goal = {"type": "joints", "positions": values}
    if kind == "pose":
        quaternion = pin.Quaternion(tip.rotation).normalized().coeffs().tolist()
        goal = {"type": "pose", "position": tip.translation.tolist(), "quaternion_xyzw": quaternion}
    scene = msgspec.to_builtins(scenes.read_packaged("wall_with_window"))
    if moves:
        x, y, z = made.guide_planes[0].centroid.tolist()
        placements = [{"position": [x, y, z]}, {"position": [x + 0.8, y, z + 0.8]}]
        flight = {"times": [0.5, 1.5], "placements": placements}
        scene["obstacles"] += [
            {"type": "sphere", "name": "ball", "radius": 0.05, "position": [x, y, z], "trajectory": flight}
        ]
    changes = {"scene": scene, "guide_planes": "auto", "planner": "auto", "goal": goal}
    request = codec.decode_request(msgspec.json.decode(example("door")) | changes)
    built = build(request.scene)
    assert built.moves == moves
    reply = answer_plan(request, robot(request.robot), built, run_id="r", received=time.monotonic())
    assert reply.status.name == "SUCCESS", reply.status
    assert reply.certificate.collision_free
    names = [plane.name for plane in reply.guide_planes]
    assert names
    assert names == [f"GP-auto-{i}" for i in range(1, len(names) + 1)]
    assert reply.stages[0].outcome == f"derived {len(names)} guide planes"


def test_a_pose_in_a_tube_is_looked_for_from_where_the_planes_lead() -> None:
    made = seed_problem("seed_e_L_3")
    q = made.q_start
    for index, plane in enumerate(made.guide_planes):
        q = cross_plane(made, q, plane, index, ATTEMPTS["projected"](made.group)).path[-1]
    tip = made.kinematics.frame_placement(q, made.group.tip_id)
    quaternion = pin.Quaternion(tip.rotation).normalized().coeffs().tolist()
    goal = {"type": "pose", "position": tip.translation.tolist(), "quaternion_xyzw": quaternion}
    options = {"goal": goal, "allowed_planning_time": 60.0}
    reply = ask("seed_e_L_3", guide_planes="auto", planner="auto", **options)
    assert reply.status.name == "SUCCESS", reply.status
    assert reply.certificate.collision_free
    assert "searched for from where" in reply.stages[1].outcome
    end = made.kinematics.frame_placement(made.group.part_of(np.array(reply.path[-1])), made.group.tip_id)
    assert np.linalg.norm(end.actInv(tip).translation) < 1e-3
    assert np.linalg.norm(pin.log3(end.actInv(tip).rotation)) < 1e-2


def test_where_there_is_no_path_the_reply_says_so() -> None:
    scene = msgspec.to_builtins(scenes.read_packaged("seed_e_L_3"))
    ends = [(1.2, 0.6, 0.0), (1.2, 1.6, 0.0)]
    scene["obstacles"] += [
        {"type": "box", "name": f"plug{i}", "size": [0.3, 0.02, 0.3], "position": at} for i, at in enumerate(ends)
    ]
    request = codec.decode_request(
        msgspec.json.decode(example("seed_e_L_3")) | {"guide_planes": "auto", "scene": scene}
    )
    made = build(request.scene)
    reply = answer_plan(request, robot(request.robot), made, run_id="r", received=time.monotonic())
    assert reply.status.name == "STUCK_IN_MINIMUM"
    assert any("no guide planes could be derived" in warning for warning in reply.warnings)
