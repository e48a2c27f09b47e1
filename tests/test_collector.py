"""The collector of garbage waits while something is loaded, and no longer."""

from __future__ import annotations

import gc

import pytest

from guidefield import Engine, Potential, engine
from guidefield.collector import pause_collector


def test_it_waits_within_and_runs_again_after_a_fault() -> None:
    def broken() -> None:
        with pause_collector():
            assert not gc.isenabled()
            raise RuntimeError

    with pytest.raises(RuntimeError):
        broken()
    assert gc.isenabled()


def test_it_waits_for_the_first_answer_that_needs_kernels_only(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []
    compiled = engine.compile_kernels
    monkeypatch.setattr(
        engine, "compile_kernels", lambda told, **options: (seen.append(gc.isenabled()), compiled(told, **options))
    )
    asked, answering = Potential(scene="table", points=[(0.0, 0.0, 1.0)]), Engine()
    dispatch = answering._dispatch
    monkeypatch.setattr(answering, "_dispatch", lambda *a: (seen.append(gc.isenabled()), dispatch(*a))[1])
    for _ in range(2):
        answering.answer(asked)
        assert gc.isenabled()
    assert seen == [False, False, True]
