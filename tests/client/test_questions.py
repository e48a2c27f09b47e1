"""Without a service or network: what is refused before anything is sent, read from an answer, and given up."""

import asyncio
import contextlib
from concurrent.futures import Future
from typing import Any

import msgspec
import pytest

from guidefield.client import asynchronous, client, questions
from guidefield.client.asynchronous import AsyncServiceStream
from guidefield.client.streams import ServiceStream
from guidefield.errors import InternalFailure, MalformedRequest, NoService, RequestTooLarge, StreamUnknown
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


class Exchange:
    """Brings no answer, or that nobody is there to be asked for the run's end."""

    def __init__(self, gone: bool) -> None:
        self.asked: list[str] = []
        self._gone = gone

    def watching_run(self, *_about: object) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def ask(self, question: Any) -> Future[bytes]:
        self.asked.append(question.key)
        answer: Future[bytes] = Future()
        if self._gone and len(self.asked) > 1:
            answer.set_exception(NoService("nobody answers"))
        return answer


@pytest.fixture(params=[False, True], ids=["silent", "gone"])
def exchange(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Exchange:
    for room in (asynchronous, client):
        monkeypatch.setattr(room, "GIVE_UP_WITHIN", 0.05)
    return Exchange(request.param)


def test_a_task_that_is_cancelled_is_cancelled(exchange: Exchange) -> None:
    async def journey() -> None:
        task = asyncio.create_task(asynchronous.AsyncClient(exchange).plan(PLAN))
        while not exchange.asked and not task.done():
            await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(journey())
    assert exchange.asked[0] == "plan"
    assert exchange.asked[1].endswith("/cancel")


def test_a_ctrl_c_is_a_ctrl_c(exchange: Exchange, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_answer: Future[bytes]) -> bytes:
        raise KeyboardInterrupt

    monkeypatch.setattr(client, "await_answer", interrupted)
    with pytest.raises(KeyboardInterrupt):
        client.Client(exchange).plan(PLAN)
    assert exchange.asked[1].endswith("/cancel")


ASKED: dict[str, Any] = {"robot": "ur5", "scene": "table"}


def test_one_that_was_never_opened_says_how_it_is() -> None:
    stream = ServiceStream(None, ASKED, {}, None)
    for ask in (stream.update, lambda: stream.at(0.0), lambda: list(stream)):
        with pytest.raises(StreamUnknown, match="isn't open yet: `with` opens it, for asyncio `async with`"):
            ask()
    stream.close()


def test_the_same_for_asyncio() -> None:
    async def go() -> None:
        stream = AsyncServiceStream(None, ASKED, {}, None)
        with pytest.raises(StreamUnknown, match="isn't open yet"):
            await stream.update()
        with pytest.raises(StreamUnknown, match="isn't open yet"):
            stream.at(0.0)
        with pytest.raises(StreamUnknown, match="isn't open yet"):
            async for _ in stream:
                pass
        await stream.close()

    asyncio.run(go())
