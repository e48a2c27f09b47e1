"""What is owed after an answer: done when nobody waits for one, never beside one, and not piling up."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from guidefield import later
from guidefield.later import Later

PATIENCE = 30.0


def test_work_is_done_in_order_between_answers_and_never_beside_one() -> None:
    debts, told, done = Later(), list[int](), list[str]()
    begun, go_on, finished = threading.Event(), threading.Event(), threading.Event()

    def first(pause: Callable[[], None]) -> None:
        done.append("first piece")
        begun.set()
        assert go_on.wait(PATIENCE)
        pause()
        done.append("second piece")

    def second(_pause: Callable[[], None]) -> None:
        done.append("second work")
        finished.set()

    with debts.answering():
        debts.add(first, told.append)
        debts.add(second, told.append)
        assert not begun.wait(5.0 * later.REST)
    assert begun.wait(PATIENCE)
    threading.Timer(0.05, go_on.set).start()
    with debts.answering():  # after the piece that is being done
        assert go_on.is_set()
        assert not finished.wait(5.0 * later.REST)
        assert done == ["first piece"]
    assert finished.wait(PATIENCE)
    assert done == ["first piece", "second piece", "second work"]
    with debts.answering():
        assert told[:3] == [1, 2, 1]


def test_what_fails_is_logged_and_the_next_is_done(caplog) -> None:
    debts, told, finished = Later(), list[int](), threading.Event()
    debts.add(lambda _: 1 / 0, told.append)  # type: ignore[arg-type, return-value]
    debts.add(lambda _: finished.set(), told.append)
    assert finished.wait(PATIENCE)
    assert "what was owed after an answer failed" in caplog.text


def test_what_comes_once_nothing_is_owed_any_more_is_done() -> None:
    debts, told = Later(), list[int]()
    for _ in range(3):
        finished = threading.Event()
        debts.add(lambda _, done=finished: done.set(), told.append)  # type: ignore[misc]
        assert finished.wait(PATIENCE)
        while told[-1]:  # told when it is done, just before the thread waits for more
            time.sleep(0.001)
        time.sleep(later.REST)


def test_where_very_much_is_owed_an_answer_waits() -> None:
    debts, gate, answered = Later(), threading.Event(), threading.Event()
    for _ in range(later.MOST_OWED + 1):
        debts.add(lambda _: gate.wait(PATIENCE) and None, lambda _: None)

    def answer() -> None:
        with debts.answering():
            answered.set()

    thread = threading.Thread(target=answer)
    thread.start()
    assert not answered.wait(5.0 * later.REST)
    gate.set()
    thread.join(PATIENCE)
    assert answered.is_set()
