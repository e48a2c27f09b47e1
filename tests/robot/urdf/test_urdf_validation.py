"""The intake of URDFs: each fault is named with line and element; what passes is read whole by Pinocchio."""

import functools
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.errors import RobotInvalid, Status
from guidefield.messages.values import MAX_URDF_CHARACTERS
from guidefield.robot.model.neutral_names import capture_stderr
from guidefield.robot.urdf.elements import JOINT_DOF, UrdfFacts
from guidefield.robot.urdf.meshes import CATALOG_PACKAGE, MeshResolver, catalog_share
from guidefield.robot.urdf.urdf_validation import MAX_DOF, MAX_LINKS, check_geometry_complete, check_urdf
from tests.robot.urdfs import ARM, AXIS, BOX, FAULTS, LIMIT, MIMIC, ORIGIN, faulty, pinocchio_models

NOWHERE = MeshResolver()
INERTIA = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'

SILENT = ("loop beside a tree", "zero axis", "capsule before 1.1", "flat box", "mimic of nothing")
"""Faults that Pinocchio accepts without a word."""


@pytest.mark.parametrize("name", FAULTS)
def test_names_the_fault_with_line_and_element(name):
    _, line, element, words = FAULTS[name]
    with pytest.raises(RobotInvalid) as caught:
        check_urdf(faulty(name), NOWHERE)
    error = caught.value
    assert error.code is Status.ROBOT_INVALID
    assert words in error.message
    assert (error.details.get("line"), error.details.get("element")) == (line, element)
    assert error.message.startswith(f"line {line}: ")


@pytest.mark.parametrize(
    ("name", "owner"),
    [
        ("zero axis", {"joint": "shoulder"}),
        ("mimic of nothing", {"joint": "wrist"}),
        ("unknown shape", {"link": "upper"}),
    ],
)
def test_names_the_joint_or_link_at_fault(name, owner):
    with pytest.raises(RobotInvalid) as caught:
        check_urdf(faulty(name), NOWHERE)
    assert owner.items() <= caught.value.details.items()
    assert next(iter(owner.values())) in caught.value.message


@pytest.mark.parametrize("name", SILENT)
def test_what_pinocchio_accepts_in_silence_needs_the_check(name):
    text = faulty(name)
    model, geometry = pinocchio_models(text)
    data = model.createData()
    pin.forwardKinematics(model, data, np.full(model.nq, 0.3) if name == "zero axis" else pin.neutral(model))
    rotation = data.oMi[1].rotation
    assert (
        model.njoints - 1 < text.count("<joint ")
        or not np.allclose(rotation @ rotation.T, np.eye(3))
        or (model.lowerPositionLimit > model.upperPositionLimit).any()
        or geometry.ngeoms < text.count("<box") + text.count("<capsule")
        or "elbow" not in model.names
    )


def test_pinocchio_reads_the_checked_text_as_the_text_itself():
    facts = check_urdf(ARM, NOWHERE)
    model, geometry = pinocchio_models(facts.text)
    assert model == pinocchio_models(ARM)[0]
    check_geometry_complete(facts, geometry, model)


@pytest.mark.parametrize("kind", ["fixed", "floating"])
def test_an_axis_that_pinocchio_ignores_may_be_zero(kind):
    text = ARM.replace(MIMIC, "").replace('type="revolute"', f'type="{kind}"').replace(AXIS, '<axis xyz="0 0 0"/>')
    facts = check_urdf(text, NOWHERE)
    assert pinocchio_models(facts.text)[0].nv == JOINT_DOF[kind] + 1


def test_harmless_oddities_are_warnings():
    odd = (
        ARM.replace(LIMIT, '<limit effort="1" velocity="1"/>' + LIMIT)
        .replace('"continuous"', '"fixed"')
        .replace('<sphere radius="0.1"/>', '<mesh filename="package://lost/a.stl"/>')
    )
    facts = check_urdf(odd, NOWHERE)
    for words in (
        "line 14: joint 'shoulder': the joint can't move",
        "line 14: joint 'shoulder': a second <limit>",
        "line 20: joint 'wrist': a fixed joint can't mimic",
        "line 5: link 'upper': mesh 'package://lost/a.stl' can't be read",
    ):
        assert any(warning.startswith(words) for warning in facts.warnings), words
    assert facts.mimics == {}
    assert "package://" not in facts.text


ODD = {
    "comment before the head": (
        ("<robot", '<!-- made by\nsomebody -->\n<?xml version="1.0"?>\n<robot'),
        "line 3: the XML declaration isn't at the start: it is left out",
    ),
    "no effort": ((' effort="10"', ""), "line 14: joint 'shoulder': 'effort' of <limit> is missing"),
    "no velocity": ((' velocity="2"', ""), "'velocity' of <limit> is missing: the default limit holds"),
    "malformed visual": (('<sphere radius="0.1"/>', "<sphere/>"), "line 5: link 'upper': <sphere> must have 'radius'"),
    "visual without shape": (('<sphere radius="0.1"/>', ""), "with a shape"),
    "nameless material": (("</visual>", "<material/></visual>"), "<material> must have a name"),
    "no mass": (('<mass value="1"/>', ""), "must have <mass>; is left out: the link has no mass"),
    "mass in words": (('<mass value="1"/>', '<mass value="one"/>'), "finite number"),
    "no inertia": ((' iyz="0"', ""), "must have 'iyz'"),
    "safety": ((LIMIT, LIMIT + "<safety_controller/>"), "must have 'k_velocity'"),
    "dynamics": ((LIMIT, LIMIT + '<dynamics damping="x"/>'), "finite number"),
    "empty dynamics": ((LIMIT, LIMIT + "<dynamics/>"), "'damping' or 'friction'"),
    "duplicate material": (("<link", '<material name="m"/><material name="m"/><link'), "has the name 'm', too"),
    "part of a robot": (('<link name="base"/>', ""), "parent link 'base' does not exist: it is taken"),
    "no name": ((' name="arm"', ""), "line 1: <robot> has no name: it is called 'robot'"),
    "negative velocity": (
        ('velocity="2"', 'velocity="-2"'),
        "line 14: joint 'shoulder': 'velocity' of <limit> is negative, -2: the default limit holds",
    ),
    "negative effort": (('effort="10"', 'effort="-1"'), "'effort' of <limit> is negative, -1"),
    "lower above upper": (
        ('lower="-1"', 'lower="1.5"'),
        "line 14: joint 'shoulder': 'lower' exceeds 'upper', 1.5 > 1: the range is taken for 1 to 1.5",
    ),
    "second axis": ((AXIS, AXIS + AXIS), "line 13: joint 'shoulder': a second <axis> is left out"),
    "second origin": ((AXIS, AXIS + '<origin xyz="9 9 9"/>'), "a second <origin> is left out"),
    "second mimic": ((MIMIC, MIMIC + MIMIC), "line 20: joint 'wrist': a second <mimic> is left out"),
    "second inertial": (
        ("<visual>", '<inertial><mass value="1"/>' + INERTIA + "</inertial><visual>"),
        "a second <inertial>",
    ),
    "second origin of a shape": (
        ('<origin xyz="0 0 0.2"/>', '<origin xyz="0 0 0.2"/><origin xyz="1 0 0"/>'),
        "line 6: link 'upper': a second <origin> is left out",
    ),
    "misspelt collision": (
        ('<link name="hand"/>', f'<link name="hand"><Collision><geometry>{BOX}</geometry></Collision></link>'),
        "line 8: link 'hand': <Collision> is unknown and left out: is <collision> meant?",
    ),
    "misspelt inertial": (('<link name="hand"/>', '<link name="hand"><Inertial/></link>'), "is <inertial> meant?"),
    "misspelt limit": ((LIMIT, LIMIT + "<limits/>"), "<limits> is unknown and left out: is <limit> meant?"),
    "misspelt link": (('<link name="hand"/>', '<link name="hand"/><Link name="x"/>'), "is <link> meant?"),
    "misspelt attribute": (
        (ORIGIN, ORIGIN.replace("rpy", "RPY")),
        "attribute 'RPY' of <origin> is unknown and left out",
    ),
    "undeclared prefix": (
        ('<link name="hand"/>', '<link name="hand"/><sensor:camera name="c"><sensor:b/></sensor:camera>'),
        "line 8: the prefix 'sensor' isn't declared: what has it is left out",
    ),
    "undeclared prefix of an attribute": (
        ('<link name="hand"/>', '<link name="hand" drake:x="1"/>'),
        "the prefix 'drake'",
    ),
    "call of xacro": (
        ('<link name="hand"/>', '<link name="hand"><xacro:grey/></link><xacro:grey/>'),
        "line 8: <xacro:grey> (and 1 more) is left over from xacro: it is left out",
    ),
    "definition of xacro": (
        ("<link", '<x:property xmlns:x="http://ros.org/wiki/xacro" name="a" value="1"/><link'),
        "line 2: <xacro:property> is left over from xacro",
    ),
    "damping of xacro": (
        (LIMIT, LIMIT + '<dynamics damping="${d}"/>'),
        "expand the file with xacro first; <dynamics> is left out: nothing uses it",
    ),
    "mass of xacro": (
        ('<mass value="1"/>', '<mass value="${m}"/>'),
        "<inertial> has leftovers of xacro and is left out",
    ),
    "range of a continuous joint": (
        (MIMIC, '<limit lower="-1" upper="1" effort="1" velocity="1"/>'),
        "line 20: joint 'wrist': a continuous joint has no range: 'lower' and 'upper' are left out",
    ),
}


@pytest.mark.parametrize("name", ODD)
def test_what_other_tools_read_is_told_and_read(name: str) -> None:
    (old, new), words = ODD[name]
    assert old in ARM
    facts = check_urdf(ARM.replace(old, new, 1), NOWHERE)
    assert any(words in warning for warning in facts.warnings), facts.warnings
    model, geometry = pinocchio_models(facts.text)
    check_geometry_complete(facts, geometry, model)
    assert facts.collisions.keys() == {"upper"}
    assert model.jointPlacements[1].translation.tolist() == [0.0, 0.0, 0.1]


def test_every_shape_of_a_collision_is_judged() -> None:
    two = f'{BOX}<sphere radius="0.3"/><origin xyz="9 9 9"/></geometry><geometry><cylinder radius="0.1" length="1"/>'
    facts = check_urdf(ARM.replace(BOX, two), NOWHERE)
    assert [shape.shape for shape in facts.collisions["upper"]] == ["box", "sphere", "cylinder"]
    model, geometry = pinocchio_models(facts.text)
    check_geometry_complete(facts, geometry, model)
    assert [type(shape.geometry).__name__ for shape in geometry.geometryObjects] == ["Box", "Sphere", "Cylinder"]
    assert all(shape.placement.translation.tolist() == [0, 0, 0.2] for shape in geometry.geometryObjects)
    for words in ("a second shape in one <collision> is judged too", "<origin> is no shape and is left out"):
        assert any(warning.startswith("line 6: link 'upper': " + words) for warning in facts.warnings), facts.warnings


@pytest.mark.parametrize(
    "leftover",
    [
        '<xacro:include filename="arm.xacro"/>',
        '<xacro:if value="1"><link name="x"/></xacro:if>',
        '<xacro:macro name="grey"><link name="x"/></xacro:macro><xacro:grey/>',
        '<xacro:arm><link name="x"/></xacro:arm>',
    ],
)
@pytest.mark.parametrize("declared", ["", ' xmlns:xacro="http://www.ros.org/wiki/xacro"'])
def test_what_xacro_has_to_expand_is_refused(leftover: str, declared: str) -> None:
    text = ARM.replace('<robot name="arm"', f'<robot name="arm"{declared}').replace("</robot>", leftover + "</robot>")
    with pytest.raises(RobotInvalid, match=r"this is a xacro file .* expand it first"):
        check_urdf(text, NOWHERE)


@pytest.mark.parametrize("axis", ["0 0 1e200", "0 0 1e-200", "0 0 5e-324", "0 0 1.7e308"])
def test_of_an_axis_only_the_direction_counts(axis: str) -> None:
    model, _ = pinocchio_models(check_urdf(ARM.replace(AXIS, f'<axis xyz="{axis}"/>'), NOWHERE).text)
    assert model.joints[1].shortname() == "JointModelRZ"


def test_a_mimic_that_lost_its_prefix_is_found_again():
    text = (
        ARM.replace('"wrist"', '"left_finger_2"')
        .replace('"shoulder"', '"left_finger_1"')
        .replace('<mimic joint="left_finger_1"', '<mimic joint="finger_1"')
    )
    facts = check_urdf(text, NOWHERE)
    assert facts.mimics == {"left_finger_2": ("left_finger_1", 2.0, 0.5)}
    assert "taken for 'left_finger_1'" in facts.warnings[0]


def test_entities_are_neither_expanded_nor_fetched(tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("0 0 1")
    bomb = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10 if i else "lol"}">' for i in range(12))
    for doctype in (f"<!DOCTYPE robot [{bomb}]>", f'<!DOCTYPE robot [<!ENTITY e SYSTEM "file://{secret}">]>'):
        with pytest.raises(RobotInvalid, match="DOCTYPE"):
            check_urdf(doctype + ARM.replace(AXIS, '<axis xyz="&e11;"/>'), NOWHERE)
    with pytest.raises(RobotInvalid, match="not XML"):
        check_urdf(ARM.replace('"0 0 1"', '"&e;"'), NOWHERE)


def test_sizes_are_bounded():
    with pytest.raises(RobotInvalid, match="at most"):
        check_urdf(ARM + " " * MAX_URDF_CHARACTERS, NOWHERE)
    with pytest.raises(RobotInvalid, match=f"at most {MAX_LINKS}"):
        check_urdf(chain(MAX_LINKS, "fixed"), NOWHERE)
    with pytest.raises(RobotInvalid, match=f"at most {MAX_DOF}"):
        check_urdf(chain(MAX_DOF + 1, "continuous"), NOWHERE)
    with pytest.raises(RobotInvalid, match="not XML"):
        check_urdf("<robot name='a'>" + "<a>" * 5_000, NOWHERE)
    assert len(check_urdf(chain(MAX_LINKS - 1, "fixed"), NOWHERE).links) == MAX_LINKS


def chain(joints: int, kind: str) -> str:
    links = "".join(f'<link name="l{i}"/>' for i in range(joints + 1))
    ends = '<joint name="j{0}" type="{1}"><parent link="l{0}"/><child link="l{2}"/></joint>'
    return f'<robot name="chain">{links}{"".join(ends.format(i, kind, i + 1) for i in range(joints))}</robot>'


def test_lost_geometry_names_its_link():
    lossy = ARM.replace("</collision>", "</collision><collision><geometry/></collision>")
    model, geometry = pinocchio_models(lossy)
    with pytest.raises(RobotInvalid, match="link 'upper' has 1 <collision> shapes, but 0 were read") as caught:
        check_geometry_complete(check_urdf(ARM, NOWHERE), geometry, model)
    assert caught.value.details == {"link": "upper", "line": 6, "element": "collision"}


def test_an_axis_without_a_direction_is_refused() -> None:
    """Found by fuzzing: Pinocchio takes it for zero, and its "rotation" about that is none."""
    with pytest.raises(RobotInvalid, match="<axis> must have 'xyz'"):
        check_urdf(ARM.replace(AXIS, '<axis xz="0 0 1"/>'), NOWHERE)


ROBOTS = catalog_share() / CATALOG_PACKAGE / "robots"
CATALOG = sorted(ROBOTS.rglob("*.urdf"))
UNUSABLE = {"ur3.urdf": "at least one <link>"}
"""Of the 69 URDFs, those that are refused. Of romeo_laas_small only the visual meshes are missing."""


@functools.cache
def catalog_facts(path: Path) -> UrdfFacts:
    return check_urdf(path.read_text(), MeshResolver.for_wire())


@pytest.mark.parametrize("path", CATALOG[1::3], ids=lambda path: path.stem)
def test_the_catalog_passes_and_means_the_same(path):
    facts = catalog_facts(path)
    model, geometry = pinocchio_models(facts.text)
    check_geometry_complete(facts, geometry, model)
    with capture_stderr():
        written = pin.buildModelFromUrdf(str(path))
    assert model == written
    moving = {name for name, joint in facts.joints.items() if joint.kind != "fixed"}
    assert moving == set(list(model.names)[1:])
    assert sum(JOINT_DOF[joint.kind] for joint in facts.joints.values()) == model.nv


def test_the_catalog_is_all_there():
    assert len(CATALOG) == 69
    for path in CATALOG:
        if path.name in UNUSABLE:
            with pytest.raises(RobotInvalid, match=UNUSABLE[path.name]):
                catalog_facts(path)
        else:
            catalog_facts(path)


def test_every_visual_mesh_of_the_catalog_but_romeos_is_found():
    missing = {
        path.stem
        for path in CATALOG
        if path.name not in UNUSABLE and any("can't be read" in warning for warning in catalog_facts(path).warnings)
    }
    assert missing == {"romeo_laas_small"}


KINDS = st.sampled_from(sorted(JOINT_DOF))
NUMBERS = st.floats(-3.0, 3.0).map(lambda x: round(x, 6))


@st.composite
def trees(draw):
    """A URDF of 1 to 20 joints of all kinds with branches, mimics and some geometry."""
    count = draw(st.integers(1, 20))
    parts = ['<link name="l0"/>']
    scalar: list[str] = []
    for i in range(count):
        kind, above = draw(KINDS), draw(st.integers(0, i))
        axis = draw(st.lists(NUMBERS, min_size=3, max_size=3).filter(lambda v: math.hypot(*v) > 1e-3))
        lower, width = draw(NUMBERS), draw(st.floats(0.01, 3.0))
        mimic = ""
        if kind in ("revolute", "continuous", "prismatic"):
            if scalar and draw(st.booleans()):
                mimic = f'<mimic joint="{draw(st.sampled_from(scalar))}" multiplier="{draw(NUMBERS)}"/>'
            scalar.append(f"j{i}")
        parts.append(
            f'<link name="l{i + 1}"><collision><geometry><sphere radius="{draw(st.floats(0.001, 0.2))}"/></geometry>'
            f'</collision></link><joint name="j{i}" type="{kind}"><parent link="l{above}"/><child link="l{i + 1}"/>'
            f'<origin xyz="{draw(NUMBERS)} {draw(NUMBERS)} {draw(NUMBERS)}"/>'
            f'<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
            f'<limit lower="{lower}" upper="{lower + width}" effort="1" velocity="1"/>{mimic}</joint>'
        )
    return f'<robot name="tree">{"".join(parts)}</robot>'


@settings(max_examples=24)
@given(trees())
def test_sound_trees_pass_and_agree_with_pinocchio(text):
    facts = check_urdf(text, NOWHERE)
    model, geometry = pinocchio_models(facts.text)
    check_geometry_complete(facts, geometry, model)
    assert model == pinocchio_models(text)[0]
    for index in range(1, model.njoints):
        joint, facts_of = model.joints[index], facts.joints[model.names[index]]
        assert joint.nv == JOINT_DOF[facts_of.kind]
        if facts_of.lower is not None:
            assert model.lowerPositionLimit[joint.idx_q] == pytest.approx(facts_of.lower, abs=1e-12)
            assert model.upperPositionLimit[joint.idx_q] == pytest.approx(facts_of.upper, abs=1e-12)


TOKENS = [
    "",
    "0",
    "-1",
    "nan",
    "1e999",
    "0 0",
    "0 0 0",
    "<box/>",
    "</link>",
    '"',
    "&",
    "&#48;",
    "x",
    "base",
    "shoulder",
    "\x00",
]


@settings(max_examples=120)
@given(st.integers(0, len(ARM)), st.integers(0, 12), st.sampled_from(TOKENS))
def test_whatever_passes_pinocchio_reads_whole(start, length, token):
    text = ARM[:start] + token + ARM[start + length :]
    try:
        facts = check_urdf(text, NOWHERE)
    except RobotInvalid:
        return
    model, geometry = pinocchio_models(facts.text)
    check_geometry_complete(facts, geometry, model)
    assert (model.lowerPositionLimit <= model.upperPositionLimit).all()


@settings(max_examples=30)
@given(st.text())
def test_any_text_is_refused_in_good_order(text):
    with pytest.raises(RobotInvalid):
        check_urdf(text, NOWHERE)
    with pytest.raises(RobotInvalid):
        check_urdf(f"<robot name='r'>{text}", NOWHERE)
