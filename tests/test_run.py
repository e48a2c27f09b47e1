"""Whoever watches a run hears how far it is, and can end it; what it found by then comes back."""

from typing import Any

import msgspec
import pytest

from guidefield.cli.demonstration import REQUESTS
from guidefield.collision.clearance import clearance_at
from guidefield.collision.world import World
from guidefield.engine import Engine
from guidefield.messages.replies import PlanReply, Progress
from guidefield.run import ProgressReporter

REQUEST = msgspec.structs.replace(REQUESTS["demo-guide-planes"][1], run_id="watched")


class _Watcher:
    """Keeps what it hears; ends the run at a stage."""

    def __init__(self, end_at: str | None = None, *, listens: bool = True) -> None:
        self.heard: list[Progress] = []
        self._end_at, self._listens = end_at, listens
        self.prepared = False

    def is_listened_to(self) -> bool:
        return self._listens

    def tell(self, what: bytes) -> None:
        self.heard.append(msgspec.json.decode(what, type=Progress))

    def be_prepared(self) -> None:
        self.prepared = True

    def is_cancelled(self) -> bool:
        return any(progress.stage == self._end_at for progress in self.heard)


@pytest.fixture(scope="module")
def engine() -> Engine:
    return Engine()


def _planned(engine: Engine, watcher: _Watcher | None) -> PlanReply:
    return engine.answer(REQUEST, watcher=watcher)


def test_every_stage_is_told_and_nothing_changes_for_it(engine: Engine) -> None:
    watcher = _Watcher()
    watched, unwatched = _planned(engine, watcher), _planned(engine, None)
    assert watcher.prepared
    assert watched.path == unwatched.path
    assert watched.trajectory == unwatched.trajectory
    told = list(dict.fromkeys(progress.stage for progress in watcher.heard if progress.stage != "load"))
    assert told == list(dict.fromkeys(stage.name for stage in watched.stages))
    assert [progress.elapsed for progress in watcher.heard] == sorted(progress.elapsed for progress in watcher.heard)
    assert watcher.heard[-1].elapsed <= watched.timing.total


def test_nothing_is_measured_for_progress_that_nobody_hears(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[object] = []
    monkeypatch.setattr(ProgressReporter, "_measure", measured.append)
    watcher = _Watcher(listens=False)
    _planned(engine, watcher)
    assert watcher.prepared
    assert not watcher.heard
    assert not measured


def test_the_clearance_told_is_that_of_a_step(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guidefield.run.MIN_PERIOD_S", 0.0)
    asked: list[float] = []

    def overheard(world: World, q: Any) -> Any:
        found = clearance_at(world, q)
        asked.append(found.obstacle_distance)
        return found

    monkeypatch.setattr("guidefield.collision.clearance.clearance_at", overheard)
    watcher = _Watcher()
    _planned(engine, watcher)
    told = [progress.clearance for progress in watcher.heard if progress.clearance is not None]
    assert told
    assert set(told) <= set(asked)
    best = [progress.best_clearance for progress in watcher.heard if progress.best_clearance is not None]
    assert best == [max(told[: n + 1]) for n in range(len(told))]


@pytest.mark.parametrize("stage", ["ends", "guide", "relax"])
def test_a_run_that_is_ended_is_preempted_with_the_best_by_then(stage: str, engine: Engine) -> None:
    watcher = _Watcher(end_at=stage)
    reply = _planned(engine, watcher)
    assert reply.status.name == "PREEMPTED"
    assert reply.path
    if stage == "relax":  # by then there is a motion, and it is a whole one
        assert reply.certificate.collision_free
        assert reply.trajectory is not None
