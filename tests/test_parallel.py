"""Work in parallel: all of it comes to its end, each part is begun in its turn, and a fault is raised."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from functools import partial

import pytest

from guidefield.parallel import run_parallel, run_queue

PATIENCE = 30.0


def test_parts_are_done_at_the_same_time_and_all_of_them_come_to_their_end() -> None:
    met, done = threading.Barrier(2), []

    def part(name: str, failing: str) -> None:
        met.wait(PATIENCE)
        done.append(name)
        if name == failing:
            raise KeyError(name)

    run_parallel(lambda: part("first", ""), lambda: part("second", ""))
    for failing in ("first", "second"):
        with pytest.raises(KeyError, match=failing):
            run_parallel(partial(part, "first", failing), partial(part, "second", failing))
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

    run_queue(works(), at_once)
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
        run_queue(iter([slow, failing, *[lambda: done.append("later")] * 50]), 2)
    assert done.count("slow") == 1
    assert done.count("later") <= 50
