"""A large request is not read where that takes longer than it allows."""

from __future__ import annotations

import json
import time

import pytest

import guidefield
from guidefield import Box, CertifyRequest, JointsGoal, Mesh, PlanRequest, Scene
from guidefield.messages import codec, reading
from guidefield.messages.keys import CertifyHead
from guidefield.messages.reading import is_of_many, too_long_to_read

TRIANGLES = 60_000
PATH = [[0.0] * 9, [0.1] * 9]


def _scene() -> Scene:
    corners = [(k % 300 * 0.01, k // 300 * 0.01, -2.0) for k in range(TRIANGLES)]
    triangles = [(k, (k + 1) % TRIANGLES, (k + 7) % TRIANGLES) for k in range(TRIANGLES)]
    return Scene("many", obstacles=[Mesh(name="field", vertices=corners, triangles=triangles)])


@pytest.fixture(scope="module")
def plan() -> PlanRequest:
    return PlanRequest("panda", _scene(), JointsGoal({"panda_joint1": 0.8}), run_id="mine", allowed_planning_time=0.01)


def test_a_plan_that_allows_less_than_reading_takes_is_told_so_at_once(plan: PlanRequest) -> None:
    payload, answer = codec.encode(plan), guidefield.answer
    codec.decode_request(payload)
    began = time.process_time()
    codec.decode_request(payload)
    reading_it, began = time.process_time() - began, time.process_time()
    reply = answer(payload)
    assert time.process_time() - began < 0.5 * reading_it
    assert isinstance(reply, guidefield.PlanReply)
    assert (reply.run_id, reply.status.name, reply.status.details["stage"]) == ("mine", "TIMED_OUT", "load")
    assert "takes longer than the 0.01 s" in reply.status.message


def test_a_judgement_too(plan: PlanRequest) -> None:
    payload = codec.encode(CertifyRequest("panda", plan.scene, path=PATH, allowed_time=0.01))
    assert too_long_to_read(payload, time.monotonic()) == CertifyHead(None, 0.01)
    reply = guidefield.answer(payload)
    assert isinstance(reply, guidefield.CertifyReply)
    assert reply.status.name == "TIMED_OUT"


@pytest.mark.parametrize(
    "payload",
    [
        codec.encode(PlanRequest("panda", "table", JointsGoal({}), allowed_planning_time=1e-9)),
        b'{"robot": ' + b" " * reading.LARGE,
        b'{"type": "read_scenes"' + b" " * reading.LARGE + b"}",
        b'{"allowed_planning_time": 1e-9' + b" " * codec.MAX_REQUEST_BYTES + b"}",  # it is refused for its length
        {"robot": "panda"},
    ],
)
def test_what_is_small_or_broken_or_no_motion_is_read(payload: object) -> None:
    assert too_long_to_read(payload, time.monotonic() - 1.0) is None


def test_who_does_not_say_how_long_it_allows_is_not_looked_through(
    plan: PlanRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = json.loads(codec.encode(plan))
    del asked["allowed_planning_time"]
    payload = json.dumps(asked).encode()
    assert len(payload) > reading.LARGE
    monkeypatch.delattr(reading, "_HEADS")  # what looks through it
    assert too_long_to_read(payload, time.monotonic()) is None


def test_what_allows_enough_is_read(plan: PlanRequest) -> None:
    payload = codec.encode(PlanRequest("panda", plan.scene, plan.goal, allowed_planning_time=20.0))
    assert too_long_to_read(payload, time.monotonic()) is None
    assert too_long_to_read(payload, time.monotonic() - 20.0) is not None


@pytest.mark.parametrize("kind", ["mesh", "boxes"])
def test_how_long_reading_takes_is_known_within_a_factor_of_two(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading.time, "monotonic", time.process_time)
    boxes = [Box(name=f"b{k}", position=(k * 0.01, 2.0, 0.123456), size=(0.1, 0.2, 0.3)) for k in range(20_000)]
    scene = _scene() if kind == "mesh" else Scene("boxes", obstacles=boxes)

    def payload(allowed: float) -> bytes:
        return codec.encode(PlanRequest("panda", scene, JointsGoal({"j": 0.8}), allowed_planning_time=allowed))

    best = min(_seconds(lambda: codec.decode_request(payload(1.0))) for _ in range(3))
    best -= min(_seconds(lambda: payload(1.0)) for _ in range(3))
    few, many = (payload(share * best) for share in (0.5, 2.5))
    assert any(too_long_to_read(few, time.process_time()) is not None for _ in range(5))
    assert any(too_long_to_read(many, time.process_time()) is None for _ in range(5))


def test_many_are_known_in_every_form(plan: PlanRequest) -> None:
    boxes = [Box(name=f"b{k}", size=(0.1, 0.2, 0.3)) for k in range(reading.MANY)]
    for count, many in ((reading.MANY, True), (reading.MANY // 2, False)):
        scene = Scene("boxes", obstacles=list(boxes[:count]))
        request = PlanRequest("panda", scene, JointsGoal({"j": 0.8}))
        for form in (request, codec.encode(request), codec.plain_fields({"scene": scene})):
            assert is_of_many(form) is many
    assert is_of_many(plan), "its triangles become tuples"
    assert not any(map(is_of_many, (codec.encode(plan), {"scene": "table"}, {}, "text", None)))


def _seconds(done: object) -> float:
    began = time.process_time()
    done()  # type: ignore[operator]
    return time.process_time() - began
