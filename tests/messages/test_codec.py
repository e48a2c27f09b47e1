"""Requests made in Python: NumPy's numbers are numbers, and what a Struct was given is checked as a payload is."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from guidefield.engine import answer
from guidefield.errors import MalformedRequest
from guidefield.messages import codec
from guidefield.messages.requests import Clearance, JointsGoal, PlanRequest, PoseGoal, Potential
from guidefield.messages.scene import PointCloud, Scene
from guidefield.messages.values import Float32Array

TURN = (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("kind", [float, np.float64, np.float32, np.int64])
def test_numpys_numbers_and_arrays_are_numbers_and_lists(kind: Any) -> None:
    joints = codec.decode_request(
        {"robot": "panda", "scene": "table", "goal": {"type": "joints", "positions": {"a": kind(2)}}}
    )
    assert joints == PlanRequest("panda", "table", JointsGoal({"a": 2.0}))
    asked = PlanRequest("panda", "table", PoseGoal(np.array([1, 2, 3], kind), np.array(TURN, kind)))  # type: ignore[arg-type]
    pose = PlanRequest("panda", "table", PoseGoal((1.0, 2.0, 3.0), TURN))
    assert codec.checked(asked) == pose
    for encoding in codec.Encoding:
        assert codec.decode(codec.encode(asked, encoding), PlanRequest, encoding) == pose


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"planner": "rrt"}, "valid: 'auto', 'guided', 'tree' (at $.planner)"),
        ({"min_clearance": -1.0}, ">= 0.0 (at $.min_clearance)"),
        ({"allowed_collisions": [("hand",)]}, "(at $.allowed_collisions[0])"),
        ({"scene": object()}, "'object' is neither a number"),
        ({"goal": 3}, "(at $.goal)"),
    ],
)
def test_what_a_struct_was_given_is_checked(fields: dict[str, Any], says: str) -> None:
    request = msgspec.structs.replace(PlanRequest("panda", "table", JointsGoal({})), **fields)
    with pytest.raises(MalformedRequest) as malformed:
        answer(request)
    assert says in malformed.value.message


def test_a_checked_struct_is_what_it_was() -> None:
    cloud = PointCloud(name="scan", radius=0.1, points=Float32Array(np.ones(6, "<f4").tobytes()))
    for request in (
        Potential(Scene("mine", obstacles=[cloud]), points=[(0.0, 0.0, 0.0)]),
        Clearance("panda", "table", [{"panda_joint1": 0.1}]),
        PlanRequest("panda", Scene("mine", obstacles=[cloud]), JointsGoal({"a": [0.0, 1.0]})),
    ):
        assert codec.checked(request) == request
