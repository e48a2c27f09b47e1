"""A disk that is really full: planning goes on, the reply says what is missing, and what is kept stays whole."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from guidefield.demo import REQUESTS
from guidefield.engine import Engine
from guidefield.errors import DiskRefused
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import RobotFiles, StoreRobot, StoreScene
from guidefield.messages.scene import Scene, Sphere
from guidefield.stores.robots import RobotStore
from guidefield.stores.runs import RunStore
from guidefield.stores.scenes import SceneStore
from tests.replies import plan_reply
from tests.robots import box_arm
from tests.stores.test_runs import CRASH, REQUEST

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
        assert not any(str(small_disk) in warning for warning in reply.warnings), (
            "where the files lie is nobody's business"
        )
    assert warned
    for run in store.summaries():
        assert run.status == "SUCCESS", "a run whose reply can't be kept isn't under way"
        whole = store.read(run.run_id)
        assert whole.request.robot == "panda"


def _filled(disk: Path) -> Path:
    """A file that takes all the room that is left."""
    filler = disk / "filler"
    with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
        while file.write(bytes(4096)):
            pass
    return filler


def test_a_run_whose_end_the_disk_refuses_is_dropped(small_disk: Path) -> None:
    store = RunStore(small_disk / "runs")
    for run_id in ("finished", "crashed", "swept"):
        store.begin(run_id, REQUEST)
    filler = _filled(small_disk)
    with pytest.raises(OSError, match="No space left"):
        store.finish("finished", plan_reply("finished"))
    _filled(small_disk)
    with pytest.raises(OSError, match="No space left"):
        store.fail("crashed", CRASH)
    _filled(small_disk)
    assert [run.run_id for run in store.summaries()] == ["swept"]
    store.sweep(CRASH)
    filler.unlink()
    assert store.summaries() == []
    store.begin("finished", REQUEST)
    store.finish("finished", plan_reply("finished"))
    assert [run.status for run in store.summaries()] == ["SUCCESS"]


def test_a_store_on_a_full_disk_says_so_without_a_path(small_disk: Path) -> None:
    engine = Engine(scenes=SceneStore(small_disk / "scenes"), robots=RobotStore(small_disk / "robots"))
    _filled(small_disk)
    for request in (
        StoreScene("ball", Scene("ball", obstacles=[Sphere(name="ball", radius=0.1)])),
        StoreRobot("arm", RobotFiles(urdf=box_arm("y", 2).text)),
    ):
        with pytest.raises(DiskRefused, match=r"^the disk refuses: No space left on device$"):
            engine.answer(request)
    assert not list((small_disk / "robots" / "contents").iterdir())
