"""The first use of a robot and of what it holds: prepared before a request's time begins."""

import time

import numpy as np
import pytest

from guidefield.engine import Engine
from guidefield.errors import UnknownObject
from guidefield.handlers.attached import holding
from guidefield.handlers.certify import lay_out_ahead
from guidefield.handlers.plan import prepare_ahead
from guidefield.messages.conditions import AttachedObject
from guidefield.messages.requests import Attach, CertifyRequest, JointsGoal, PlanRequest, PlanStep, UrdfText
from guidefield.messages.scene import Box, Mesh, Scene
from guidefield.messages.values import Placement
from guidefield.robot.link_bounds import COVERS, DELTA, MOST_PARTS, PARTS
from guidefield.scene.scene import build
from tests.robots import box_arm
from tests.scene.solids import l_prism, mesh_message


def new_mesh(name: str) -> Mesh:
    """A mesh of a size that nobody has seen."""
    vertices, triangles = l_prism()
    return mesh_message(vertices * np.random.default_rng().uniform(0.01, 0.02), triangles, name)


@pytest.mark.parametrize("named", [True, False])
def test_a_judgements_tables_are_made_before_its_time_begins(named: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    engine, arm = Engine(), UrdfText(box_arm("y x slide", 3).text)
    request = CertifyRequest(
        robot=arm,
        scene=Scene(name="s", obstacles=[Box(name="box", size=(0.1, 0.1, 0.1), position=(3.0, 0.0, 0.0))]),
        path=[[0.0, 0.0, 0.0], [0.1, 0.1, 0.1]] if not named else [[0.0], [0.1]],
        position_names=["j2"] if named else None,
        attached_objects=[AttachedObject(new_mesh("held"), "l3", Placement(position=(0.0, 0.0, 0.5)), ["l2"])],
    )
    lay_out_ahead(request, engine._load_robot)

    def late(*_: object) -> None:
        raise AssertionError("it was to be made before")

    monkeypatch.setattr("guidefield.collision.part_tables.PartsTable.add_shape", late)
    monkeypatch.setattr("guidefield.collision.solids._of_links", late)
    reply = engine.answer(request, received=time.monotonic())
    assert reply.status.name == "SUCCESS"


def test_what_steps_pick_up_is_prepared_before_their_time_begins() -> None:
    engine, arm = Engine(), UrdfText(box_arm("y x slide", 3).text)
    scene = Scene(name="s", obstacles=[new_mesh("part"), new_mesh("other")])
    step = PlanStep(goal=JointsGoal({"j1": 0.1}), attach=Attach("part"))
    request = PlanRequest(robot=arm, scene=scene, steps=[step])
    assert not prepare_ahead(request, engine._load_robot, engine._find_scene_message)
    assert prepare_ahead(request, engine._load_robot, engine._find_scene_message)

    robot, nowhere = engine._load_robot(arm), build(Scene(name="nowhere"))
    for obstacle, known in ((scene.obstacles[0], True), (scene.obstacles[1], False)):
        there = AttachedObject(obstacle, "l2", Placement(position=(0.1, 0.2, 0.3)))
        held = holding(robot, [there], nowhere)
        assert (not COVERS.search(held, DELTA).tasks and not PARTS.search(held, MOST_PARTS).tasks) == known


def test_what_cannot_be_picked_up_is_refused_when_the_request_is_answered() -> None:
    engine, arm = Engine(), UrdfText(box_arm("y x slide", 3).text)
    step = PlanStep(goal=JointsGoal({"j1": 0.1}), attach=Attach("nothing"))
    request = PlanRequest(robot=arm, scene=Scene(name="s"), steps=[step])
    with pytest.raises(UnknownObject, match="nothing"):
        engine.answer(request)
