"""A fault of a request is told with its place, from the root of what was sent, and with what would be right."""

import base64
import contextlib
import json
import math
import struct
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, strategies as st

import guidefield
from guidefield.errors import GuidefieldError, MalformedRequest
from guidefield.messages import codec, requests
from guidefield.messages.codec import Encoding
from guidefield.messages.faults import find_nonfinite_word, find_number_out_of_range
from guidefield.messages.requests import PlanRequest

REQUEST: dict[str, Any] = {"robot": "panda", "scene": "bookshelf", "goal": {"type": "guide_plane"}}
BOX: dict[str, Any] = {"type": "box", "name": "crate", "size": [0.2, 0.2, 0.2]}

FORMS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "dict": codec.decode_request,
    "json": lambda request: codec.decode_request(msgspec.json.encode(request)),
    "msgpack": lambda request: codec.decode(msgspec.msgpack.encode(request), PlanRequest, codec.Encoding.MSGPACK),
}


def _scene(*obstacles: dict[str, Any]) -> dict[str, Any]:
    return {"name": "mine", "obstacles": list(obstacles)}


def _refused(form: str, fields: dict[str, Any]) -> MalformedRequest:
    with pytest.raises(MalformedRequest) as malformed:
        FORMS[form]({**REQUEST, **fields})
    return malformed.value


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("fields", "path", "says"),
    [
        ({"scene": _scene(BOX, {**BOX, "type": "boxx"})}, "$.scene.obstacles[1].type", "did you mean 'box'?"),
        ({"scene": _scene({**BOX, "type": "torus"})}, "$.scene.obstacles[0].type", "'half_space', 'point_cloud'"),
        ({"scene": _scene({**BOX, "sizes": 1})}, "$.scene.obstacles[0]", "did you mean `size`?"),
        ({"planner": "rrt"}, "$.planner", "Invalid enum value 'rrt'; valid: 'auto', 'guided', 'tree'"),
        ({"guide_planes": "found"}, "$.guide_planes", "valid: 'auto', a list, null"),
        ({"schema": 2}, "$.schema", "valid: 1"),
        ({"gaol": 1}, "$", "unknown field `gaol`; did you mean `goal`?"),
        ({"colour": 1}, "$", "valid: `robot`, `scene`, `goal`"),
        ({"goal": {"type": "poses"}}, "$.goal.type", "did you mean 'pose'?"),
        ({"robot": {"type": "urdf_text"}}, "$.robot.type", "valid: 'urdf', 'urdf_file'"),
        ({"start": {"a": 1.0, "b": "1", "c": 2}}, "$.start.b", "Expected `float | array`, got `str`"),
        ({"start": {"a": 1.0, "b ": "1", "c": 2}}, "$.start['b ']", "Expected `float | array`, got `str`"),
        ({"limits": {"x": {"velocity": 1}, "y": {"velocity": 0}}}, "$.limits.y.velocity", "> 0.0"),
        ({"limits": {"x": {"jerk": 1}, "y": {"jrk": 1}}}, "$.limits.y", "did you mean `jerk`?"),
        ({"limits": {"x": {"jerk": 1e10}}}, "$.limits.x.jerk", "`jerk` must be within 1e+09"),
        ({"goal": {"type": "joint_set", "positions": [{"a": 1}, {"b": 1, "c": "x"}]}}, "$.goal.positions[1].c", "str"),
        ({"start": {"a": 1e10}}, "$.start.a", "`start.a` must be within 1e+09, got 1"),
        ({"start": {"a": [0.0, 1e10]}}, "$.start.a[1]", "`start.a[1]` must be within 1e+09"),
    ],
)
def test_a_fault_is_told_with_what_would_be_right(form: str, fields: dict[str, Any], path: str, says: str) -> None:
    error = _refused(form, fields)
    assert error.details["path"] == path
    assert says in error.message


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        (b'{"robot": "panda",\n "goal": }', "line 2, column 10"),
        (b'{"robot": "panda"', "truncated"),
        (b" \n", "it is empty"),
        (b'{"robot": "panda", broken', "line 1, column 20"),
        (b"[" * 100_000, "at $"),
    ],
)
def test_what_is_no_json_is_told_with_its_line(payload: bytes, says: str) -> None:
    with pytest.raises(MalformedRequest) as malformed:
        codec.decode_request(payload)
    assert says in malformed.value.message


def test_a_payload_that_is_broken_behind_its_fault_is_refused_for_the_first() -> None:
    with pytest.raises(MalformedRequest, match="Expected `str"):
        codec.decode(b'{"robot": 1, broken', PlanRequest)


def test_large_payloads_are_not_looked_at_twice() -> None:
    text = "x" * codec.MAX_EXPLAINED_BYTES
    error = _refused("json", {"robot": {"type": "urdf", "text": text}, "planner": "rrt"})
    assert error.message == "Invalid enum value 'rrt' (at $.planner)"


PLAIN = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@given(st.sampled_from(sorted(PlanRequest.__struct_fields__)), PLAIN)
def test_telling_a_fault_never_fails(field: str, value: Any) -> None:
    for form in FORMS.values():
        with contextlib.suppress(MalformedRequest):
            form({**REQUEST, field: value})


GOAL = {"type": "joints", "positions": {"elbow_joint": 1.2}}
UNIT_BOX = {"type": "box", "name": "box", "size": [1, 1, 1]}


def plan(**fields: Any) -> dict[str, Any]:
    return {"robot": "ur5", "scene": {"name": "e"}, "goal": GOAL, **fields}


def cloud(points: Any) -> dict[str, Any]:
    scan = {"type": "point_cloud", "name": "scan", "points": points, "radius": 0.01}
    return plan(scene={"name": "p", "obstacles": [UNIT_BOX, scan]})


def refused(request: Any) -> GuidefieldError:
    with pytest.raises(GuidefieldError) as found:
        guidefield.answer(request)
    return found.value


def forms(points: list[list[float]]) -> list[Any]:
    """A cloud in every form that can carry numbers that aren't finite."""
    packed = struct.pack(f"<{3 * len(points)}f", *np.ravel(points))
    return [points, np.array(points), np.array(points, np.float32), {"float32": packed}]


@pytest.mark.parametrize("many", [2, 1500])
@pytest.mark.parametrize(("value", "says"), [(math.nan, "finite"), (-math.inf, "finite"), (1e10, "within 1e\\+09")])
def test_a_number_that_is_no_place_is_named_in_every_form(value: float, says: str, many: int) -> None:
    points = [[0.0, 0.0, 0.0]] * many
    points[-1] = [0.0, value, 0.0]
    path = f"$.scene.obstacles[1].points[{many - 1}][1]"
    for form in forms(points):
        error = refused(cloud(form))
        assert error.details["path"] == path
        assert f"`points[{many - 1}][1]` must be" in error.message
    for form in forms(points)[::3]:
        payload = msgspec.msgpack.encode(cloud(form))
        with pytest.raises(MalformedRequest, match=says) as found:
            codec.decode(payload, requests.PlanRequest, Encoding.MSGPACK)
        assert found.value.details["path"] == path
    packed = {"float32": base64.b64encode(forms(points)[3]["float32"]).decode()}
    assert refused(json.dumps(cloud(packed)).encode()).details["path"] == path


@pytest.mark.parametrize("word", ["NaN", "Infinity", "-Infinity"])
def test_words_that_are_no_json_are_named_with_their_place(word: str) -> None:
    error = refused(json.dumps(cloud([[1, 1, 1], [1, float(word), 1]])).encode())
    assert error.details["path"] == "$.scene.obstacles[1].points[1][1]"
    assert f"{word} is no number of JSON" in error.message
    assert "(line 1, column " in error.message


@pytest.mark.parametrize("number", ["1e999", "-1e400", "9" * 400])
def test_a_number_that_no_float_holds_is_named_with_its_joint(number: str) -> None:
    payload = json.dumps(plan(limits={"wrist_1_joint": {"velocity": 1}, "elbow_joint": {"velocity": 7}}))
    error = refused(payload.replace("7", number).encode())
    assert error.details["path"] == "$.limits.elbow_joint.velocity"


@given(
    st.recursive(
        st.none() | st.floats() | st.integers() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    )
)
def test_only_odd_numbers_are_found(plain: Any) -> None:
    payload = json.dumps(plain).encode()
    assert find_number_out_of_range(payload) is None
    assert (find_nonfinite_word(payload) is None) == (json.dumps(plain) == msgspec_would_read(payload))


def msgspec_would_read(payload: bytes) -> str | None:
    try:
        msgspec.json.decode(payload)
    except msgspec.DecodeError:
        return None
    return payload.decode()


ZERO = {"position": [0, 0, 1], "quaternion_xyzw": [0, 0, 0, 0]}
ZEROS: list[tuple[dict[str, Any], str]] = [
    (plan(goal={"type": "pose", **ZERO}), "$.goal.quaternion_xyzw"),
    (plan(goal=None, steps=[{"goal": {"type": "pose", **ZERO}}]), "$.steps[0].goal.quaternion_xyzw"),
    (plan(robot_placement=ZERO), "$.robot_placement.quaternion_xyzw"),
    (plan(scene={"name": "s", "obstacles": [UNIT_BOX | ZERO]}), "$.scene.obstacles[0].quaternion_xyzw"),
    (plan(attached_objects=[{"obstacle": UNIT_BOX, "link": "tool0", "placement": ZERO}]),
     "$.attached_objects[0].placement.quaternion_xyzw"),
    ({"type": "inverse_kinematics", "robot": "ur5", "poses": [ZERO]}, "$.poses[0].quaternion_xyzw"),
]  # fmt: skip


@pytest.mark.parametrize(("request_", "path"), ZEROS)
def test_a_zero_quaternion_is_said_to_be_one(request_: dict[str, Any], path: str) -> None:
    error = refused(request_)
    assert error.details["path"] == path
    assert "`quaternion_xyzw` is zero, which is no rotation" in error.message
