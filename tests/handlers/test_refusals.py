"""A refused request is told what is wrong with it and what would be right."""

from __future__ import annotations

from typing import Any

import pytest

import guidefield
from guidefield.errors import GuidefieldError, InvalidConfiguration, InvalidGoal, MalformedRequest, SceneInvalid

STILL: dict[str, Any] = {"name": "still", "obstacles": []}
JOINTS = {"type": "joints", "positions": {}}
PLANE = {"type": "guide_plane"}


@pytest.mark.parametrize(
    ("fields", "error", "words"),
    [
        ({"scene": STILL, "goal": PLANE}, InvalidGoal, "the scene has none; give some in `guide_planes`"),
        ({"scene": STILL, "goal": PLANE, "guide_planes": []}, InvalidGoal, "is empty; null takes the scene's"),
        ({"scene": STILL, "goal": PLANE, "planner": "tree"}, InvalidGoal, "planner 'tree' uses none"),
        ({"scene": "cell.json", "goal": JOINTS}, SceneInvalid, "a scene in a file is sent itself"),
        (
            {"scene": STILL, "goal": {"type": "pose", "position": (1, 0, 0), "quaternion_xyzw": (0, 0, 0.7, 0.7)}},
            MalformedRequest,
            "divide it by its norm",
        ),
        (
            {"robot": "panda", "scene": STILL, "goal": JOINTS, "start": {"panda_finger_joint2": 0.01}},
            InvalidConfiguration,
            "give 'panda_finger_joint1'",
        ),
    ],
)
def test_what_is_wrong_is_told_with_what_would_be_right(
    fields: dict[str, Any], error: type[GuidefieldError], words: str
) -> None:
    with pytest.raises(error, match=words):
        guidefield.answer({"robot": "ur5", **fields})
