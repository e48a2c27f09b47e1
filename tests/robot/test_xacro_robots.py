"""Robots in xacro files: arguments, includes, packages, errors, and changes of what is included."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfFile
from guidefield.robot.catalog import Catalog
from tests.robot.odd_meshes import stl

MAIN = """<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="reach" default="0.4"/><xacro:arg name="with_tool" default="false"/>
<xacro:include filename="$(find arm_parts)/urdf/link.xacro"/>
<link name="base"/>
<xacro:bar name="upper" parent="base" length="$(arg reach)"/>
<xacro:if value="$(arg with_tool)"><xacro:bar name="tool" parent="upper" length="0.1"/></xacro:if>
</robot>"""

PART = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="width" value="${0.1 / 4}"/>
<xacro:macro name="bar" params="name parent length"><link name="${name}"><collision>
<origin xyz="0 0 ${length / 2}"/><geometry><box size="${width} ${width} ${length}"/></geometry></collision>
<collision><geometry><mesh filename="package://arm_parts/meshes/${name}.stl"/></geometry></collision></link>
<joint name="j_${name}" type="revolute"><parent link="${parent}"/><child link="${name}"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></xacro:macro></robot>"""


@pytest.fixture
def main(tmp_path: Path) -> Path:
    """A xacro file, and beside its package another one, which it includes."""
    parts = tmp_path / "parts"
    (tmp_path / ".git").mkdir()
    for folder in (tmp_path / "arm" / "urdf", parts / "urdf", parts / "meshes"):
        folder.mkdir(parents=True)
    (parts / "package.xml").write_text("<package><name>arm_parts</name></package>")
    (parts / "urdf" / "link.xacro").write_text(PART)
    corner = [[[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]]
    for name in ("upper", "tool"):
        (parts / "meshes" / f"{name}.stl").write_bytes(stl(np.array(corner)))
    path = tmp_path / "arm" / "urdf" / "arm.urdf.xacro"
    path.write_text(MAIN)
    return path


def sizes(catalog: Catalog, reference: UrdfFile) -> dict[str, list[float]]:
    """Edges of the boxes of a robot by their links."""
    robot = catalog.load(reference)
    shapes = [shape for shape in robot.geometry.geometryObjects if hasattr(shape.geometry, "halfSide")]
    return {robot.model.frames[s.parentFrame].name: (2 * s.geometry.halfSide).tolist() for s in shapes}


def test_a_xacro_file_is_expanded_with_its_arguments(main: Path) -> None:
    catalog = Catalog()
    assert sizes(catalog, UrdfFile(str(main))) == {"upper": pytest.approx([0.025, 0.025, 0.4])}
    both = UrdfFile(str(main), xacro_args={"with_tool": True, "reach": 0.25})
    assert sizes(catalog, both) == {
        "upper": pytest.approx([0.025, 0.025, 0.25]),
        "tool": pytest.approx([0.025, 0.025, 0.1]),
    }
    assert catalog.load(both).name == "arm"
    assert catalog.load(both) is catalog.load(UrdfFile(str(main), xacro_args={"reach": 0.25, "with_tool": True}))


def test_a_change_of_an_included_file_is_seen(main: Path) -> None:
    catalog, reference = Catalog(), UrdfFile(str(main))
    before = catalog.load(reference)
    assert catalog.load(reference) is before
    part = main.parents[2] / "parts" / "urdf" / "link.xacro"
    part.write_text(PART.replace("0.1 / 4", "0.1 / 2"))
    assert sizes(catalog, reference) == {"upper": pytest.approx([0.05, 0.05, 0.4])}


def test_a_package_in_a_folder_of_another_name_is_taken_for_what_is_in_it(main: Path) -> None:
    folder = main.parents[1]
    (main.parents[2] / "other").mkdir()
    (main.parents[2] / "other" / "package.xml").write_text("<package><name>arm_description</name></package>")
    (folder / "parts").mkdir()
    (folder / "parts" / "link.xacro").write_text(PART)
    main.write_text(MAIN.replace("$(find arm_parts)/urdf/", "$(find arm_description)/parts/"))
    robot = Catalog().load(UrdfFile(str(main)))
    assert any("arm_description" in said and str(folder) in said for said in robot.warnings)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            '<xacro:arg name="reach" default="0.4"/>',
            "",
            ["arm.urdf.xacro", "'reach' has no value", "--xacro-arg reach:=VALUE"],
        ),
        ("arm_parts)", "nowhere)", ["arm.urdf.xacro", "package 'nowhere' was not found", "package_dirs"]),
        ("link.xacro", "lost.xacro", ["arm.urdf.xacro", "lost.xacro' can't be read: No such file"]),
        ('parent="base"', "", ["arm.urdf.xacro", "parent"]),
        ("xacro:bar", "xacro:rod", ["arm.urdf.xacro", "unknown macro name: xacro:rod"]),
        ('"$(arg reach)"', '"${reach + 1}"', ["'reach' is not defined"]),
        ('"$(arg reach)"', '"${1 / 0}"', ["division by zero"]),
        ("</robot>", "", ["arm.urdf.xacro", "not XML", "line 7"]),
        (' default="0.4"', "", ["arm.urdf.xacro", "missing attribute 'default'"]),
        ('"$(arg reach)"', '"abc"', ["arm.urdf.xacro, in macro 'bar' of link.xacro: ", "'length / 2'"]),
        ('parent="base"', 'parent="lost"', ["arm.urdf.xacro, expanded: line ", "'lost' does not exist"]),
    ],
)
def test_errors_name_the_file_and_the_cause(main: Path, old: str, new: str, words: list[str]) -> None:
    assert old in MAIN
    main.write_text(MAIN.replace(old, new))
    with pytest.raises(RobotInvalid) as caught:
        Catalog().load(UrdfFile(str(main)))
    for word in words:
        assert word in caught.value.message
    main.write_text(MAIN)
    Catalog().load(UrdfFile(str(main)))  # nothing of the failure stays


def test_a_file_of_macros_alone_is_told_from_a_robot(main: Path) -> None:
    part = main.parents[2] / "parts" / "urdf" / "link.xacro"
    with pytest.raises(
        RobotInvalid, match=r"link.xacro expands to no link: .* name the xacro file that calls its macros"
    ):
        Catalog().load(UrdfFile(str(part)))


def test_what_calls_itself_without_end_is_an_error(main: Path) -> None:
    part = main.parents[2] / "parts" / "urdf" / "link.xacro"
    part.write_text(PART.replace("<link", "<xacro:bar name='a' parent='b' length='1'/><link", 1))
    with pytest.raises(RobotInvalid, match="calls itself without end"):
        Catalog().load(UrdfFile(str(main)))


def test_arguments_that_nothing_has_are_refused(main: Path, tmp_path: Path) -> None:
    with pytest.raises(RobotInvalid, match=r"no xacro argument 'rech'; it has reach, with_tool"):
        Catalog().load(UrdfFile(str(main), xacro_args={"rech": 1.0}))
    plain = tmp_path / "plain.urdf"
    plain.write_text("<robot name='r'><link name='l'/></robot>")
    with pytest.raises(RobotInvalid, match=r"plain\.urdf takes no xacro arguments"):
        Catalog().load(UrdfFile(str(plain), xacro_args={"reach": 1.0}))


def test_the_command_line_takes_arguments(main: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from typer.testing import CliRunner

    from guidefield.cli.commands import app

    told = CliRunner().invoke(app, ["robots", str(main), "--xacro-arg", "with_tool:=true", "--json"])
    assert told.exit_code == 0, told.output
    assert '"j_tool"' in told.stdout
    from guidefield.cli.certifying import make_robot_reference
    from guidefield.errors import MalformedRequest

    assert make_robot_reference("a.XACRO", None, [], ["x:=1:=2"]) == UrdfFile("a.XACRO", xacro_args={"x": "1:=2"})
    for robot, argument, words in (("a.xacro", "x=1", "name:=value"), ("panda", "x:=1", r"\.xacro file")):
        with pytest.raises(MalformedRequest, match=words):
            make_robot_reference(robot, None, [], [argument])


def test_where_xacro_is_missing_the_command_to_install_it_is_told(main: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(RobotInvalid, match=r"pip install 'guidefield\[xacro\]'"):
        Catalog().load(UrdfFile(str(main)))


def test_the_whole_is_what_the_command_xacro_makes(main: Path, tmp_path: Path) -> None:
    parts, written = main.parents[2] / "parts", tmp_path / "by_command.xacro"
    written.write_text(MAIN.replace("$(find arm_parts)", str(parts)))
    command = [sys.executable, "-c", "import xacro; xacro.main()", str(written), "reach:=0.3", "with_tool:=true"]
    text = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(text)
    ours = Catalog().load(UrdfFile(str(main), xacro_args={"reach": 0.3, "with_tool": True}))
    theirs = Catalog().load(UrdfFile(str(urdf), package_dirs=[str(tmp_path)]))
    assert ours.model == theirs.model
    assert [g.name for g in ours.geometry.geometryObjects] == [g.name for g in theirs.geometry.geometryObjects]
