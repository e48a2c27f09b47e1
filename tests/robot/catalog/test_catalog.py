"""The list of robots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from guidefield.messages.replies import RobotSummary
from guidefield.robot.catalog import catalog as catalogs
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.catalog.sent import SentRobot
from tests.robots import box_arm


def test_robots_are_summarized_once_and_those_that_were_sent_when_they_change(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def counted(summarize: Callable[..., RobotSummary]) -> Callable[..., RobotSummary]:
        def summarized(one: Any, *rest: Any) -> RobotSummary:
            asked.append(one.name)
            return summarize(one, *rest)

        return summarized

    for name in ("summarize", "summarize_sent"):
        monkeypatch.setattr(catalogs, name, counted(getattr(catalogs, name)))
    catalog = Catalog()
    mine = SentRobot("mine", "a" * 64, box_arm("y", 2).text, None, {}, "fixed")
    first = catalog.summaries([mine])
    assert len(asked) == len(first)
    assert catalog.summaries([mine]) == first
    assert len(asked) == len(first)
    other = replace(mine, content="b" * 64, urdf=box_arm("y", 3).text)
    broken = replace(mine, name="broken", urdf="<robot/>")
    lines = {line.name: line for line in catalog.summaries([other, broken])}
    assert (lines["mine"].dof, first[-1].dof) == (3, 2)
    assert lines["broken"].problem
    assert asked[len(first) :] == ["mine", "broken"]
    catalog.summaries([other, broken])
    assert asked[len(first) :] == ["mine", "broken", "broken"], "what is wrong may be mended"
