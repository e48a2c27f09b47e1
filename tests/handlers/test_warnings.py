"""Whatever is odd about robot, held objects, scene and request reaches whoever asks."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from guidefield.engine import Engine
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import JointsGoal, PlanRequest
from guidefield.messages.scene import Mesh, Scene
from guidefield.stores.scenes import SceneStore
from tests.handlers.test_plan import READY
from tests.robots import box_arm
from tests.scene.solids import box_mesh, mesh_message


def in_single_triangles(name: str, size: float, width: float, **fields: Any) -> Mesh:
    """A box of triangles that share no corner."""
    vertices, triangles = box_mesh(size)
    corners = vertices[triangles].reshape(-1, 3)
    corners += np.random.default_rng(0).uniform(-0.25, 0.25, corners.shape) * width
    return mesh_message(corners, np.arange(len(corners)).reshape(-1, 3), name, **fields)


def scene(*obstacles: Any) -> dict[str, Any]:
    return {"name": "odd", "obstacles": [msgspec.to_builtins(one) for one in obstacles]}


@pytest.fixture
def engine(tmp_path: Path) -> Engine:
    return Engine(scenes=SceneStore(tmp_path))


def plan(engine: Engine, in_scene: Any, **request: Any) -> PlanReply:
    goal = {"type": "joints", "positions": {**READY, "panda_joint1": 0.2}}
    asked = {"robot": "panda", "scene": in_scene, "start": READY, "goal": goal, "guide_planes": [], **request}
    return engine.answer({**asked, "allowed_planning_time": 60.0})


FAR: dict[str, Any] = {"position": (3.0, 0.0, 0.0)}


def test_a_robot_in_a_box_with_cracks_is_told_both(engine: Engine) -> None:
    reply = plan(engine, scene(in_single_triangles("vat", 6.0, 1e-5)))
    assert reply.status.name == "START_STATE_IN_COLLISION"
    assert "wholly inside" in reply.status.message
    assert any("'vat'" in warning and "cracks" in warning for warning in reply.warnings)


def test_warnings_of_robot_scene_and_start_are_the_plans(engine: Engine) -> None:
    open_box = in_single_triangles("bin", 0.2, 0.01, **FAR)
    reply = plan(engine, scene(open_box), start={**READY, "panda_joint4": -0.0698 + 3e-6})
    assert any("'bin'" in warning and "open" in warning for warning in reply.warnings)
    assert any("clamped" in warning for warning in reply.warnings)


@pytest.mark.parametrize(
    ("start", "goal", "turns"),
    [(0.0, 90.0, "14.3"), (45.0, -45.0, "14.3"), (90.0, 91.0, None), (0.0, -12.5, None), (-1.5, 1.5, None)],
)
def test_a_continuous_joints_goal_in_degrees_is_told(engine, start, goal, turns):
    request = PlanRequest(box_arm("continuous", 1), Scene("empty"), JointsGoal({"j1": goal}), start={"j1": start})
    told = [warning for warning in engine.answer(request).warnings if "radians" in warning]
    words = f"the goal of joint 'j1' is hardly in radians: {goal:g} is {turns} turns from the start"
    assert told == ([words] if turns else [])


def test_warnings_of_a_stored_scene_are_told_when_it_is_stored_and_planned_in(engine: Engine) -> None:
    odd = scene(in_single_triangles("bin", 0.2, 0.01, **FAR))
    stored = engine.answer({"type": "store_scene", "name": "odd", "scene": odd})
    assert any("'bin'" in warning for warning in stored.warnings)
    assert any("'bin'" in warning for warning in plan(engine, "odd").warnings)


def test_warnings_of_what_is_held_are_the_plans(engine: Engine) -> None:
    held = {
        "obstacle": msgspec.to_builtins(in_single_triangles("part", 0.02, 1e-5)),
        "link": "panda_hand",
        "placement": {"position": (0.0, 0.0, 0.3)},
    }
    reply = plan(engine, scene(), attached_objects=[held])
    assert reply.status.name == "SUCCESS", reply.status.message
    told = [warning for warning in reply.warnings if "'part'" in warning]
    assert len(told) == 1
    assert told[0].startswith("`attached_objects[0]`")
    assert "cracks" in told[0]


@pytest.mark.parametrize(
    "request_",
    [
        {"type": "inverse_kinematics", "poses": [{"position": (0.4, 0.0, 0.5), "quaternion_xyzw": (1, 0, 0, 0)}]},
        {"type": "clearance", "configurations": [READY]},
        {"type": "potential", "configurations": [READY]},
        {"type": "potential", "points": [(0.0, 0.0, 0.0)], "robot": None},
    ],
)
def test_warnings_of_robot_and_scene_are_those_of_kinematics(engine: Engine, request_: dict[str, Any]) -> None:
    odd = scene(in_single_triangles("bin", 0.2, 0.01, **FAR))
    asked = {"robot": "panda", "scene": odd, **request_}
    reply = engine.answer({name: value for name, value in asked.items() if value is not None})
    warnings = reply.warnings
    assert any("'bin'" in warning for warning in warnings)


def test_configurations_beyond_limits_are_answered_with_a_warning(engine: Engine) -> None:
    beyond: list[dict[str, Any]] = [{}, {"elbow_joint": 7.0}, {"elbow_joint": 6.0}]
    of = {"robot": "ur5", "scene": {"name": "e"}}
    pose = {"position": [0.4, 0.2, 0.4], "quaternion_xyzw": [1, 0, 0, 0]}
    asked: dict[str, Any] = {
        "configurations": {**of, "type": "clearance", "configurations": beyond},
        "start_configurations": {**of, "type": "inverse_kinematics", "poses": [pose], "start_configurations": beyond},
    }
    for field, request in asked.items():
        (warning,) = engine.answer(request).warnings
        assert warning.startswith(f"`{field}[1]` has joint elbow_joint at 7, 3.86 beyond its limits")
    assert engine.answer({**of, "type": "clearance", "configurations": [{"elbow_joint": 3.0}]}).warnings == []
