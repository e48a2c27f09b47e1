"""Memory: bounded maps, a collector that doesn't wait, a worker that levels off; what is found goes with its object."""

import copy
import gc
import pickle
import subprocess
import sys
import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from guidefield import Engine, Potential, engine, memo
from guidefield.cli.demonstration import REQUESTS
from guidefield.collision.world import World
from guidefield.memo import MAX_PER_OBJECT, memoized
from guidefield.memory import BoundedMap, Limit, pause_collector
from guidefield.robot.group.group import PlanningGroup
from guidefield.stores.recordings import Recordings


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


class Thing:
    """Something to find things out about."""


def test_finds_once_for_each_object_and_arguments() -> None:
    """The same object and arguments are looked at once; others again."""
    asked = []

    @memoized
    def name(thing: Thing, ending: str = "") -> str:
        asked.append((thing, ending))
        return f"{id(thing)}{ending}"

    one, other = Thing(), Thing()
    assert [name(one), name(one), name(one, "x"), name(one, "x")] == [str(id(one))] * 2 + [f"{id(one)}x"] * 2
    assert name(other) == str(id(other))
    assert asked == [(one, ""), (one, "x"), (other, "")]


def test_of_many_answers_about_an_object_those_asked_for_last_are_kept() -> None:
    """Clients choose some of the arguments, such as the pairs that may touch: what is kept for them has a bound."""
    asked = []

    @memoized
    def find(_thing: Thing, number: int) -> Thing:
        asked.append(number)
        return Thing()

    thing = Thing()
    first, second = weakref.ref(find(thing, 0)), weakref.ref(find(thing, 1))
    for number in range(2, MAX_PER_OBJECT + 1):
        assert find(thing, 0) is first()
        find(thing, number)
    assert second() is None
    assert find(thing, 0) is first()
    assert asked == list(range(MAX_PER_OBJECT + 1))


def test_what_was_found_goes_with_the_object() -> None:
    """Without waiting for a collection of cycles."""

    @memoized
    def find(_thing: Thing) -> Thing:
        return Thing()

    thing = Thing()
    found = weakref.ref(find(thing))
    assert found() is find(thing)
    del thing
    assert found() is None


def test_what_is_found_for_all_objects_is_bounded_in_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was used least recently goes first, whichever function found it, and is found again when it is asked for."""
    monkeypatch.setattr(memo, "_FOUND", BoundedMap[Any, Any](Limit(1000, 10_000)))
    asked = []

    @memoized
    def find(thing: Thing, kind: str) -> dict[str, np.ndarray]:
        asked.append(kind)
        return {"rows": np.zeros(500)}

    things = [Thing() for _ in range(3)]
    first = weakref.ref(find(things[0], "a")["rows"])
    find(things[1], "b")
    assert find(things[0], "a")["rows"] is first()
    find(things[2], "c")
    assert first() is not None
    find(things[1], "b")
    assert asked == ["a", "b", "c", "b"]
    assert first() is None


def test_a_copy_of_an_object_has_answers_of_its_own_and_none_travel() -> None:
    @memoized
    def find(thing: Thing) -> int:
        return id(thing)

    thing = Thing()
    assert find(thing) == id(thing)
    for other in (copy.copy(thing), pickle.loads(pickle.dumps(thing))):
        assert find(other) == id(other)
    assert find(thing) == id(thing)


def test_answers_are_the_same_where_everything_found_is_forgotten_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels hold addresses: what they read stays as long as they are asked, to the last bit."""
    rng = np.random.default_rng(3)
    mesh = rng.uniform((0.5, 0.4, 0.3), (0.7, 0.6, 0.5), (60, 3))
    obstacles = [
        {"type": "point_cloud", "name": "cloud", "points": rng.uniform(0.5, 0.7, (400, 3)).tolist(), "radius": 0.01},
        {"type": "mesh", "name": "rags", "vertices": mesh.tolist(), "triangles": np.arange(60).reshape(20, 3).tolist()},
        {"type": "polygon", "name": "flag", "vertices": [[0.3, -0.6, 0.2], [0.4, -0.6, 0.2], [0.4, -0.6, 0.5]]},
        *({"type": "box", "name": f"b{k}", "size": [0.1] * 3, "position": [0.7, 0.3 * k, 0.8]} for k in range(4)),
    ]
    start = dict(zip((f"panda_joint{k}" for k in range(1, 8)), (0.0, -0.8, 0.0, -2.3, 0.0, 1.6, 0.8), strict=True))
    goal = {"type": "joints", "positions": {**start, "panda_joint1": 1.4}}
    plan = {"robot": "panda", "scene": {"name": "s", "obstacles": obstacles}, "start": start, "goal": goal}
    plan |= {"guide_planes": [], "planner": "tree", "recording": "off", "allowed_planning_time": 600.0}
    usual = Engine().answer(plan)
    monkeypatch.setattr(memo, "_FOUND", BoundedMap[Any, Any](Limit(1, 1)))
    short = Engine().answer(plan)
    assert short.status.name == "SUCCESS"
    assert (short.trajectory, short.path) == (usual.trajectory, usual.path)
    assert (short.clearance, short.certificate) == (usual.clearance, usual.certificate)


@pytest.mark.parametrize(
    "request_",
    [
        REQUESTS["demo-guide-planes"][1],
        {"type": "potential", "robot": "panda", "scene": "bookshelf", "configurations": [{}]},
    ],
)
def test_a_request_leaves_no_planning_group_or_world(request_: Any, tmp_path: Path) -> None:
    """Their models hold megabytes that Python doesn't count: left to its collector, they pile up."""
    engine = Engine(recordings=Recordings(tmp_path))
    gc.collect()
    before = _alive()
    gc.disable()
    try:
        engine.answer(request_)
        assert not {id(thing) for thing in _alive()} - {id(thing) for thing in before}
    finally:
        gc.enable()
    if "type" not in (request_ if isinstance(request_, dict) else {}):
        assert len(list(tmp_path.glob("*.log"))) == 1


def _alive() -> list[object]:
    """Those there are, by type: isinstance would ask a weak proxy for what it stands for, that may be gone."""
    return [thing for thing in gc.get_objects() if issubclass(type(thing), PlanningGroup | World)]
