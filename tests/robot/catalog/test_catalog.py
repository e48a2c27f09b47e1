"""The list of robots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from guidefield.messages.replies import RobotSummary
from guidefield.messages.requests import UrdfFile
from guidefield.robot.catalog import catalog as catalogs
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.catalog.library import SentRobot
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


def test_robots_are_summarized_once_and_those_that_were_sent_when_they_change(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
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
