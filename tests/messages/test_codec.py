"""Requests made in Python: NumPy's numbers are numbers, and what a Struct was given is checked as a payload is."""

from typing import Any

import msgspec
import numpy as np
import pytest

from guidefield.engine import answer
from guidefield.errors import MalformedRequest
from guidefield.messages import codec
from guidefield.messages.codec import read_request
from guidefield.messages.requests import JointsGoal, PlanRequest, PoseGoal
from guidefield.messages.scene import Mesh, Scene

TURN = (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("kind", [float, np.float64, np.float32, np.int64])
def test_numpys_numbers_and_arrays_are_numbers_and_lists(kind: Any) -> None:
    joints = codec.decode_request(
        {"robot": "panda", "scene": "table", "goal": {"type": "joints", "positions": {"a": kind(2)}}}
    )
    assert joints == PlanRequest("panda", "table", JointsGoal({"a": 2.0}))
    asked = PlanRequest("panda", "table", PoseGoal(np.array([1, 2, 3], kind), np.array(TURN, kind)))
    pose = PlanRequest("panda", "table", PoseGoal((1.0, 2.0, 3.0), TURN))
    assert read_request(asked) == pose
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


def terrain(count: int = 2000) -> Mesh:
    """A mesh of so many triangles, more than are copied before they are checked."""
    vertices = [(float(i), float(i % 7), 0.5) for i in range(count + 2)]
    return Mesh(name="terrain", vertices=vertices, triangles=[(i, i + 1, i + 2) for i in range(count)])


def asked(mesh: Mesh) -> PlanRequest:
    return PlanRequest("panda", Scene("wide", obstacles=[mesh]), JointsGoal({}))


def test_long_lists_are_checked_and_are_the_requests_own() -> None:
    mesh = terrain()
    made = read_request(asked(mesh))
    assert made == asked(mesh)
    assert codec.decode_request(codec.encode(asked(mesh))) == made
    mesh.vertices[0] = (9.0, 9.0, 9.0)
    mesh.triangles[0] = (0, 2, 1)
    assert made == asked(terrain())


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int64])
def test_numpys_numbers_may_stand_in_long_lists(kind: Any) -> None:
    mesh = terrain()
    mesh.vertices[1500] = tuple(kind(k) for k in (1, 2, 3))
    mesh.triangles[1500] = tuple(np.array([3, 2, 1]))
    made = read_request(asked(mesh))
    mesh.vertices[1500], mesh.triangles[1500] = (1.0, 2.0, 3.0), (3, 2, 1)
    assert made == asked(mesh)


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("triangles", (0, 1), "(at $.scene.obstacles[0].triangles[1500])"),
        ("triangles", (0, 1, 2.5), "(at $.scene.obstacles[0].triangles[1500][2])"),
        ("triangles", (0, 1, 2002), "`triangles[1500]` names vertex 2002, but there are 2002 vertices"),
        ("triangles", (0, 1, -1), "`triangles[1500]` names vertex -1"),
        ("triangles", (0, 1, 2**40), "`triangles[1500]` names vertex 1099511627776"),
        ("triangles", (0, 1, True), "(at $.scene.obstacles[0].triangles[1500][2])"),
        ("vertices", (0.0, 0.0, "1"), "(at $.scene.obstacles[0].vertices[1500][2])"),
        ("vertices", (0.0, 0.0, float("nan")), "`vertices[1500][2]` must be a finite number"),
    ],
)
def test_what_is_wrong_in_long_lists_is_told(field: str, value: Any, says: str) -> None:
    mesh = terrain()
    getattr(mesh, field)[1500] = value
    with pytest.raises(MalformedRequest) as malformed:
        read_request(asked(mesh))
    assert says in malformed.value.message
