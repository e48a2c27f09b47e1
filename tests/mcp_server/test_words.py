"""Replies in words: each outcome has its advice, and figures are those of the reply."""

import json
import re

import pytest

import guidefield
from guidefield.errors import ERRORS, ServerBusy, Status
from guidefield.mcp_server import words
from guidefield.mcp_server.server import TOOLS
from guidefield.mcp_server.words import ADVICE, advise
from guidefield.messages import codec
from guidefield.messages.requests import Clearance, PlanRequest
from tests.examples import example

jsonschema = pytest.importorskip("jsonschema", reason="it comes with the package mcp")

BALL = {"name": "one", "obstacles": [{"type": "sphere", "name": "ball", "radius": 0.1, "position": [0.6, 0.6, 0.3]}]}


def test_every_outcome_but_success_has_its_advice() -> None:
    assert set(ADVICE) == set(Status) - {Status.SUCCESS}
    assert advise(1) == advise(-4711) == ""
    tools = {tool.name for tool in TOOLS}
    fields = {*PlanRequest.__struct_fields__, "allowed_time", "tree"}
    for sentence in ADVICE.values():
        named = set(re.findall(r"`(\w+)`", sentence))
        assert named <= tools | fields, named - tools - fields


@pytest.mark.parametrize("kind", ERRORS.values(), ids=lambda kind: kind.__name__)
def test_an_error_says_its_name_its_message_and_what_to_do(kind: type[guidefield.GuidefieldError]) -> None:
    told = words.describe_error(kind("the moon is not a robot", retry_after=2.5))
    assert told.startswith(f"{kind.code.name}: the moon is not a robot. {ADVICE[kind.code]}")
    assert told.endswith("Ask again in 2.5 s.")
    assert "Ask again in" not in words.describe_error(ServerBusy("busy"))


def test_a_plan_in_words_has_the_figures_of_the_reply() -> None:
    goal = {"type": "joints", "positions": {"elbow_joint": 1.2}}
    reply = guidefield.answer({"robot": "ur5", "scene": BALL, "goal": goal, "run_id": "r-1", "recording": "off"})
    told = words.describe_plan(reply)
    assert told.startswith("SUCCESS: ")
    assert f"{reply.metrics.duration:.2f} s" in told
    assert f"{1e3 * reply.clearance.minimum:.1f} mm between {' and '.join(reply.clearance.pair)}" in told
    assert "free: the trajectory" in told
    assert "run_id 'r-1'" in told
    refused = guidefield.answer({"robot": "ur5", "scene": BALL, "goal": {"type": "pose", "position": [9, 9, 9],
                                 "quaternion_xyzw": [0, 0, 0, 1]}, "recording": "off"})  # fmt: skip
    told = words.describe_plan(refused)
    assert told.startswith(f"NO_IK_SOLUTION: {refused.status.message}")
    assert ADVICE[Status.NO_IK_SOLUTION] in told
    assert "`trajectory`" not in told


def test_a_verdict_in_words_says_where_and_between_what() -> None:
    request = {"type": "certify", "robot": "ur5", "scene": BALL, "position_names": ["shoulder_pan_joint"]}
    free = words.describe_verdict(guidefield.answer({**request, "path": [[-1.0], [-1.2]], "recording": "off"}))
    assert free.startswith("SUCCESS: ")
    reply = guidefield.answer(
        {**request, "path": [[0.0], [7.5]], "recording": "off", "start": {"shoulder_lift_joint": -0.6}}
    )
    told = words.describe_verdict(reply)
    if reply.certificate.pair:
        assert " and ".join(reply.certificate.pair) in told
    assert "It is certified until" in told
    assert "% of its position limit, which is beyond it" in told or reply.limits.position.share <= 1.0


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_the_schema_of_a_tool_is_one(tool: guidefield.mcp_server.server.Tool) -> None:
    jsonschema.Draft202012Validator.check_schema(tool.schema)
    assert tool.schema["type"] == "object"
    assert tool.schema["additionalProperties"] is False
    assert "type" not in tool.schema["properties"]


@pytest.mark.parametrize("title", ["door", "conveyor"])
def test_what_the_schema_lets_through_is_a_request(title: str) -> None:
    plan = next(tool for tool in TOOLS if tool.name == "plan")
    given = json.loads(example(title))
    jsonschema.validate(given, plan.schema)
    assert codec.decode_request(given)
    for wrong in ({**given, "planer": "tree"}, {**given, "min_clearance": -1.0}, {"robot": "panda"}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(wrong, plan.schema)
        with pytest.raises(guidefield.MalformedRequest):
            codec.decode_request(wrong)
    clearance = next(tool for tool in TOOLS if tool.name == "clearance")
    asked = {"robot": "ur5", "scene": "table", "configurations": [{}]}
    jsonschema.validate(asked, clearance.schema)
    assert codec.convert({"type": "clearance", **asked}, Clearance)
