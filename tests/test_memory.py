"""Memory: a bounded map keeps what was used last, the collector waits no longer than loading, a worker levels off."""

import gc
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from guidefield import Engine, Potential, engine
from guidefield.memory import BoundedMap, Limit, pause_collector


def test_the_entry_used_least_recently_goes_first() -> None:
    known = BoundedMap[str, str](Limit(2, 100))
    for key in "ab":
        known.insert(key, key.upper())
    assert known.get("a") == "A"
    known.insert("c", "C")
    assert [known.get(key) for key in "abc"] == ["A", None, "C"]


def test_bytes_count_and_one_entry_stays_however_large() -> None:
    known = BoundedMap[str, str](Limit(9, 100))
    for key, size in (("a", 40), ("b", 40), ("c", 30)):
        known.insert(key, key.upper(), size)
    assert [known.get(key) for key in "abc"] == [None, "B", "C"]
    known.insert("d", "D", 1000)
    assert [known.get(key) for key in "bcd"] == [None, None, "D"]
    known.insert("e", "E", 10)
    assert [known.get(key) for key in "de"] == [None, "E"]


def test_the_first_value_of_a_key_stays() -> None:
    known = BoundedMap[str, str](Limit(2, 100))
    assert known.insert("a", "first", 60) == "first"
    assert known.insert("a", "second", 60) == "first"
    known.insert("b", "B", 40)
    assert known.get("a") == "first", "it was counted once"


def test_threads_that_ask_at_once_get_one_value_and_what_fails_is_tried_again() -> None:
    known, made, begun = BoundedMap[str, list[int]](Limit(2, 100)), list[list[int]](), threading.Barrier(4)

    def make() -> list[int]:
        time.sleep(0.05)  # the others have come by then
        made.append([7])
        return made[-1]

    def ask() -> list[int]:
        begun.wait()
        return known.find("a", make, len)

    def fail() -> list[int]:
        raise ValueError("flat")

    with pytest.raises(ValueError, match="flat"):
        known.find("a", fail, len)
    with ThreadPoolExecutor(4) as pool:
        found = [one.result() for one in [pool.submit(ask) for _ in range(4)]]
    assert len(made) == 1
    assert all(one is made[0] for one in found)
    assert known.size == 1


HOUSE = Path(__file__).parents[1]


def test_memory_levels_off_under_requests_that_all_differ() -> None:
    """With 64 MiB for what is found once, which are full after ten requests; each made some ten megabytes of tables."""
    given = [
        "--robots",
        "panda",
        "--requests",
        "36",
        "--every",
        "5",
        "--settled",
        "16",
        "--found",
        "64",
        "--most-growth",
        "0.15",
    ]
    done = subprocess.run(
        [sys.executable, HOUSE / "tools/bench", "memory", *given], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "SUCCESS" in done.stdout


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
