"""Long work aside: who waits goes on when time is up, and the work comes to its end."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from functools import partial

import pytest

from guidefield.aside import StoppedError, done_aside, spread, together, wait_for_others

PATIENCE = 30.0


def never() -> bool:
    return False


def test_what_is_made_is_handed_over_and_what_is_raised_is_raised() -> None:
    assert done_aside(lambda: threading.current_thread().name, never, str) == "guidefield-aside"
    with pytest.raises(KeyError, match="lost"):
        done_aside(lambda: {}["lost"], never, str)
    wait_for_others(never)


def test_who_waits_goes_on_when_time_is_up_and_the_work_comes_to_its_end() -> None:
    gate, made = threading.Event(), []
    with pytest.raises(StoppedError, match="the hall"):
        done_aside(lambda: made.append(gate.wait(PATIENCE)), lambda: True, lambda: "the hall")
    assert made == []
    gate.set()
    wait_for_others(never)
    assert made == [True]


def test_only_one_works_at_a_time() -> None:
    gate, order = threading.Event(), []

    def first() -> None:
        gate.wait(PATIENCE)
        order.append("first")

    with pytest.raises(StoppedError):
        done_aside(first, lambda: True, str)
    for _ in range(2):
        with pytest.raises(StoppedError, match="asked for before"):
            done_aside(lambda: order.append("in between"), lambda: True, str)
    asked = iter([False] * 3)

    def opened() -> bool:
        if next(asked, None) is None:
            gate.set()
        return False

    done_aside(lambda: order.append("second"), opened, str)
    assert order == ["first", "second"]


def test_parts_are_done_at_the_same_time_and_all_of_them_come_to_their_end() -> None:
    met, done = threading.Barrier(2), []

    def part(name: str, failing: str) -> None:
        met.wait(PATIENCE)
        done.append(name)
        if name == failing:
            raise KeyError(name)

    together(lambda: part("first", ""), lambda: part("second", ""))
    for failing in ("first", "second"):
        with pytest.raises(KeyError, match=failing):
            together(partial(part, "first", failing), partial(part, "second", failing))
    assert sorted(done) == 3 * ["first"] + 3 * ["second"]


@pytest.mark.parametrize("at_once", [1, 2, 5])
def test_works_are_begun_in_their_turn_and_so_many_run_at_a_time(at_once: int) -> None:
    begun, running, most = [], [], []
    changing, met = threading.Lock(), threading.Barrier(at_once)

    def work(k: int) -> None:
        with changing:
            running.append(k)
            most.append(len(running))
        if k < at_once:
            met.wait(PATIENCE)  # the first ones are all there at the same time
        with changing:
            running.remove(k)

    def works() -> Iterator[Callable[[], None]]:
        for k in range(12):
            begun.append(k)
            yield partial(work, k)

    spread(works(), at_once)
    assert begun == list(range(12))
    assert not running
    assert max(most) == at_once


def test_a_fault_ends_it_once_what_has_begun_is_done() -> None:
    gate, done = threading.Event(), []

    def slow() -> None:
        gate.wait(PATIENCE)
        done.append("slow")

    def failing() -> None:
        gate.set()
        raise KeyError("lost")

    with pytest.raises(KeyError, match="lost"):
        spread(iter([slow, failing, *[lambda: done.append("later")] * 50]), 2)
    assert done.count("slow") == 1
    assert done.count("later") <= 50


def test_no_more_are_begun_where_taking_one_raises() -> None:
    done = []

    def works() -> Iterator[Callable[[], None]]:
        yield lambda: done.append("first")
        raise StoppedError("time was up")

    for at_once in (1, 3):
        with pytest.raises(StoppedError, match="time was up"):
            spread(works(), at_once)
    assert done == ["first", "first"]


def test_nothing_to_do_is_done_at_once() -> None:
    spread(iter(()), 3)
