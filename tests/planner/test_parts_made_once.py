"""Tables of a robot and of a scene: a plan makes each part at most once, a second plan in the same scene makes none."""

from collections import Counter
from typing import Any

import pytest

from guidefield import memo
from guidefield.engine import Engine
from guidefield.errors import Status
from guidefield.messages.requests import JointsGoal, PlanRequest
from guidefield.messages.scene import Box, Scene
from guidefield.robot.group.group import Alike
from guidefield.robot.model.model import RobotModel
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene as BuiltScene

SCENE = Scene("two boxes", obstacles=[
    Box(name="left", size=(0.1, 0.1, 0.4), position=(0.5, 0.4, 0.3)),
    Box(name="right", size=(0.1, 0.1, 0.4), position=(0.5, -0.4, 0.3)),
])  # fmt: skip
REQUEST = PlanRequest(robot="panda", scene=SCENE, goal=JointsGoal({"panda_joint1": 0.6}), allowed_planning_time=60.0)

Made = Counter[tuple[object, ...]]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Made:
    """How often each part was made, by its function, its owner and what else was asked; the owners live on."""
    counts, keep, owners = Made(), memo.Answers.keep, list[object]()

    def counted(self: Any, owner: object, asked: object, answer: Any) -> Any:
        if answer is not True and isinstance(owner, Alike | RobotModel | Obstacle | BuiltScene):  # True marks work done
            counts[self._number, type(owner).__name__, id(owner), asked] += 1
            owners.append(owner)
        return keep(self, owner, asked, answer)

    monkeypatch.setattr(memo.Answers, "keep", counted)
    return counts


def _status(engine: Engine) -> int:
    reply = engine.answer(REQUEST)
    return reply.status.code


def test_a_plan_makes_each_part_once_and_the_next_one_none(made: Made) -> None:
    engine = Engine()
    assert _status(engine) == Status.SUCCESS
    assert made, "the first plan makes parts"
    assert {part: count for part, count in made.items() if count > 1} == {}
    made.clear()
    assert _status(engine) == Status.SUCCESS
    assert dict(made) == {}
