"""Robots in files: meshes next door, in every part of the robot."""

from __future__ import annotations

from pathlib import Path

import pytest

from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfFile
from guidefield.robot.catalog.catalog import Catalog
from tests.robot.odd_meshes import stl

ARM = """<robot name="arm"><link name="base"/><link name="tip">
{shapes}
</link><joint name="j" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def shape(uri: str, kind: str = "collision") -> str:
    return f'<{kind}><geometry><mesh filename="{uri}"/></geometry></{kind}>'


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package whose folder has another name than its URIs."""
    (tmp_path / ".git").mkdir()
    mesh = tmp_path / "renamed" / "meshes" / "collision" / "tip.STL"
    mesh.parent.mkdir(parents=True)
    mesh.write_bytes(stl([[[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]]))
    (tmp_path / "renamed" / "urdf").mkdir()
    return tmp_path / "renamed"


def test_a_robot_with_its_meshes_next_door_is_loaded_and_told(package: Path) -> None:
    urdf = package / "urdf" / "arm.urdf"
    uri = "package://arm_description/meshes/collision/tip.stl"
    urdf.write_text(ARM.format(shapes=shape(uri) + shape("package://arm_description/lost.stl", "visual")))
    robot = Catalog().load(UrdfFile(str(urdf)))
    mesh = str(package / "meshes" / "collision" / "tip.STL")
    assert [found.meshPath for found in robot.geometry.geometryObjects] == [mesh]
    assert any(uri in said and mesh in said for said in robot.warnings)
    assert any("lost.stl" in said and "not be drawn" in said for said in robot.warnings)


def test_a_mesh_that_is_nowhere_is_refused_with_line_and_advice(package: Path) -> None:
    urdf = package / "urdf" / "arm.urdf"
    urdf.write_text(ARM.format(shapes=shape("package://arm_description/meshes/lost.stl")))
    with pytest.raises(RobotInvalid, match=r"line 2: link 'tip': mesh .*lost.stl' was not found .*package_dirs"):
        Catalog().load(UrdfFile(str(urdf)))


def test_all_meshes_that_are_nowhere_are_named(package: Path) -> None:
    urdf = package / "urdf" / "arm.urdf"
    lost = [f"package://arm_description/meshes/lost{number}.stl" for number in range(9)]
    there = "package://arm_description/meshes/collision/tip.stl"
    shapes = [*map(shape, [there, lost[0], lost[0], there]), shape("drawn.stl", "visual"), *map(shape, lost)]
    urdf.write_text(ARM.format(shapes="".join(shapes)))
    with pytest.raises(RobotInvalid) as refused:
        Catalog().load(UrdfFile(str(urdf)))
    assert refused.value.details["missing"] == lost
    assert all(repr(uri) in refused.value.message for uri in lost[:7])
    assert "lost7" not in refused.value.message
    assert "and 2 more" in refused.value.message
    assert "drawn.stl" not in refused.value.message


@pytest.mark.parametrize("path", ["a\0b.urdf", "a\0b.xacro", "~nobody-of-this-name/arm.urdf", "loop/arm.urdf"])
def test_what_is_no_path_is_refused(path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for reference in (UrdfFile(path), UrdfFile("arm.urdf", srdf_path=path)):
        with pytest.raises(RobotInvalid):
            Catalog().load(reference)
