"""Robots in MJCF: placements, ranges, pairs and laws are those of MuJoCo; what can't be kept is told or refused."""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfFile, UrdfText
from guidefield.robot.catalog import Catalog, mujoco_configuration
from guidefield.robot.model.joints import JointKind
from guidefield.robot.model.model import RobotModel

mujoco = pytest.importorskip("mujoco", reason="the extra `mujoco` isn't installed")

ARM = """<mujoco model="arm">
  <compiler angle="degree" eulerseq="zyx"/>
  <default><joint axis="0 1 0"/>
    <default class="hidden"><geom contype="0" conaffinity="0" group="2"/></default>
  </default>
  <asset><mesh name="wedge" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .2" scale="1 -1 .5" refpos=".01 0 0"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <body name="base" pos="0 0 .1" euler="30 10 5">
      <geom type="cylinder" size=".05 .05"/>
      <body name="turret" pos="0 0 .3" quat=".9 .1 .2 .3">
        <joint name="yaw" pos=".02 .03 0" axis="1 2 3" range="-90 120" ref="20"/>
        <joint name="lift" type="slide" axis="0 0 1" range="-.1 .25" ref=".05"/>
        <geom type="capsule" fromto="0 0 0 .2 0 .1" size=".03"/>
        <geom class="hidden" type="box" size=".1 .1 .1"/>
        <body name="hand" pos=".3 0 .1">
          <joint name="wrist" type="ball"/>
          <geom type="mesh" mesh="wedge" pos=".1 0 0" euler="0 40 0"/>
          <geom type="ellipsoid" size=".02 .03 .04" pos=".05 .1 0"/>
          <body name="left" pos="0 .1 0">
            <joint name="left" type="slide" range="0 .04"/><geom type="box" size=".01 .01 .02"/></body>
          <body name="right" pos="0 -.1 0">
            <joint name="right" type="slide" range="-.04 .04"/><geom type="box" size=".01 .01 .02"/></body>
          <site name="grasp" pos="0 0 .2" euler="90 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="right" joint2="left" polycoef="0 -1 0 0 0"/></equality>
  <contact><exclude body1="base" body2="hand"/></contact>
  <keyframe><key name="home" qpos=".5 .1 .8 0 .6 0 .02 -.02"/></keyframe>
</mujoco>"""


def _load(folder: Path, text: str, **fields: object) -> tuple[RobotModel, object]:
    path = folder / "robot.xml"
    path.write_text(text)
    return Catalog().load(UrdfFile(str(path), **fields)), mujoco.MjModel.from_xml_path(str(path))


def _joints(model: object) -> dict[int, str]:
    return {index: model.joint(index).name for index in range(model.njnt)}


def test_bodies_and_sites_stand_where_mujoco_has_them(tmp_path: Path) -> None:
    robot, model = _load(tmp_path, ARM)
    data, placed, rng = mujoco.MjData(model), robot.model.createData(), np.random.default_rng(7)
    worst = 0.0
    for _ in range(20):
        q = pin.integrate(robot.model, robot.rest, rng.uniform(-0.04, 0.04, robot.model.nv))
        data.qpos[:] = mujoco_configuration(robot, model, _joints(model), q)
        mujoco.mj_kinematics(model, data)
        pin.framesForwardKinematics(robot.model, placed, q)
        pairs = [(data.body(name), name) for name in ("base", "turret", "hand", "left", "right")]
        for theirs, name in [*pairs, (data.site("grasp"), "grasp")]:
            ours = placed.oMf[robot.frame_id(name)]
            position, rotation = (theirs.xpos, theirs.xmat)
            worst = max(worst, np.abs(ours.translation - position).max())
            worst = max(worst, np.abs(ours.rotation.ravel() - rotation).max())
    assert worst < 1e-9


def test_joints_have_mujocos_ranges_kinds_and_laws(tmp_path: Path) -> None:
    robot, model = _load(tmp_path, ARM)
    for name in ("yaw", "lift", "left"):
        joint = robot.joint(name)
        assert joint.limits is not None
        np.testing.assert_allclose(joint.limits, model.joint(name).range, atol=1e-12)
    wrist, right = robot.joint("wrist"), robot.joint("right")
    assert wrist.kind is JointKind.SPHERICAL
    assert (right.mimic.source, right.mimic.multiplier, right.mimic.offset) == ("left", -1.0, 0.0)
    np.testing.assert_allclose(robot.rest[:2], [0.5, 0.1])


def test_pairs_are_mujocos_and_scenery_is_told(tmp_path: Path) -> None:
    robot, _ = _load(tmp_path, ARM)
    left_out = {frozenset(pair.links): pair.reason for pair in robot.pairs_left_out}
    assert left_out[frozenset(("base", "hand"))] == "MJCF: <exclude>"
    assert left_out[frozenset(("turret", "hand"))] == "MJCF: adjacent"
    assert any("left out: floor" in warning for warning in robot.warnings)
    assert [choice.shape for choice in robot.geometry_choices if choice.link == "turret"] == ["capsule"]


def test_pairs_that_only_masks_keep_apart_are_tested_and_told(tmp_path: Path) -> None:
    masked = ARM.replace("<default>", '<default><geom contype="1" conaffinity="0"/>', 1)
    robot, _ = _load(tmp_path, masked)
    assert any("contype and conaffinity" in warning for warning in robot.warnings)
    tested = {
        frozenset((robot.link_of_geometry(pair.first), robot.link_of_geometry(pair.second)))
        for pair in robot.geometry.collisionPairs
    }
    assert frozenset(("left", "right")) in tested


def test_an_ellipsoid_is_contained_in_what_is_judged(tmp_path: Path) -> None:
    robot, _ = _load(tmp_path, ARM)
    shape = next(one for one in robot.geometry.geometryObjects if one.name == "hand_1")
    shape.geometry.computeLocalAABB()
    half = (shape.geometry.aabb_local.max_ - shape.geometry.aabb_local.min_) / 2.0
    assert np.all(half >= [0.02, 0.03, 0.04])
    assert np.all(half <= 1.01 * np.array([0.02, 0.03, 0.04]))


def test_a_free_joint_moves_only_a_robot_whose_root_is_free(tmp_path: Path) -> None:
    text = """<mujoco><worldbody><body name="trunk" pos="0 0 .7"><freejoint/><geom size=".1"/>
      <body name="leg" pos=".3 0 0"><joint name="hip" range="-60 60"/><geom size=".1"/></body>
    </body></worldbody></mujoco>"""
    fixed, _ = _load(tmp_path, text)
    free, _ = _load(tmp_path, text, root_joint="free")
    assert [joint.name for joint in fixed.joints] == ["hip"]
    assert any("trunk" in warning for warning in fixed.warnings)
    assert {joint.kind for joint in free.joints} == {JointKind.FLOATING, JointKind.REVOLUTE}


def test_a_file_that_is_included_or_edited_is_read_again(tmp_path: Path) -> None:
    (tmp_path / "inner.xml").write_text(
        '<mujocoinclude><body name="a"><joint name="j" range="-10 10"/><geom size=".1"/></body></mujocoinclude>'
    )
    path = tmp_path / "outer.xml"
    path.write_text('<mujoco><worldbody><include file="inner.xml"/></worldbody></mujoco>')
    catalog = Catalog()
    first = catalog.load(UrdfFile(str(path))).joint("j")
    inner = tmp_path / "inner.xml"
    inner.write_text(inner.read_text().replace("-10 10", "-20 20.0"))
    second = catalog.load(UrdfFile(str(path))).joint("j")
    assert first.limits is not None
    np.testing.assert_allclose(np.array(second.limits), 2.0 * np.array(first.limits))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('<body name="b"><joint name="k" type="ball" range="0 30"/><geom size=".1"/></body>', "ball joint 'k'"),
        ('<body name="b"><joint type="hing"/><geom size=".1"/></body>', "invalid keyword: 'hing'"),
    ],
)
def test_what_cannot_be_kept_is_refused_by_name(text: str, words: str) -> None:
    with pytest.raises(RobotInvalid, match=words):
        Catalog().load(UrdfText(f"<mujoco><worldbody>{text}</worldbody></mujoco>"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('<equality><connect name="loop" body1="b" body2="c" anchor="0 0 0"/></equality>', "connect 'loop' isn't kept"),
        ('<equality><weld name="glue" body1="b" body2="c"/></equality>', "weld 'glue' isn't kept"),
        (
            '<equality><joint name="cam" joint1="k" joint2="j" polycoef="0 1 .5 0 0"/></equality>',
            "joint 'cam' of joint 'k' isn't kept: it follows 'j' by a curve",
        ),
        (
            '<tendon><fixed name="pull" limited="true" range="0 1"><joint joint="j" coef="1"/></fixed></tendon>',
            "what tendons couple isn't kept, nor the length limits of 1 of them: pull",
        ),
        (
            '<tendon><fixed name="p"><joint joint="j" coef="1"/></fixed><fixed name="q"><joint joint="k" coef="1"/>'
            '</fixed></tendon><equality><tendon name="couple" tendon1="p" tendon2="q"/></equality>',
            "tendon 'couple' isn't kept",
        ),
    ],
    ids=["connect", "weld", "curve", "tendon", "tendons"],
)
def test_couplings_that_are_not_kept_are_told_by_name_and_leave_joints_free(text: str, words: str) -> None:
    bodies = (
        '<body name="a"><joint name="j" range="-1 1"/><geom size=".05"/><body name="b" pos="0 0 .3">'
        '<joint name="k" range="-1 1"/><geom size=".05"/></body></body>'
        '<body name="c" pos="1 0 0"><geom size=".1"/></body>'
    )
    robot = Catalog().load(UrdfText(f"<mujoco><worldbody>{bodies}</worldbody>{text}</mujoco>"))
    assert any(words in warning for warning in robot.warnings)
    assert [joint.name for joint in robot.joints if joint.mimic is None] == ["j", "k"]


def test_a_body_that_bends_is_refused_by_name() -> None:
    cloth = '<flexcomp name="cloth" type="grid" count="3 3 1" spacing=".1 .1 .1" dim="2"/>'
    arm = '<body><joint/><geom size=".05"/></body>'
    with pytest.raises(RobotInvalid, match="<flex> called 'cloth'"):
        Catalog().load(UrdfText(f"<mujoco><worldbody>{arm}{cloth}</worldbody></mujoco>"))


@pytest.mark.parametrize("as_text", [True, False])
def test_without_the_package_the_extra_is_named(as_text: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    (tmp_path / "arm.xml").write_text(ARM)
    reference = UrdfText(ARM) if as_text else UrdfFile(str(tmp_path / "arm.xml"))
    with pytest.raises(RobotInvalid, match=r"pip install 'guidefield\[mujoco\]'"):
        Catalog().load(reference)


def test_a_text_that_names_files_is_refused() -> None:
    text = '<mujoco><asset><mesh file="/etc/passwd"/></asset></mujoco>'
    with pytest.raises(RobotInvalid, match="must name no file, it names '/etc/passwd'"):
        Catalog().load(UrdfText(text))


MANY = '<replicate count="200"><replicate count="200"><geom size="0.1"/></replicate></replicate>'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"<worldbody>{MANY}</worldbody>", "line 2: the MJCF expands to more than 20000 elements"),
        ('<worldbody><composite count="1000 1000 1"/></worldbody>', "expands to more than 20000 elements"),
        ('<asset><texture width="99999" height="99999"/></asset>', "'width' and 'height' of <texture> are too large"),
        ('<asset><hfield nrow="99999" ncol="99999"/></asset>', "'nrow' and 'ncol' of <hfield> are too large"),
        ('<asset><mesh builtin="supersphere" params="2000 1 1"/></asset>', "'params' of <mesh> are too large"),
        ("<worldbody>", "the MJCF is not XML"),
    ],
)
def test_a_text_that_stands_for_too_much_is_refused_before_it_is_compiled(text: str, words: str) -> None:
    with pytest.raises(RobotInvalid, match=words):
        Catalog().load(UrdfText(f"<mujoco>\n{text}</mujoco>"))


def test_a_text_may_repeat_and_its_buffers_are_left_out() -> None:
    body = (
        '<body><joint/><geom size="0.1"/><replicate count="20" offset="0.1 0 0"><geom size="0.01"/></replicate></body>'
    )
    buffers = '<size memory="900G" nuserdata="2000000000"/><custom><numeric name="n" size="2000000000"/></custom>'
    robot = Catalog().load(UrdfText(f"<mujoco>{buffers}<worldbody>{body}</worldbody></mujoco>"))
    assert len(robot.geometry.geometryObjects) == 21
