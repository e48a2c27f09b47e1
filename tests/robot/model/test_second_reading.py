"""A second reading of a URDF beside Pinocchio's: the same placements, or a warning that says what differs."""

from __future__ import annotations

import dataclasses
import io

import numpy as np
import pytest
import yourdfpy
from hypothesis import given, settings
from lxml import etree
from scipy.linalg import expm

from guidefield.messages.references import UrdfText
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.model.second_reading import MOST_TOLD, crosschecked, read_placements
from tests.robot.random_chains import chains

ARM = """<robot name="arm">
  <link name="base"><visual><geometry><mesh filename="file:///etc/hostname"/></geometry></visual></link>
  <link name="upper"><collision><geometry><box size="0.1 0.1 0.3"/></geometry></collision></link>
  <link name="finger"/>
  <joint name="a" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.5" rpy="0.1 0.2 0.3"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="1" velocity="1"/></joint>
  <joint name="b" type="prismatic"><parent link="upper"/><child link="finger"/><origin xyz="0 0 0.3"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="1" effort="1" velocity="1"/>{mimic}</joint>
</robot>"""
FOLLOWS = '<mimic joint="a" multiplier="0.25" offset="0.3"/>'


def test_both_readers_agree_about_good_urdfs() -> None:
    catalog = Catalog()
    for name in ("panda", "ur5", "baxter", "allegro_right_hand"):
        robot = catalog.load(name)
        assert crosschecked(robot) is robot


@pytest.mark.parametrize("mimic", ["", FOLLOWS])
def test_a_robot_that_is_sent_is_read_twice(mimic: str) -> None:
    robot = Catalog().load(UrdfText(text=ARM.format(mimic=mimic)))
    assert not [warning for warning in robot.warnings if "reading" in warning]


def test_what_is_placed_otherwise_is_told() -> None:
    catalog = Catalog()
    robot = catalog.load("panda")
    elsewhere = robot.model.copy()
    elsewhere.jointPlacements[2].translation = elsewhere.jointPlacements[2].translation + np.array([0.0, 0.0, 0.01])
    told = crosschecked(dataclasses.replace(robot, model=elsewhere)).warnings[len(robot.warnings) :]
    assert told[0].startswith("a second reading of the URDF places link 'panda_link2' otherwise, by 0.01")
    assert len(told) == MOST_TOLD + 1
    assert told[-1].startswith("a second reading of the URDF differs in ")
    assert told[-1].endswith(" more things")


def test_a_joint_that_follows_one_of_another_name_is_told() -> None:
    robot = Catalog().load("alex_psyonic_hands")  # its `mimic` names a joint without the prefix of its hand
    told = [warning for warning in crosschecked(robot).warnings if "second reading" in warning]
    assert any("Left_index_q2" in warning for warning in told)


@settings(max_examples=25, deadline=None)
@given(chains(8))
def test_random_chains_are_read_alike(sent: UrdfText) -> None:
    told = [warning for warning in Catalog().load(sent).warnings if "second reading" in warning]
    assert not told


CHAIN = """<robot name="chain" version="1.2">
  <link name="base"/><link name="far"/><link name="up"/><link name="side"/>
  <joint name="a" type="continuous"><parent link="base"/><child link="up"/><axis xyz="0 3 4"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 2.6"/></joint>
  <joint name="b" type="prismatic"><parent link="up"/><child link="side"/><origin xyz="1 0 0" {turn}/>
    <axis xyz="0 0 5"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
    <mimic joint="a" multiplier="-0.2" offset="0.1"/></joint>
  <joint name="c" type="revolute"><parent link="side"/><child link="far"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/><mimic joint="b" multiplier="3"/></joint>
</robot>"""


def test_placements_are_those_of_the_closed_form() -> None:
    """A mimic joint of a mimic joint, axes of any length, a default axis and angles that need their order."""

    def about(axis: list[float], angle: float) -> np.ndarray:
        x, y, z = axis
        return expm(angle * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], float))

    def transform(rotation: np.ndarray, translation: list[float]) -> np.ndarray:
        return np.block([[rotation, np.c_[translation]], [np.zeros((1, 3)), np.ones((1, 1))]])

    a, b, c = 0.7, 0.1 - 0.2 * 0.7, 3.0 * (0.1 - 0.2 * 0.7)
    turned = about([0, 0, 1], 2.6) @ about([0, 1, 0], -0.5) @ about([1, 0, 0], 0.4)
    up = transform(turned @ about([0, 0.6, 0.8], a), [0.1, 0.2, 0.3])
    across = about([0, 0, 1], np.pi / 2)
    side = up @ transform(across, [1, 0, 0]) @ transform(np.eye(3), [0, 0, b])
    far = side @ transform(about([1, 0, 0], c), [0, 0, 0])
    for turn in (f'rpy="0 0 {np.pi / 2}"', 'quat_xyzw="0 0 2 2"', 'quat_xyzw="0 0 -0.5 -0.5"'):
        found = read_placements(etree.fromstring(CHAIN.format(turn=turn)), {"a": a})
        assert next(iter(found)) == "base"
        for link, expected in {"base": np.eye(4), "up": up, "side": side, "far": far}.items():
            assert found[link] == pytest.approx(expected, abs=1e-12), (link, turn)


@pytest.mark.parametrize("name", ["panda", "baxter", "allegro_right_hand", "talos_reduced"])
def test_placements_are_those_of_yourdfpy(name: str) -> None:
    robot = Catalog().load(name)
    root = etree.fromstring(robot.source.urdf_text.encode())
    for element in [found for tag in ("visual", "collision", "transmission", "gazebo") for found in root.iter(tag)]:
        element.getparent().remove(element)
    other = yourdfpy.URDF.load(io.BytesIO(etree.tostring(root)), load_meshes=False, filename_handler=str)
    drawn = dict(zip(other.actuated_joint_names, np.random.default_rng(5).uniform(-1.0, 1.0, 100), strict=False))
    other.update_cfg(drawn)
    found = read_placements(root, drawn)
    assert found.keys() == other.link_map.keys()
    for link, placement in found.items():
        assert placement == pytest.approx(other.get_transform(link, other.base_link), abs=1e-9)


def test_capsules_are_told() -> None:
    checked = '<collision_checking><capsule name="c"/></collision_checking>'
    cylinder = f'<collision name="c"><geometry><cylinder radius="0.1" length="0.4"/></geometry></collision>{checked}'
    written = '<collision><geometry><capsule radius="0.1" length="0.4"/></geometry></collision>'
    for shape, words in (
        (cylinder, "by <collision_checking> a cylinder is a capsule"),
        (written, "don't know <capsule>"),
    ):
        text = f'<robot name="k" version="1.1"><link name="b">{shape}</link></robot>'
        assert [words in told for told in Catalog().load(UrdfText(text=text)).warnings] == [True]
    plain = f'<robot name="k"><link name="b">{cylinder.removesuffix(checked)}</link></robot>'
    assert not Catalog().load(UrdfText(text=plain)).warnings
