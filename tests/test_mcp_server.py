"""A client of the protocol talks to `guidefield mcp` over standard input and output, as a model's host does.

In words each outcome has its advice, and figures are those of the reply.
"""

import asyncio
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import guidefield
from guidefield import mcp_server
from guidefield.cli.serving import free_port
from guidefield.errors import ERRORS, ServerBusy, Status
from guidefield.mcp_server import ADVICE, TOOLS, advise
from guidefield.messages import codec
from guidefield.messages.requests import Clearance, PlanRequest
from tests.examples import example
from tests.journeys.service import running_service

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
    told = mcp_server.describe_error(kind("the moon is not a robot", retry_after=2.5))
    assert told.startswith(f"{kind.code.name}: the moon is not a robot. {ADVICE[kind.code]}")
    assert told.endswith("Ask again in 2.5 s.")
    assert "Ask again in" not in mcp_server.describe_error(ServerBusy("busy"))


def test_a_plan_in_words_has_the_figures_of_the_reply() -> None:
    goal = {"type": "joints", "positions": {"elbow_joint": 1.2}}
    reply = guidefield.answer({"robot": "ur5", "scene": BALL, "goal": goal, "run_id": "r-1", "recording": "off"})
    told = mcp_server.describe_plan(reply)
    assert told.startswith("SUCCESS: ")
    assert f"{reply.metrics.duration:.2f} s" in told
    assert f"{1e3 * reply.clearance.minimum:.1f} mm between {' and '.join(reply.clearance.pair)}" in told
    assert "free: the trajectory" in told
    assert "run_id 'r-1'" in told
    refused = guidefield.answer({"robot": "ur5", "scene": BALL, "goal": {"type": "pose", "position": [9, 9, 9],
                                 "quaternion_xyzw": [0, 0, 0, 1]}, "recording": "off"})  # fmt: skip
    told = mcp_server.describe_plan(refused)
    assert told.startswith(f"NO_IK_SOLUTION: {refused.status.message}")
    assert ADVICE[Status.NO_IK_SOLUTION] in told
    assert "`trajectory`" not in told


def test_a_verdict_in_words_says_where_and_between_what() -> None:
    request = {"type": "certify", "robot": "ur5", "scene": BALL, "position_names": ["shoulder_pan_joint"]}
    free = mcp_server.describe_verdict(guidefield.answer({**request, "path": [[-1.0], [-1.2]], "recording": "off"}))
    assert free.startswith("SUCCESS: ")
    reply = guidefield.answer(
        {**request, "path": [[0.0], [7.5]], "recording": "off", "start": {"shoulder_lift_joint": -0.6}}
    )
    told = mcp_server.describe_verdict(reply)
    if reply.certificate.pair:
        assert " and ".join(reply.certificate.pair) in told
    assert "It is certified until" in told
    assert "% of its position limit, which is beyond it" in told or reply.limits.position.share <= 1.0


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_the_schema_of_a_tool_is_one(tool: guidefield.mcp_server.Tool) -> None:
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


UR5 = {"robot": "ur5", "scene": "table"}
ELBOW = {"type": "joints", "positions": {"elbow_joint": 1.2}}


def _talk(endpoint: str, calls: list[tuple[str, dict[str, Any]]]) -> tuple[Any, list[Any]]:
    """The tools that a server lists, and what it answers to calls of them."""

    mcp = pytest.importorskip("mcp", reason="pip install 'guidefield[mcp]'")

    async def talk() -> tuple[Any, list[Any]]:
        command = ["-m", "guidefield", "mcp", "--connect", endpoint]
        server = mcp.StdioServerParameters(command=sys.executable, args=command)
        async with mcp.Client(mcp.stdio_client(server)) as client:
            listed = await client.list_tools()
            return listed, [await client.call_tool(name, given) for name, given in calls]

    return asyncio.run(talk())


def test_a_model_plans_and_asks_for_what_it_needs(tmp_path: Path) -> None:
    with running_service(tmp_path, "--workers", "1", "--prepare", "ur5") as service:
        pose = {"position": [0.4, 0.2, 0.9], "quaternion_xyzw": [1, 0, 0, 0]}
        listed, answers = _talk(
            service.endpoint,
            [
                ("robots", {}),
                ("robot", {"name": "ur5"}),
                ("scenes", {}),
                ("scene", {"name": "table"}),
                ("plan", {**UR5, "goal": ELBOW, "guide_planes": [], "run_id": "m-1", "allowed_planning_time": 60}),
                ("trajectory", {"run_id": "m-1"}),
                ("clearance", {**UR5, "configurations": [{"elbow_joint": 1.2}]}),
                ("inverse_kinematics", {"robot": "ur5", "poses": [pose], "solutions": 2}),
                ("certify", {**UR5, "path": [[1.2], [1.0]], "position_names": ["elbow_joint"]}),
                ("plan", {**UR5, "goal": ELBOW, "planer": "tree"}),
                ("plan", {"robot": "ur6", "scene": "table", "goal": ELBOW}),
                ("scene", {}),
                ("scene", {"name": 7}),
                ("move", {}),
            ],
        )
    assert [tool.name for tool in listed.tools] == [tool.name for tool in TOOLS]
    assert all(tool.annotations.read_only_hint for tool in listed.tools)
    assert [answer.is_error for answer in answers] == [False] * 9 + [True] * 5
    told = [answer.content[0].text for answer in answers]
    robots, robot, scenes, scene, plan, motion, clearance, reached, judged = (
        answer.structured_content for answer in answers[:9]
    )
    assert "ur5 (6)" in told[0]
    assert "ur5" in {one["name"] for one in robots["robots"]}
    assert robot["tip"] in told[1]
    assert "table" in scenes["scenes"]
    assert all(obstacle["name"] in told[3] for obstacle in scene["obstacles"])
    assert told[4].startswith("SUCCESS: ")
    assert plan["knots"] == len(motion["times"])
    elbow = motion["position_names"].index("elbow_joint")
    assert motion["positions"][-1][elbow] == pytest.approx(1.2)
    here = guidefield.answer({"type": "clearance", **UR5, "configurations": [{"elbow_joint": 1.2}]})
    assert clearance["minimum"] == pytest.approx(here.minimum)
    assert f"{1e3 * here.minimum[0]:.1f} mm" in told[6]
    for found in reached["configurations"][0]:
        asked = {"type": "forward_kinematics", "robot": "ur5", "frames": [robot["tip"]], "configurations": [found]}
        placed = guidefield.answer(asked).placements[0][0]
        assert np.allclose(placed.position, pose["position"], atol=1e-4)
    assert judged["certificate"]["collision_free"]
    assert "plan takes no 'planer'" in told[9]
    assert told[10].startswith("ROBOT_INVALID: ")
    assert "Ask `robots` for the names." in told[10]
    assert [answer.structured_content["name"] for answer in answers[11:]] == ["MALFORMED_REQUEST"] * 3
    assert "scene needs 'name'" in told[11]
    assert "there is no tool 'move'; there are plan, certify" in told[13]


def test_where_no_service_is_every_call_says_so() -> None:
    with free_port() as port:
        _, answers = _talk(f"tcp/127.0.0.1:{port}", [("scenes", {})])
    for answer in answers:
        assert answer.is_error
        assert answer.content[0].text.startswith("COMMUNICATION_FAILURE: nobody listens at")
        assert "`guidefield serve`" in answer.content[0].text
