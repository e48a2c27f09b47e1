"""A client of the protocol talks to `guidefield mcp` over standard input and output, as a model's host does."""

import asyncio
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import guidefield
from guidefield.cli.serving import free_port
from guidefield.mcp_server.server import TOOLS
from tests.journeys.service import running_service

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
