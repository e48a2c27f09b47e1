"""The phases of a stream: what leads from one to the next, and what is dropped on the way."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.errors import StreamUnknown
from guidefield.messages.goals import JointsGoal
from guidefield.messages.scene import Scene
from guidefield.messages.streams import StreamOpen
from guidefield.scene.scene import build
from guidefield.stream.state import PHASES, Event, Phase, State
from guidefield.stream.stream import CertifiedStream
from tests.robots import robot

ASKED = {Event.AIM: Phase.FOLLOWING, Event.STAND: Phase.STANDING, Event.STOP: Phase.HALTED, Event.CLOSE: Phase.CLOSED}


def test_clients_may_ask_for_anything_in_every_phase_but_in_a_closed_stream() -> None:
    for phase, row in PHASES.items():
        assert row.next.items() >= ({Event.CLOSE: Phase.CLOSED} if phase is Phase.CLOSED else ASKED).items()
        assert row.kept <= set(State.__struct_fields__)
    reached = {after for row in PHASES.values() for after in row.next.values()}
    assert reached == set(PHASES) == set(Phase)


def test_what_a_phase_does_not_have_is_dropped_when_it_begins() -> None:
    goal = JointsGoal({"elbow_joint": 0.5})
    with CertifiedStream(StreamOpen("ur5", "empty", goal=goal), robot("ur5"), build(Scene("empty"))) as stream:
        state, phases = stream._state, list[Phase]()
        for asked in (lambda: None, stream.stop, lambda: stream.aim_for(goal), lambda: stream.aim_for(None)):
            asked()
            phases.append(state.phase)
            kept = {name for name in ("pursuit", "ordered") if getattr(state, name) is not None}
            assert kept == PHASES[state.phase].kept
    assert phases == [Phase.FOLLOWING, Phase.HALTED, Phase.FOLLOWING, Phase.STANDING]
    assert state.phase is Phase.CLOSED
    for event in (Event.AIM, Event.STAND, Event.STOP, Event.ORDER):
        with pytest.raises(StreamUnknown):
            state.enter(event)


def test_another_goal_gives_up_the_way_that_is_planned() -> None:
    with CertifiedStream(StreamOpen("ur5", "empty"), robot("ur5"), build(Scene("empty"))) as stream:
        state = stream._state
        state.aim(np.zeros((1, 6)))
        state.enter(Event.ORDER)
        state.aim(np.ones((1, 6)))
        assert (state.phase, state.ordered, state.goal) == (Phase.FOLLOWING, None, 2)
