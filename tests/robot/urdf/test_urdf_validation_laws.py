"""What passes the intake: the whole catalog and any sound tree, as Pinocchio reads them; nothing that it would lose."""

import functools
import math
from pathlib import Path

import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.errors import RobotInvalid
from guidefield.robot.model.neutral_names import capture_stderr
from guidefield.robot.urdf.elements import JOINT_DOF, UrdfFacts
from guidefield.robot.urdf.meshes import CATALOG_PACKAGE, MeshResolver, catalog_share
from guidefield.robot.urdf.urdf_validation import check_geometry_complete, check_urdf
from tests.robot.urdfs import ARM, pinocchio_models

NOWHERE = MeshResolver()
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
