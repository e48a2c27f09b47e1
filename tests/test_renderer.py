"""The process that renders recordings: the newest first, again when it dies, given up where that doesn't help."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import msgspec
import pytest

from guidefield import renderer as module
from guidefield.engine import Engine
from guidefield.engines import Engines, EngineSetup
from guidefield.messages.identities import PLAIN
from guidefield.messages.requests import JointsGoal, PlanRequest
from guidefield.pool.pool import DEFAULT_MEMORY
from guidefield.pool.process import Work
from guidefield.renderer import MAX_ATTEMPTS, Renderer
from guidefield.stores.recordings import Recordings
from guidefield.stores.runs import RunDatabase

PATIENCE = 300.0
PLAN = PlanRequest("ur5", "table", JointsGoal({"elbow_joint": 1.2}), guide_planes=[], recording="summary")


def prepare_awake(setup: EngineSetup) -> Work:
    """Prepare the process without the lowest priority: a busy machine would leave it no processor."""
    return partial(module._render, setup.engines())


class Dying(EngineSetup):
    """Prepares engines that end their process."""

    def engines(self, database: RunDatabase | None = None) -> Engines:
        engines = super().engines(database)
        engines.render = lambda *_: os._exit(3)
        return engines


class Refusing(EngineSetup):
    """Prepares engines that can't write until there is room."""

    def engines(self, database: RunDatabase | None = None) -> Engines:
        engines, render, data = super().engines(database), Engines.render, self.data

        def refuse(owner: str, run_id: str) -> None:
            if not (data / "room").exists():
                raise OSError(28, "No space left on device")
            render(engines, owner, run_id)

        engines.render = refuse
        return engines


@dataclass
class Rendering:
    """A renderer of runs, the newest of which is the last, and those that it is done with."""

    renderer: Renderer
    recordings: Recordings
    runs: int
    done: list[str] = field(default_factory=list)

    def await_that(self, so: Callable[[], bool]) -> None:
        until = time.monotonic() + PATIENCE
        while not so():
            assert time.monotonic() < until
            time.sleep(0.01)

    @property
    def process(self) -> int | None:
        worker = self.renderer._pool._slots[0].worker
        return None if worker is None else worker.process.pid

    def kinds(self) -> set[str]:
        return {self.recordings.describe(f"r{number}").kind for number in range(self.runs)}


@pytest.fixture
def rendering(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Rendering]]:
    monkeypatch.setattr(module, "RETRY_INTERVAL_S", 0.1)
    monkeypatch.setattr(module, "_prepare", prepare_awake)
    database, made = RunDatabase(tmp_path), list[Rendering]()

    def make(setup: type[EngineSetup], runs: int = 1, memory: int = DEFAULT_MEMORY) -> Rendering:
        engine = Engine(recordings=database.recordings(PLAIN))
        done: list[str] = []
        renderer = Renderer(setup(tmp_path), memory, database.recordings, lambda _, run_id: done.append(run_id))
        made.append(Rendering(renderer, database.recordings(PLAIN), runs, done))
        for number in range(runs):
            engine.answer(msgspec.structs.replace(PLAN, run_id=f"r{number}"))
            renderer.add(PLAIN, f"r{number}")
        renderer.start()
        return made[-1]

    yield make
    for one in made:
        one.renderer.close()
    database.close()


def test_the_newest_come_first_and_a_killed_process_is_started_again(rendering: Callable[..., Rendering]) -> None:
    asked = rendering(EngineSetup, runs=3)
    asked.await_that(lambda: asked.done == ["r2"])
    assert asked.process is not None
    os.kill(asked.process, signal.SIGKILL)
    asked.await_that(lambda: len(asked.done) == 3)
    assert asked.kinds() == {"rendered"}
    assert asked.renderer.memory > 0
    asked.renderer.close()
    assert asked.renderer.memory == 0


def test_what_ends_its_process_again_and_again_is_given_up(rendering: Callable[..., Rendering]) -> None:
    asked = rendering(Dying)
    asked.await_that(lambda: asked.done == ["r0"])
    assert asked.kinds() == {"lost"}
    told = (asked.recordings.folder / "r0.lost").read_text()
    why = "the process that worked on this request died with exit code 3"
    assert told == f"it can't be rendered: {why}, {MAX_ATTEMPTS} times"


def test_what_takes_too_much_memory_is_given_up(rendering: Callable[..., Rendering]) -> None:
    asked = rendering(EngineSetup, memory=1 << 20)
    asked.await_that(lambda: asked.done == ["r0"])
    assert asked.kinds() == {"lost"}
    assert "rendering it takes more than 1 MiB of memory" in (asked.recordings.folder / "r0.lost").read_text()


def test_a_disk_that_refuses_is_asked_again(rendering: Callable[..., Rendering], tmp_path: Path, caplog) -> None:
    asked = rendering(Refusing)
    asked.await_that(lambda: caplog.text.count("is tried again: No space left on device") > 1)
    assert asked.kinds() == {"owed"}
    (tmp_path / "room").touch()
    asked.await_that(lambda: asked.done == ["r0"])
    assert asked.kinds() == {"rendered"}
