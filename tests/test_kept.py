"""What is kept with an object goes with it: nothing of a request outlives its answer."""

from __future__ import annotations

import gc
import weakref
from pathlib import Path
from typing import Any

import pytest

from guidefield.collision.world import World
from guidefield.demo import REQUESTS
from guidefield.engine import Engine
from guidefield.kept import MOST, kept_with
from guidefield.robot.group.group import PlanningGroup
from guidefield.stores.recordings import Recordings


class Thing:
    """Something to find things out about."""


def test_finds_once_for_each_object_and_arguments() -> None:
    """The same object and arguments are looked at once; others again."""
    asked = []

    @kept_with
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

    @kept_with
    def find(_thing: Thing, number: int) -> Thing:
        asked.append(number)
        return Thing()

    thing = Thing()
    first, second = weakref.ref(find(thing, 0)), weakref.ref(find(thing, 1))
    for number in range(2, MOST + 1):
        assert find(thing, 0) is first()
        find(thing, number)
    assert second() is None
    assert find(thing, 0) is first()
    assert asked == list(range(MOST + 1))


def test_what_was_found_goes_with_the_object() -> None:
    """Without waiting for a collection of cycles."""

    @kept_with
    def find(_thing: Thing) -> Thing:
        return Thing()

    thing = Thing()
    found = weakref.ref(find(thing))
    assert found() is find(thing)
    del thing
    assert found() is None


def test_what_fails_is_asked_again() -> None:
    """An error is nothing to keep."""
    tries = iter([ValueError("not yet"), None])

    @kept_with
    def find(_thing: Thing) -> str:
        if (error := next(tries)) is not None:
            raise error
        return "found"

    thing = Thing()
    with pytest.raises(ValueError, match="not yet"):
        find(thing)
    assert find(thing) == "found"


@pytest.mark.parametrize(
    "request_",
    [
        *(request for _, request in REQUESTS.values()),
        {"type": "clearance", "robot": "panda", "scene": "bookshelf", "configurations": [{}]},
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
        assert len(list(tmp_path.glob("*.rrd"))) == 1


def _alive() -> list[object]:
    """Those there are, by type: isinstance would ask a weak proxy for what it stands for, that may be gone."""
    return [thing for thing in gc.get_objects() if issubclass(type(thing), PlanningGroup | World)]
