"""Recordings of judgements: request and reply to the last bit."""

from __future__ import annotations

from pathlib import Path

import pytest

from guidefield.engine import Engine
from guidefield.messages.replies import CertifyReply
from guidefield.messages.requests import CertifyRequest
from guidefield.recorder.stored import read_recording
from tests.recorder.runs import Recording

HOME = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]
TURN = [0.4, *HOME[1:]]


@pytest.fixture(scope="module")
def engine() -> Engine:
    return Engine()


def recorded(engine: Engine, file: Path, **request) -> tuple[CertifyReply, Recording]:
    reply = engine.answer({"type": "certify", "robot": "panda", "scene": "table", **request}, record_to=file)
    assert reply.recording == str(file), reply.warnings
    return reply, Recording(file)


def test_messages_are_read_back_to_the_last_bit(engine: Engine, tmp_path: Path) -> None:
    samples = {"positions": [HOME, TURN, HOME], "times": [0.0, 1.7, 3.3]}
    reply, recording = recorded(engine, tmp_path / "r.rrd", trajectory=samples, recording="summary")
    found = read_recording(tmp_path / "r.rrd")
    assert isinstance(found.request, CertifyRequest)
    assert found.request.trajectory.times == samples["times"]
    assert found.reply == reply
    assert "guidefield" in found.versions
    assert {"/plots/velocity", "/plots/use/acceleration"} <= recording.entities
    assert not any(entity.startswith("/field") for entity in recording.entities)
    (summary,) = recording.one("/documents/summary", "TextDocument:text")
    assert "| acceleration |" in summary
