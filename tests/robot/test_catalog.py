"""The catalog: lines about robots, and robots of files, with meshes next door."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from guidefield.errors import RobotInvalid
from guidefield.messages.replies import RobotSummary
from guidefield.messages.requests import UrdfFile
from guidefield.robot import catalog as catalogs
from guidefield.robot.catalog import Catalog
from guidefield.robot.library import SentRobot
from tests.robot.odd_meshes import stl
from tests.robots import box_arm


def lines_of(catalog: Catalog, *sent: SentRobot) -> list[Any]:
    """Lines about all robots of the catalog, and some that were sent."""
    return [*catalog.summaries(), *map(catalog.line, sent)]


def _say_what_can_be_planned_or_what_is_wrong(summaries: dict[str, RobotSummary]) -> None:
    assert summaries["panda"].dof == 8
    assert summaries["panda"].tip == "panda_hand_tcp"
    assert summaries["kinova"].joint_kinds == {"continuous": 3, "revolute": 3}
    problems = [summary for summary in summaries.values() if summary.problem]
    assert len(summaries) >= 69
    assert 0 < len(problems) <= 8
    assert all(summary.dof is not None for summary in summaries.values() if not summary.problem)


def test_robots_are_summarized_once_and_those_that_were_sent_when_they_change(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    asked: list[str] = []

    def counted(summarize: Callable[..., RobotSummary]) -> Callable[..., RobotSummary]:
        def summarized(one: Any, *rest: Any) -> RobotSummary:
            asked.append(one.name)
            return summarize(one, *rest)

        return summarized

    for room, name in ((catalogs, "summarize"), (catalogs, "summarize_sent")):
        monkeypatch.setattr(room, name, counted(getattr(room, name)))
    catalog = Catalog()
    mine = SentRobot("mine", "a" * 64, box_arm("y", 2).text, None, {}, "fixed")
    first = lines_of(catalog, mine)
    _say_what_can_be_planned_or_what_is_wrong({summary.name: summary for summary in first[:-1]})
    assert len(asked) == len(first)
    assert lines_of(catalog, mine) == first
    assert len(asked) == len(first)
    other = replace(mine, content="b" * 64, urdf=box_arm("y", 3).text)
    broken = replace(mine, name="broken", urdf="<robot/>")
    lines = {line.name: line for line in lines_of(catalog, other, broken)}
    assert (lines["mine"].dof, first[-1].dof) == (3, 2)
    assert lines["broken"].problem
    assert asked[len(first) :] == ["mine", "broken"]
    lines_of(catalog, other, broken)
    assert asked[len(first) :] == ["mine", "broken", "broken"], "what is wrong may be mended"


def test_a_robot_of_a_file_is_kept_until_the_file_changes_or_a_link_leads_elsewhere(tmp_path: Path) -> None:
    two, three, link = tmp_path / "two.urdf", tmp_path / "three.urdf", tmp_path / "arm.urdf"
    for file, joints in ((two, 2), (three, 3)):
        file.write_text(box_arm("y", joints).text)
    link.symlink_to(two)
    catalog, reference = Catalog(), UrdfFile(path=str(link))
    first = catalog.load(reference)
    assert len(first.joints) == 2
    assert catalog.load(reference) is first
    link.unlink()
    link.symlink_to(three)
    assert len(catalog.load(reference).joints) == 3
    three.write_text(box_arm("y", 4).text)
    assert len(catalog.load(reference).joints) == 4


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
