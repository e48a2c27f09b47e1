"""Ways that are taken over when they are found, what is noted without an answer, and how much a stream knows."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from guidefield.errors import RequestTooLarge
from guidefield.messages.scene import Scene, Sphere
from guidefield.messages.streams import Observation, Piece, StreamObstacle, StreamOpen, StreamState, StreamUpdate
from guidefield.messages.values import JointsGoal, Placement
from guidefield.scene.scene import build
from guidefield.stream.path_planner import AtRecordedTimes, TakeOver, WhenReady
from guidefield.stream.stream import CertifiedStream
from tests.robots import robot

EMPTY = build(Scene("empty"))
BALL = StreamObstacle(Sphere(name="ball", radius=0.12), 0.3)
ASKED = StreamOpen(
    "ur5",
    "empty",
    JointsGoal({"shoulder_pan_joint": 1.6, "elbow_joint": 1.0}),
    start={"shoulder_lift_joint": -1.0, "elbow_joint": 1.0},
    obstacles=[BALL],
)
IN_THE_WAY = Placement((0.45, 0.45, 0.35))


def opened(taking: TakeOver | None = None, asked: StreamOpen = ASKED) -> CertifiedStream:
    return CertifiedStream(asked, robot("ur5"), EMPTY, taking)


def seen(now: float, placement: Placement = IN_THE_WAY) -> Observation:
    return Observation("ball", now, placement)


def test_what_was_taken_over_when_it_was_found_is_repeated_to_the_bit() -> None:
    taking, at, answers = WhenReady(), [], []
    with opened(taking) as stream:
        for cycle in range(120):
            now = 0.02 * cycle
            answers.append(stream.update(StreamUpdate(now, [seen(now)])))
            if taking.last == now:
                at.append(now)
            if cycle % 7 == 0 and stream._state.ordered is not None:  # some are found in time, some are not
                stream._state.ordered.found.result()
    assert at, "a way was planned and taken over"
    with opened(AtRecordedTimes(at)) as again:
        assert [again.update(StreamUpdate(0.02 * k, [seen(0.02 * k)])) for k in range(120)] == answers
    assert any(isinstance(one, Piece) for one in answers)


def test_what_is_noted_counts_like_what_is_answered() -> None:
    """Where obstacles are is known all the same; who comes for the first time is told of with the next answer."""
    with opened() as noted, opened() as answered:
        for stream in (noted, answered):
            stream.update(StreamUpdate(0.0))
        assert noted.note(StreamUpdate(0.02, [seen(0.02)])) is None
        answered.update(StreamUpdate(0.02, [seen(0.02)]))
        assert noted._obstacles.oldest == answered._obstacles.oldest == 0.02
        assert np.array_equal(noted._obstacles.boxes([0.1]), answered._obstacles.boxes([0.1]))
        late = noted.note(StreamUpdate(0.01))
        assert isinstance(late, StreamState)
        assert late.reason == "late"
        assert noted._state.fresh
        noted.update(StreamUpdate(0.04))
        assert not noted._state.fresh


def test_a_stream_knows_so_many_obstacles_and_forgets_those_that_are_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guidefield.stream.obstacles.MOST_STREAM_OBSTACLES", 3)

    def ball(name: str) -> StreamObstacle:
        return StreamObstacle(msgspec.structs.replace(BALL.obstacle, name=name), 0.3)

    with opened() as stream:
        far = Placement((3.0, 0.0, 0.0))
        stream.update(StreamUpdate(0.0, [seen(0.0, far)], declare=[ball("b"), ball("c")]))
        with pytest.raises(RequestTooLarge, match=r"declare\[0\]`: a stream knows 3 obstacles at most"):
            stream.update(StreamUpdate(0.02, declare=[ball("d")]))
        stream.update(StreamUpdate(0.04, [seen(0.04, far)], gone=["b"]))
        stream.update(StreamUpdate(0.06, [seen(0.06, far)], declare=[ball("d")]))
        assert stream._obstacles.names == ["ball", "c", "d"]
        stream.update(StreamUpdate(0.08, [seen(0.08, far)], gone=["c"]))
        with pytest.raises(RequestTooLarge, match=r"declare\[1\]`"):  # who is declared again makes no room
            stream.update(StreamUpdate(0.1, declare=[ball("c"), ball("e")]))
        assert stream._obstacles.known["c"].gone
        assert stream._obstacles.names == ["ball", "c", "d"]
