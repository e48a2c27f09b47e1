"""The referee's file: what it says is what is judged, and what is wrong with one is told."""

import json
import lzma
import subprocess
import sys
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from guidefield import case_file
from guidefield.messages import scene as messages
from guidefield.messages.requests import UrdfText
from guidefield.messages.values import Placement
from guidefield.referee import loading
from guidefield.referee.case import Answer
from guidefield.referee.judge import judge
from guidefield.referee.loading import FORMATS, UnusableFile, case_of, load
from guidefield.referee.shapes import ears, is_divided
from guidefield.robot.group.reduced_model import select
from tests.collision.scenery import box, world_of
from tests.referee.cases import read, straight
from tests.robots import box_arm, group, grouped, robot


def told() -> dict[str, Any]:
    planned = grouped(box_arm("y", 1), "l1")
    (case,) = case_file.make_cases(straight(world_of(planned, [box("b", (0.1, 0.1, 0.1), (1, 0, 0))]), [[0.0], [0.3]]))
    return json.loads(json.dumps(case))


def _follow(case: dict[str, Any], followed: str) -> None:
    """Let j1 of a case follow a joint, and a second one follow j1."""
    second = (
        '<link name="l2"/><joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><axis xyz="0 1 0"/>'
        '<mimic joint="j1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint></robot>'
    )
    law = f'<mimic joint="{followed}"/><limit lower="-2"'
    case["robot"]["urdf"] = case["robot"]["urdf"].replace('<limit lower="-2"', law).replace("</robot>", second)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda case: case.pop("motion"), "'motion' is missing"),
        (lambda case: case["robot"].pop("urdf"), "'urdf' is missing"),
        (lambda case: case["motion"].update(positions=[[0.0, 1.0]]), "rows of 1 numbers"),
        (lambda case: case["motion"].update(positions=[]), "rows of 1 numbers"),
        (lambda case: case["motion"].update(times=[1.0, 0.5]), "must increase"),
        (lambda case: case["motion"].update(velocities=[[0.0], [0.0]]), "need times"),
        (lambda case: case["motion"].update(positions=[[0.0], [float("nan")]]), "finite"),
        (lambda case: case["motion"].update(joints=["elbow"]), "'elbow' is missing"),
        (lambda case: case["robot"].update(urdf="<robot"), "can't be used"),
        (lambda case: _follow(case, "j1"), "joint 'j1' follows 'j1', which follows itself"),
        (lambda case: _follow(case, "j2"), "which follows itself"),
        (lambda case: case["left_out"].append(["l1", "ghost", "why"]), "'ghost', which has no body"),
        (lambda case: case["obstacles"][0].update(size=[1.0]), "can't be used"),
    ],
)
def test_a_faulty_file_is_refused_with_what_is_wrong(change, fault):
    case = told()
    change(case)
    with pytest.raises(UnusableFile, match=fault):
        case_of(case)


def test_a_case_of_the_first_format_is_read_and_what_is_drawn_otherwise_is_refused_by_name(tmp_path):
    old = told()
    for name in ("accelerations", "steps", "tolerance"):
        del old["motion"][name]
    (tmp_path / "old.json").write_text(json.dumps({"format": FORMATS[1], "cases": [old]}))
    (case,) = load(tmp_path / "old.json")
    assert (case.steps, case.accelerations, case.tolerance.any()) == (False, None, False)
    for odd, said in (
        ({"tolerance": [-1.0]}, "tolerance"),
        ({"tolerance": [0.1, 0.1, 0.1]}, "tolerance"),
        ({"tolerance": [float("nan")]}, "finite"),
        ({"steps": True}, "steps need times"),
        ({"steps": 1}, "true or false"),
        ({"accelerations": [[0.0], [0.0]]}, "accelerations"),
    ):
        wrong = told()
        wrong["motion"] |= odd
        with pytest.raises(UnusableFile, match=said):
            case_of(wrong)


def test_what_nobody_here_can_judge_is_not_judged():
    strange = told()
    strange["obstacles"].append({"type": "torus", "name": "ring"})
    finding = judge(case_of(strange)).finding
    assert (finding.answer, finding.about) == (
        Answer.NOT_JUDGED,
        ("obstacle 'ring' of type 'torus', as it is declared",),
    )
    moving = told()
    stops = {"times": [0.0, 1.0], "placements": [{}, {"position": [0, 0, 1]}]}
    moving["obstacles"][0]["trajectory"] = stops
    assert judge(case_of(moving)).answer is Answer.NOT_JUDGED


def test_a_file_is_judged_by_a_program_of_its_own(tmp_path):
    """The file holds all there is: nothing of guidefield but the referee is loaded to judge it."""
    planned = group("panda")
    z = planned.to_local(planned.part_of(planned.robot.rest))
    motion = straight(world_of(planned, [box("b", (0.1, 0.1, 0.1), (1, 0, 0))]), [z, z + 0.1])
    path = tmp_path / "motion.json.xz"
    case_file.write(path, motion)
    program = [sys.executable, "-X", "importtime", "-m", "guidefield.referee", str(path)]
    run = subprocess.run(program, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout.splitlines()[0]) == (0, "referee: free")
    assert "panda_link0 and b: the link never moves" in run.stdout
    loaded = {line.rpartition("|")[2].strip() for line in run.stderr.splitlines()}
    ours = {name for name in loaded if name.startswith("guidefield.")}
    assert ours
    assert all(name.startswith("guidefield.referee") for name in ours)
    assert not loaded & {"numba", "msgspec", "lxml"}
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(UnusableFile, match="format"):
        load(tmp_path / "other.json")
    run = subprocess.run([*program[:-1], str(tmp_path / "other.json")], capture_output=True, text=True, check=False)
    assert run.returncode == 2


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (lzma.compress(b" " * 2**17), "cases.json.xz has more than 65536 bytes unpacked"),
        (lzma.compress(b"1") + lzma.compress(b" " * 2**17), "has more than 65536 bytes unpacked"),
        (lzma.compress(b"[" * 60_000), "isn't JSON"),
        (lzma.compress(b"[" * 60_000)[:-20], "isn't JSON"),
    ],
)
def test_a_packed_file_made_to_hurt_is_refused(content, fault, tmp_path, monkeypatch):
    monkeypatch.setattr(loading, "LARGEST", 2**16)
    (tmp_path / "cases.json.xz").write_bytes(content)
    with pytest.raises(UnusableFile, match=fault):
        load(tmp_path / "cases.json.xz")


@pytest.mark.parametrize("name", ["panda", "iris", "ur3_gripper", "chain_universal_moving_6x180_r25"])
def test_bodies_stand_where_the_robot_has_them(name):
    """Every collision shape, at a random configuration and root, by Pinocchio on the model that plans.

    Among the joints are balls, a floating root, and mimic joints.
    """
    rng = np.random.default_rng(5)
    model = robot(name)
    x, y, z, w = (q := rng.normal(size=4)) / np.linalg.norm(q)
    root = Placement(position=(0.3, -0.2, 0.5), quaternion_xyzw=(float(x), float(y), float(z), float(w)))
    placed = pin.SE3(pin.Quaternion(w, x, y, z), np.array(root.position))
    planned = select(model, None, None, model.rest, placed)
    world = world_of(planned, [])
    point = planned.to_local(planned.random(rng))
    motion = case_file.Motion(world, root, (), None, np.array([point, point]), None)
    case = read(motion)
    q, values = pin.neutral(case.model), case.spread @ point + case.offset
    for step in (np.where(case.turning, 0.0, values), case.turned, np.where(case.turning, values, 0.0)):
        q = pin.integrate(case.model, q, step)
    data = case.model.createData()
    pin.forwardKinematics(case.model, data, q)
    world.place(planned.expand_from_local(point))
    for index, body in enumerate(case.bodies):
        there = world.placement(index)
        assert (data.oMi[body.joint] * body.placement).isApprox(there, 1e-9)


@given(st.integers(0, 10**6), st.integers(3, 12))
def test_ears_are_the_whole_polygon(seed, count):
    """Their areas add up to the polygon's, and points that they contain are in it."""
    rng = np.random.default_rng(seed)
    angles = 2.0 * np.pi * np.arange(count) / count
    flat = rng.uniform(0.2, 1.0, count)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    x, y, z, w = rng.normal(size=4)
    corners = np.column_stack([flat, np.zeros(count)]) @ pin.Quaternion(w, x, y, z).normalized().matrix().T
    triangles = ears(corners)
    a, b, c = np.moveaxis(corners[triangles], 1, 0)
    following = np.roll(flat, -1, axis=0)
    area = 0.5 * (flat[:, 0] * following[:, 1] - flat[:, 1] * following[:, 0]).sum()
    assert len(triangles) == count - 2
    assert 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() == pytest.approx(area, rel=1e-9)


def test_a_cloud_is_balls_and_a_polygon_a_wall():
    """The robot's link is 4 cm wide and stands upright, 0.2 m from both."""
    planned = grouped(box_arm("y", 1), "l1")
    cloud = messages.PointCloud(name="cloud", points=[(0.22, 0.0, 0.4), (0.3, 0.0, 0.4)], radius=0.05)
    wall = messages.Polygon(name="wall", vertices=[(-0.22, -1, 0), (-0.22, 1, 0), (-0.22, 1, 1), (-0.22, -1, 1)])
    for obstacle, gap in ((cloud, 0.15), (wall, 0.2)):
        world = world_of(planned, [obstacle])
        assert judge(read(straight(world, [[0.0], [0.0]], gap - 1e-5))).answer is Answer.FREE
        finding = judge(read(straight(world, [[0.0], [0.0]], gap + 1e-5))).finding
        assert finding.answer is Answer.TOO_CLOSE
        assert finding.distance == pytest.approx(gap, abs=1e-6)


def test_meshes_of_a_robot_are_in_the_file_and_in_their_hulls():
    panda = group("panda")
    z = panda.to_local(panda.part_of(panda.robot.rest))
    case = read(straight(world_of(panda, []), [z]))
    meshes = [body for body in case.bodies if isinstance(body.exact, coal.BVHModelBase)]
    assert len(meshes) == sum(choice.shape == "mesh" for choice in panda.robot.geometry_choices)
    assert all(len(body.parts) == 1 for body in meshes)
    assert judge(case).answer is Answer.FREE


NAMED = (
    '<robot name="r"><link name="w"/><link name="{a}">{body}</link><link name="{b}">{body}</link>'
    '<joint name="{one}" type="revolute"><parent link="w"/><child link="{a}"/><axis xyz="0 0 1"/>{limit}</joint>'
    '<joint name="{two}" type="fixed"><origin xyz="0.5 0 0"/><parent link="{a}"/><child link="{b}"/>{mimic}'
    "</joint></robot>"
)
LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'
BODY = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'


def swept(obstacle: tuple[float, float, float], mimic: str = "", **names: str) -> Answer:
    """The referee's answer to a turn of an arm, whose outer body is 0.5 m from its axis, beside a ball."""
    called = {"a": "a", "b": "b", "one": "j", "two": "f", **names}
    planned = grouped(UrdfText(text=NAMED.format(body=BODY, limit=LIMIT, mimic=mimic, **called)), called["b"])
    (case,) = case_file.make_cases(
        straight(world_of(planned, [box("box", (0.02, 0.02, 0.02), obstacle)]), [[0.0], [0.8]])
    )
    return judge(case_of(json.loads(json.dumps(case)))).answer


@pytest.mark.parametrize(
    "names",
    [
        {},
        {"two": "universe"},
        {"one": "universe"},
        {"b": "universe", "two": "root_joint"},
        {"a": "f", "b": "j"},
        {"a": "joint:000000", "b": "link:000001"},
        {"mimic": '<mimic joint="j"/>'},
    ],
    ids=str,
)
def test_names_and_a_mimic_of_a_fixed_joint_place_bodies_as_any(names: dict[str, str]) -> None:
    inside = (0.5 * np.cos(0.4), 0.5 * np.sin(0.4), 0.0)
    assert swept(inside, **names) is Answer.CONTACT
    assert swept((0.5 * np.cos(1.4), 0.5 * np.sin(1.4), 0.0), **names) is Answer.FREE


@pytest.mark.parametrize("axis", ["0 1 0", "1 0 0", "0 0 -2", "1 2 -0.5"])
def test_a_planar_joint_moves_as_its_axis_says(axis: str) -> None:
    """The referee's own reading of the axis against that of the planner, at a place that only one plane holds."""
    text = (
        f'<robot name="r"><link name="w"/><link name="a">{BODY}</link><link name="b">{BODY}</link>'
        f'<joint name="p" type="planar"><origin rpy="0.3 0 0.2" xyz="0 0 1"/><parent link="w"/><child link="a"/>'
        f'<axis xyz="{axis}"/></joint><joint name="f" type="fixed"><origin xyz="0 0.3 0" rpy="0 1 0"/>'
        '<parent link="a"/><child link="b"/></joint></robot>'
    )
    planned = grouped(UrdfText(text=text), "b")
    model, data = planned.model, planned.model.createData()
    z = np.array([0.6, -0.4, 0.7])
    pin.framesForwardKinematics(model, data, planned.expand_from_local(z))
    there = data.oMf[planned.tip_id].translation
    (case,) = case_file.make_cases(straight(world_of(planned, [box("box", (0.02,) * 3, there)]), [0.9 * z, 1.1 * z]))
    assert judge(case_of(json.loads(json.dumps(case)))).answer is Answer.CONTACT
    beside = there + 0.25 * data.oMi[1].rotation[:, 2]
    (case,) = case_file.make_cases(straight(world_of(planned, [box("box", (0.02,) * 3, beside)]), [0.9 * z, 1.1 * z]))
    assert judge(case_of(json.loads(json.dumps(case)))).answer is Answer.FREE


FOLLOWING = """<robot name="hand"><link name="palm"/>
<link name="l1"><collision><geometry><box size="0.1 0.02 0.02"/></geometry></collision></link>
<link name="l2"><collision><geometry><box size="0.1 0.02 0.02"/></geometry></collision></link>
<joint name="left_finger1" type="revolute"><parent link="palm"/><child link="l1"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="left_finger2" type="revolute"><origin xyz="0.2 0 0"/><parent link="l1"/><child link="l2"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
<mimic joint="finger1" multiplier="0.5" offset="0.1"/></joint></robot>"""


def test_a_mimic_joint_whose_source_lacks_a_prefix_follows_the_one_that_is_meant() -> None:
    case = read(straight(world_of(grouped(UrdfText(text=FOLLOWING), "l2"), []), [[0.0], [0.3]]))
    assert case.spread.tolist() == [[1.0], [0.5]]
    assert case.offset.tolist() == [0.0, 0.1]


def test_only_triangles_that_make_up_a_polygon_divide_it():
    star = np.array([[0, 0], [4, 0], [1, 1], [0, 4], [-1, 1]], float)
    corners = np.column_stack([star, star @ [0.3, -0.2]])
    cut = ears(corners)
    assert is_divided(corners, cut)
    assert is_divided(corners, cut[:, ::-1])
    assert is_divided(corners[::-1], len(corners) - 1 - cut)
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    assert all(is_divided(square, np.array(one)) for one in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [3, 2, 1]]))
    for wrong in ([[0, 1, 2], [0, 1, 3]], [[0, 1, 2], [0, 1, 2]], [[0, 1, 2]], [[0, 1, 2], [0, 2, 4]]):
        assert not is_divided(square, np.array(wrong))
    assert not is_divided(corners, np.array([[0, 1, 3], [0, 3, 4], [1, 2, 3]])), "it goes beyond the dent"
