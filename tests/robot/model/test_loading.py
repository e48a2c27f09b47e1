"""Loading robots: the arms of the catalog, defaults, what is refused, and what yourdfpy reads otherwise."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from hypothesis import given, settings

from guidefield.errors import RobotInvalid
from guidefield.messages.conditions import UrdfText
from guidefield.messages.requests import UrdfFile
from guidefield.robot.catalog import Catalog
from guidefield.robot.model.loading import MAX_REMARKS, crosscheck
from tests.robot.random_chains import chains
from tests.robots import box_arm, load, robot


@pytest.mark.parametrize(("name", "nq", "nv"), [("panda", 9, 9), ("ur5", 6, 6), ("xarm7", 7, 7), ("kinova", 9, 6)])
def test_arms_have_pinocchios_dimensions(name: str, nq: int, nv: int) -> None:
    model = robot(name)
    assert (model.model.nq, model.model.nv) == (nq, nv)
    assert sum(joint.nq for joint in model.joints) == nq
    assert model.model.existFrame(model.tip)


def test_the_pairs_of_an_srdf_are_left_out_with_its_reasons() -> None:
    left_out = {pair.links: pair.reason for pair in robot("panda").pairs_left_out}
    assert left_out["panda_link5", "panda_link6"].startswith("SRDF: ")
    tested = {
        frozenset((robot("panda").link_of_geometry(p.first), robot("panda").link_of_geometry(p.second)))
        for p in robot("panda").geometry.collisionPairs
    }
    assert not {frozenset(links) for links in left_out} & tested


def test_without_an_srdf_adjacent_links_are_left_out_and_others_tested() -> None:
    arm = load(box_arm("y", 3))
    assert {pair.links for pair in arm.pairs_left_out} == {("l0", "l1"), ("l1", "l2"), ("l2", "l3")}
    assert {pair.reason for pair in arm.pairs_left_out} == {"adjacent"}
    tested = {(arm.link_of_geometry(p.first), arm.link_of_geometry(p.second)) for p in arm.geometry.collisionPairs}
    assert tested == {("l0", "l2"), ("l0", "l3"), ("l1", "l3")}


def test_an_unknown_name_lists_the_known() -> None:
    with pytest.raises(RobotInvalid, match="no robot 'pandda'") as refused:
        Catalog().load("pandda")
    assert "panda" in refused.value.details["available"]


def test_a_missing_file_is_named() -> None:
    with pytest.raises(RobotInvalid, match="no URDF file"):
        Catalog().load(UrdfFile(path="nowhere.urdf"))


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("/", "there is no URDF file '/': it is a folder; name a file in it"),
        (f"{'a' * 5000}.urdf", "can't be opened: File name too long"),
    ],
)
def test_what_cannot_be_opened_is_told(path: str, words: str) -> None:
    with pytest.raises(RobotInvalid) as refused:
        Catalog().load(UrdfFile(path=path))
    assert words in refused.value.message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "'arm.urdf' is empty: it has 0 bytes"),
        (b"<!DOCTYPE html><html>404</html>", "'arm.urdf' is an HTML page and not the file itself"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "'arm.urdf' is a pointer of git-LFS"),
    ],
)
def test_what_stands_in_for_a_file_is_told(tmp_path, content: bytes, words: str) -> None:
    (tmp_path / "arm.urdf").write_bytes(content)
    with pytest.raises(RobotInvalid) as refused:
        Catalog().load(UrdfFile(path=str(tmp_path / "arm.urdf")))
    assert words in refused.value.message


def test_a_text_with_half_a_surrogate_pair_is_told() -> None:
    with pytest.raises(RobotInvalid, match="half a surrogate pair"):
        Catalog().load(UrdfText(box_arm("y", 2).text.replace("<robot", "<robot version='\ud800'", 1)))


def test_what_is_odd_about_many_links_alike_is_one_warning() -> None:
    visual = '<visual><geometry><mesh filename="nowhere.stl"/></geometry></visual></link>'
    robot = Catalog().load(UrdfText(box_arm("y", 2).text.replace("</link>", visual)))
    told = [sentence for sentence in robot.warnings if "will not be drawn" in sentence]
    assert len(told) == 1
    assert told[0].endswith(" more likewise)")


def test_a_file_that_changes_is_read_again(tmp_path: Path) -> None:
    def reach(catalog: Catalog) -> float:
        (hand,) = catalog.load(reference).geometry.geometryObjects
        hand.geometry.computeLocalAABB()
        return float(hand.geometry.aabb_local.max_[2])

    mesh, srdf = tmp_path / "hand.stl", tmp_path / "arm.srdf"
    (tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="base"/><link name="hand"><collision><geometry><mesh filename="hand.stl"/>'
        '</geometry></collision></link><joint name="j1" type="continuous"><parent link="base"/><child link="hand"/>'
        '<axis xyz="1 0 0"/></joint></robot>'
    )
    trimesh.creation.box(extents=(0.1, 0.1, 0.2)).export(mesh)
    srdf.write_text('<robot name="arm"/>')
    reference, catalog = UrdfFile(str(tmp_path / "arm.urdf"), srdf_path=str(srdf)), Catalog()
    first = catalog.load(reference)
    assert catalog.load(reference) is first
    assert reach(catalog) == pytest.approx(0.1)
    trimesh.creation.box(extents=(0.1, 0.1, 0.6)).export(mesh)
    os.utime(mesh, ns=(0, 0))
    assert reach(catalog) == pytest.approx(0.3)
    srdf.write_text('<robot name="arm"><group name="all"><joint name="j1"/></group></robot>')
    assert catalog.load(reference).groups == {"all": ("j1",)}


def test_what_is_taken_for_a_robots_text_or_name_is_told() -> None:
    with pytest.raises(RobotInvalid, match="its text is asked for, not the name of a file"):
        load(UrdfText("arm.urdf"))
    with pytest.raises(RobotInvalid, match=r"column 1$"):
        load(UrdfText("an arm"))
    with pytest.raises(RobotInvalid, match='"urdf_file"'):
        Catalog().load("arm.urdf")
    with pytest.raises(RobotInvalid, match="did you mean panda"):
        Catalog().load("Panda")


def test_an_srdf_that_hides_contacts_is_told_on() -> None:
    """Panda's SRDF disables its hand against its fifth link; they do touch."""
    warned = [warning for warning in robot("panda").remarks if "SRDF disables" in warning]
    assert any("panda_hand and panda_link5" in warning for warning in warned)
    model = robot("panda").model
    bare, geometry = model.copy(), robot("panda").geometry.copy()
    pairs = [
        (i, j)
        for i in range(geometry.ngeoms)
        for j in range(i)
        if {robot("panda").link_of_geometry(i), robot("panda").link_of_geometry(j)} == {"panda_hand", "panda_link5"}
    ]
    geometry.removeAllCollisionPairs()
    for i, j in pairs:
        geometry.addCollisionPair(pin.CollisionPair(i, j))
    data, geometry_data = bare.createData(), geometry.createData()
    rng = np.random.default_rng(1)
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    qs = [rng.uniform(low, high) for _ in range(500)]
    hits = [pin.computeCollisions(bare, data, geometry, geometry_data, q, True) for q in qs]
    assert 0.04 < np.mean(hits) < 0.2


def test_links_that_always_touch_are_left_out_even_where_the_srdf_tests_them() -> None:
    box = '<link name="{0}"><collision><geometry><box size="0.5 0.5 0.5"/></geometry></collision></link>'
    joint = (
        '<joint name="j{0}" type="revolute"><parent link="l{0}"/><child link="l{1}"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    text = "".join(box.format(f"l{i}") for i in range(3)) + joint.format(0, 1) + joint.format(1, 2)
    srdf = '<robot name="stack"><disable_collisions link1="l0" link2="l1" reason="Adjacent"/></robot>'
    arm = load(UrdfText(text=f'<robot name="stack">{text}</robot>', srdf=srdf))
    assert not list(arm.geometry.collisionPairs)
    assert sum("always touch" in warning for warning in arm.warnings) == 2


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
    assert len(told) == MAX_REMARKS + 1
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
