"""What a robot executes: pieces that follow what it executes and come in time, each to its stop otherwise."""

import numpy as np
import pytest

from guidefield import Piece
from guidefield.client.stream_link import Execution
from guidefield.messages.scene import Scene
from guidefield.messages.streams import PieceTrajectory, StreamOpen, StreamUpdate
from guidefield.scene.scene import build
from guidefield.stream.stream import CertifiedStream
from tests.robots import robot


def piece(number: int, follows: int, begins: float) -> Piece:
    """From 0 to 1 rad in a second, at rest at both ends."""
    times = [begins, begins + 0.5, begins + 1.0]
    told = PieceTrajectory(
        times=times,
        positions=[[0.0], [0.5], [1.0]],
        velocities=[[0.0], [1.5], [0.0]],
        accelerations=[[6.0], [0.0], [-6.0]],
    )
    return Piece(
        number=number,
        update=begins - 0.02,
        follows=follows,
        goal=1,
        begins=begins,
        brakes=begins + 0.5,
        stops=begins + 1.0,
        leads_to="goal",
        reaches_goal=True,
        position_names=["a"],
        trajectory=told,
        evaluations=1,
    )


def test_without_a_piece_it_stands_at_its_start() -> None:
    execution = Execution([0.25])
    assert execution.at(3.0).positions == (0.25,)
    assert (execution.executing(3.0), execution.stops(), execution.stands(3.0), execution.at_goal(3.0)) == (
        *(0, None, True),
        False,
    )


def test_a_piece_is_executed_from_its_beginning_to_its_end() -> None:
    execution = Execution([0.0])
    assert execution.take(piece(1, 0, 1.0), 0.9)
    assert execution.executing(0.99) == 0
    assert execution.executing(1.0) == 1
    assert execution.at(1.25).positions == pytest.approx([3.0 * 0.25**2 - 2.0 * 0.25**3])
    assert execution.at(1.25).velocities == pytest.approx([6.0 * 0.25 - 6.0 * 0.25**2])
    assert execution.at(1.25).accelerations == pytest.approx([6.0 - 12.0 * 0.25])
    assert not execution.stands(1.9)
    assert execution.at(5.0).positions == (1.0,)
    assert execution.at(5.0).velocities == (0.0,)
    assert execution.at_goal(5.0)


def test_a_late_piece_and_what_follows_another_one_are_left() -> None:
    execution = Execution([0.0])
    assert not execution.take(piece(1, 0, 1.0), 1.01)
    assert execution.late == 1
    assert not execution.take(piece(2, 1, 1.1), 1.02)
    assert execution.executing(2.0) == 0
    assert execution.take(piece(3, 0, 2.1), 2.0)
    assert execution.take(piece(4, 3, 2.2), 2.0)
    assert not execution.take(piece(5, 3, 2.3), 2.0)
    assert execution.executing(3.0) == 4


def test_it_is_where_the_stream_has_the_robot() -> None:
    """The same motion by the stream's own commits, which are other formulas."""
    goal = {"type": "joints", "positions": {"elbow_joint": 1.2, "shoulder_pan_joint": 0.4}}
    with CertifiedStream(StreamOpen("ur5", "empty"), robot("ur5"), build(Scene("empty"))) as stream:
        stream.aim_for(goal)
        execution = Execution(stream.executing.ends.tolist())
        for cycle in range(10):
            answer = stream.update(StreamUpdate(0.02 * cycle))
            assert isinstance(answer, Piece)
            assert execution.take(answer, 0.02 * cycle)
            for now in np.linspace(0.02 * cycle, 0.02 * cycle + 0.019, 5):
                if execution.executing(now) == 0:
                    continue
                state = stream._state.commits[execution.executing(now)].state(now)
                told = execution.at(now)
                assert np.allclose(told.positions, state[:, 0], rtol=0.0, atol=1e-9)
                assert np.allclose(told.velocities, state[:, 1], rtol=0.0, atol=1e-7)
                assert np.allclose(told.accelerations, state[:, 2], rtol=0.0, atol=1e-5)
