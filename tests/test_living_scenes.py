"""Scenes that change, through the door: answers are those in the same scene alone, and versions stay what they were."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from guidefield.engine import Engine
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import ReadScene
from guidefield.messages.scene import Box, Scene
from guidefield.stores.scenes import SceneStore
from tests.handlers.test_plan import READY

COUNT = 400
TIMES = {"timing", "run_id", "recording", "planner_version"}  # what differs between replies to the same question


@pytest.fixture
def engine(tmp_path: Path) -> Engine:
    return Engine(scenes=SceneStore(tmp_path))


def crumbs() -> list[dict[str, Any]]:
    """Boxes all about a robot, a floor, and a tetrahedron."""
    rng = np.random.default_rng(4)
    places = rng.uniform(-2.5, 2.5, (3 * COUNT, 3))
    clear = places[np.hypot(places[:, 0], places[:, 1]) > 0.8][:COUNT].tolist()
    boxes = [{"type": "box", "name": f"b{k}", "size": [0.04, 0.03, 0.02], "position": at} for k, at in enumerate(clear)]
    corners = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    mesh = {"type": "mesh", "name": "cone", "vertices": corners, "triangles": faces, "position": [0.5, -0.6, 0.2]}
    return [{"type": "half_space", "name": "floor", "normal": [0, 0, 1], "offset": -0.3}, *boxes, mesh]


def store(engine: Engine) -> None:
    engine.answer({"type": "store_scene", "name": "cell", "scene": {"name": "cell", "obstacles": crumbs()}})


def change(engine: Engine, **diff: Any) -> int:
    return engine.answer({"type": "change_scene", "name": "cell", "diff": {"type": "scene_diff", **diff}}).version


def plan(engine: Engine, scene: Any) -> PlanReply:
    goal = {"type": "joints", "positions": {**READY, "panda_joint1": 1.2, "panda_joint2": 0.3}}
    asked = {"robot": "panda", "scene": scene, "start": READY, "goal": goal, "guide_planes": [], "recording": "off"}
    return engine.answer({**asked, "allowed_planning_time": 60.0})


def told(reply: PlanReply) -> dict[str, Any]:
    """All that a reply says but how long it took."""
    plain: dict[str, Any] = msgspec.to_builtins(reply)
    for stage in plain.get("stages") or []:
        stage.pop("seconds", None)
    return {name: value for name, value in plain.items() if name not in TIMES}


def declared(engine: Engine, version: int | None = None) -> Scene:
    reply = engine.answer(ReadScene(name="cell", version=version))
    return reply.scene


CHANGES: list[dict[str, Any]] = [
    {"move": {"b7": {"position": [0.45, 0.3, 0.55]}}},
    {"move": {"b7": {"position": [2.0, 2.0, 2.0]}, "cone": {"position": [0.55, 0.35, 0.3]}}},
    {
        "remove": ["b20", "b100"],
        "add": [{"type": "sphere", "name": "ball", "radius": 0.07, "position": [0.3, 0.5, 0.5]}],
    },
    {"remove": ["floor", "ball"], "move": {"b1": {"position": [0.5, 0.2, 0.6], "quaternion_xyzw": [0, 0, 0.6, 0.8]}}},
]


def test_a_plan_in_a_changed_scene_has_the_bits_of_one_in_the_same_scene_alone(engine: Engine) -> None:
    store(engine)
    replies = [told(plan(engine, "cell"))]
    for diff in CHANGES:
        change(engine, **diff)
        replies.append(told(plan(engine, "cell")))
        alone = plan(Engine(), declared(engine))
        assert alone.status.name == "SUCCESS"
        assert replies[-1] == told(alone)
    assert len({str(reply["trajectory"]) for reply in replies}) > 2, "the changes are in the way"
    for version, reply in enumerate(replies, start=1):
        assert told(plan(engine, {"base": "cell", "version": version})) == reply


def test_changes_of_a_request_have_the_bits_of_the_same_scene_alone(engine: Engine) -> None:
    store(engine)
    stored = plan(engine, "cell")
    asked = {"base": "cell", **CHANGES[0]}
    first, again = plan(engine, asked), plan(engine, asked)
    change(engine, **CHANGES[0])
    assert told(first) == told(again) == told(plan(Engine(), declared(engine)))
    assert told(plan(engine, {"base": "cell", "version": 1})) == told(stored)


def test_several_processes_see_the_same(engine: Engine, tmp_path: Path) -> None:
    other = Engine(scenes=SceneStore(tmp_path))
    store(engine)
    assert told(plan(other, "cell")) == told(plan(engine, "cell"))
    for diff in CHANGES:
        change(engine, **diff)
    assert told(plan(other, "cell")) == told(plan(engine, "cell")) == told(plan(Engine(), declared(engine)))


def test_the_field_of_a_version_is_its_own(engine: Engine) -> None:
    def potential(scene: Any) -> list[float]:
        reply = engine.answer({"type": "potential", "scene": scene, "points": [[0.5, 0.4, 0.5], [1.0, 1.0, 1.0]]})
        return reply.potential

    store(engine)
    before = potential("cell")
    change(engine, **CHANGES[0])
    assert potential("cell") != before
    assert potential({"base": "cell", "version": 1}) == before


def test_who_was_given_a_scene_may_change_it(engine: Engine) -> None:
    store(engine)
    change(engine, **CHANGES[0])
    before, given = told(plan(engine, "cell")), declared(engine)
    mesh = given.obstacles[-1]
    mesh.vertices[0] = (0.0, 0.0, 9.0)
    given.obstacles[3] = Box(name="huge", size=(3.0, 3.0, 3.0))
    given.obstacles.pop(0)
    assert told(plan(engine, "cell")) == before
    assert [one.name for one in declared(engine).obstacles][:2] == ["floor", "b0"]
    change(engine, **CHANGES[1])
    assert told(plan(engine, "cell")) == told(plan(Engine(), declared(engine)))
