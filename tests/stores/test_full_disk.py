"""A disk that is really full: planning goes on, the reply says what is missing, and what is kept stays whole."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from guidefield.demo import REQUESTS
from guidefield.engine import Engine
from guidefield.messages.replies import PlanReply
from guidefield.stores.runs import RunStore

ROOM = 768
"""Of the disk [KiB]: for a few requests and replies, and no more than a recording or two."""


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    mount = ["mount", "-t", "tmpfs", "-o", f"size={ROOM}k", "tmpfs", str(tmp_path)]
    try:
        subprocess.run(mount, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("a small disk can't be mounted here; that takes root")
    yield tmp_path
    subprocess.run(["umount", str(tmp_path)], check=True)


def test_plans_go_on_when_the_disk_is_full(small_disk: Path) -> None:
    store = RunStore(small_disk / "runs")
    engine = Engine(runs=store)
    request = REQUESTS["demo-guide-planes"][1]
    warned = 0
    for number in range(12):
        reply = engine.answer(msgspec.structs.replace(request, run_id=f"r{number}"))
        assert isinstance(reply, PlanReply)
        assert reply.status.name == "SUCCESS"
        told = [warning for warning in reply.warnings if "No space left" in warning]
        warned += bool(told)
        assert told or store.read(reply.run_id).reply == reply
        assert (reply.recording is None) == any(
            "recording was not" in warning or "run is not" in warning for warning in told
        )
    assert warned
    for run in store.summaries():
        whole = store.read(run.run_id)
        assert whole.request.robot == "panda"
