"""What is asked, without a network: what is refused before anything is sent, and what is read from an answer."""

import msgspec
import pytest

from guidefield.client import questions
from guidefield.errors import InternalFailure, MalformedRequest, RequestTooLarge
from guidefield.messages.codec import MAX_REQUEST_BYTES
from guidefield.messages.requests import JointsGoal, PlanRequest, Potential, ReadRuns
from guidefield.messages.scene import Scene, Sphere

PLAN = PlanRequest(robot="panda", scene="table", goal=JointsGoal(positions={}))


def test_a_plan_is_asked_for_with_a_request_or_with_its_fields() -> None:
    by_fields = questions.plan(None, {"robot": "panda", "scene": "table", "goal": {"type": "joints", "positions": {}}})
    for question in (by_fields, questions.plan(PLAN, {})):
        sent = msgspec.msgpack.decode(question.payload, type=PlanRequest)
        assert msgspec.structs.replace(sent, run_id=None) == PLAN
        assert sent.run_id == question.run_id is not None


def test_scenes_and_kinematics_requests_may_be_plain_data() -> None:
    scene = {"name": "mine", "obstacles": [{"type": "sphere", "name": "ball", "radius": 0.1}]}
    ball = Sphere(name="ball", radius=0.1)
    assert questions.store_scene(scene).payload == questions.store_scene(Scene("mine", obstacles=[ball])).payload
    asked = questions.kinematics({"type": "potential", "scene": "table", "points": [[0.1, 0, 0.9]], "request_id": "r"})
    assert (
        asked.payload
        == questions.kinematics(Potential(scene="table", points=[(0.1, 0.0, 0.9)], request_id="r")).payload
    )
    with pytest.raises(MalformedRequest, match=r"did you mean `radius`\?.*obstacles\[0\]"):
        questions.store_scene({"name": "mine", "obstacles": [{"type": "sphere", "name": "ball", "radus": 0.1}]})


def test_a_request_and_fields_are_refused_together() -> None:
    with pytest.raises(MalformedRequest, match=r"not both.*seed"):
        questions.plan(PLAN, {"seed": 1})


def test_what_no_service_would_read_is_not_sent() -> None:
    with pytest.raises(RequestTooLarge):
        questions.store_robot("mine", "<robot/>", meshes={"package://mine/part.stl": bytes(MAX_REQUEST_BYTES)})


def test_an_answer_of_another_kind_is_said_to_be_one() -> None:
    with pytest.raises(InternalFailure, match="scenes/table"):
        questions.scene("table", None).read(msgspec.msgpack.encode({"robots": []}))


def test_what_changes_something_is_not_asked_twice() -> None:
    changes = (questions.delete_robot("a"), questions.delete_scene("a"), questions.delete_run("a"))
    assert not any(question.repeatable for question in changes)
    assert questions.store_scene(Scene(name="a")).repeatable


@pytest.mark.parametrize("name", ["", "a/b", "panda?delete", "**", "a;b", "$*", "a#b"])
def test_a_name_is_a_name_and_nothing_else(name: str) -> None:
    asked = (
        questions.robot,
        questions.delete_scene,
        questions.run,
        questions.recording,
        questions.stream_recording,
        questions.cancel,
    )
    for ask in asked:
        with pytest.raises(MalformedRequest, match="name"):
            ask(name)
    with pytest.raises(MalformedRequest, match="name"):
        questions.runs(ReadRuns(robot=name))
