"""Messages as a recording keeps them, and what is no recording of ours."""

from __future__ import annotations

from pathlib import Path

import pytest
import rerun as rr

from guidefield.errors import MalformedRequest
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.recorder.chunks import still
from guidefield.recorder.documents import pack, unpack
from guidefield.recorder.reading import read_recording
from guidefield.recorder.rrd_file import write_recording
from tests.recorder.runs import made_up


def test_what_is_packed_is_unpacked_or_refused() -> None:
    run = made_up("xarm7")
    content = bytes(pack(run.request))
    assert unpack(content, PlanRequest) == run.request
    assert unpack(bytes(pack(run.reply)), PlanReply) == run.reply
    for broken in (content[:-20], b"", b"hello", bytes(pack(run.reply))):
        with pytest.raises(ValueError, match="PlanRequest"):
            unpack(broken, PlanRequest)


def test_a_recording_of_something_else_is_refused(tmp_path: Path) -> None:
    said = still("/said", rr.TextDocument("hello"))
    write_recording(tmp_path / "foreign.rrd", "foreign", [said], None)
    with pytest.raises(MalformedRequest, match=r"no whole recording of guidefield.*: it has no '/__properties/plan'"):
        read_recording(tmp_path / "foreign.rrd")
