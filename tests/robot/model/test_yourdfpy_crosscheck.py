"""What yourdfpy makes of a URDF beside Pinocchio: the same placements, or a warning that says what differs."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings

from guidefield.messages.conditions import UrdfText
from guidefield.robot.catalog import Catalog
from guidefield.robot.model.yourdfpy_crosscheck import MOST_TOLD, crosscheck
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
        assert crosscheck(robot) is robot


@pytest.mark.parametrize("mimic", ["", FOLLOWS])
def test_a_robot_that_is_sent_is_read_twice(mimic: str) -> None:
    robot = Catalog().load(UrdfText(text=ARM.format(mimic=mimic)))
    assert not [warning for warning in robot.warnings if "yourdfpy" in warning]


def test_what_is_placed_otherwise_is_told() -> None:
    catalog = Catalog()
    robot = catalog.load("panda")
    elsewhere = robot.model.copy()
    elsewhere.jointPlacements[2].translation = elsewhere.jointPlacements[2].translation + np.array([0.0, 0.0, 0.01])
    told = crosscheck(dataclasses.replace(robot, model=elsewhere)).warnings[len(robot.warnings) :]
    assert told[0].startswith("yourdfpy places link 'panda_link2' otherwise, by 0.01")
    assert len(told) == MOST_TOLD + 1
    assert told[-1].startswith("yourdfpy reads ")
    assert told[-1].endswith(" more things otherwise")


@settings(max_examples=15)
@given(chains(8))
def test_random_chains_are_read_alike(sent: UrdfText) -> None:
    told = [warning for warning in Catalog().load(sent).warnings if "yourdfpy" in warning]
    assert all("don't know <capsule>" in warning for warning in told), told


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
