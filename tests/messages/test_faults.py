"""What is wrong with a request is told with its place and with what would be right there."""

import contextlib
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from hypothesis import given, strategies as st

from guidefield.errors import MalformedRequest
from guidefield.messages import codec
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
