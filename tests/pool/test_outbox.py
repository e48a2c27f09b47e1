"""Answers on their way out: whoever doesn't read holds up nobody else, and what waits is bounded."""

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator

import pytest

from guidefield.messages.identities import Asker
from guidefield.pool import outbox as rooms
from guidefield.pool.outbox import Outbox
from tests.journeys.service import await_that

PATIENCE = 60.0


@pytest.fixture
def outbox() -> Iterator[Outbox]:
    box = Outbox()
    yield box
    box.close(PATIENCE)


class _Reader:
    """A client: it takes answers, once it reads."""

    def __init__(self) -> None:
        self.reads, self.begun = threading.Event(), threading.Event()
        self.taken: list[int] = []
        self._all = threading.Condition()

    def take(self, number: int) -> None:
        self.begun.set()
        assert self.reads.wait(PATIENCE)
        with self._all:
            self.taken.append(number)
            self._all.notify()

    def await_all(self, count: int) -> None:
        with self._all:
            assert self._all.wait_for(lambda: len(self.taken) == count, PATIENCE)


@pytest.mark.parametrize("name", ["greedy", ""])
def test_one_that_does_not_read_holds_up_nobody(name: str, outbox: Outbox) -> None:
    stopped, healthy = _Reader(), _Reader()
    healthy.reads.set()
    for number in range(20):
        assert outbox.post(Asker(client=name), 1, lambda number=number: stopped.take(number))
    assert stopped.begun.wait(PATIENCE)
    for number in range(50):
        assert outbox.post(Asker(client="healthy" if number % 2 else ""), 1, lambda number=number: healthy.take(number))
    healthy.await_all(50)
    assert not stopped.taken
    stopped.reads.set()
    stopped.await_all(20)
    if name:
        assert stopped.taken == list(range(20)), "one after the other"


def test_a_thread_that_idles_is_told_of_one_answer_only(outbox: Outbox) -> None:
    first, stopped, healthy = _Reader(), _Reader(), _Reader()
    first.reads.set()
    healthy.reads.set()
    assert outbox.post(Asker(client="first"), 1, lambda: first.take(0))
    first.await_all(1)
    await_that(lambda: outbox._idle)
    with outbox._lock:  # nobody takes one before all are posted
        assert outbox.post(Asker(client="stopped"), 1, lambda: stopped.take(0))
        for name in ("one", "another"):
            assert outbox.post(Asker(client=name), 1, lambda: healthy.take(0))
    healthy.await_all(2)
    assert not stopped.taken
    stopped.reads.set()
    stopped.await_all(1)


def test_what_waits_for_a_client_is_bounded_but_one_answer_is_always_sent(outbox, monkeypatch):
    monkeypatch.setattr(rooms, "MAX_CLIENT_BYTES", 100)
    stopped = _Reader()
    assert outbox.post(Asker(client="stopped"), 10_000, lambda: stopped.take(0))
    assert not outbox.post(Asker(client="stopped"), 1, lambda: stopped.take(1))
    assert outbox.post(Asker(client="another"), 1, lambda: None)
    stopped.reads.set()
    stopped.await_all(1)


def test_what_waits_for_all_is_bounded(outbox: Outbox, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rooms, "MAX_UNREAD_BYTES", 100)
    stopped = _Reader()
    sent = [outbox.post(Asker(user), 40, lambda: stopped.take(0)) for user in "abcd"]
    assert sent == [True, True, False, False]
    stopped.reads.set()
    stopped.await_all(2)


def test_one_user_has_half_of_the_room_and_of_the_threads(outbox: Outbox, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, most in (("MAX_UNREAD_BYTES", 400), ("MAX_ANSWERS", 16), ("MAX_THREADS", 4)):
        monkeypatch.setattr(rooms, name, most)
    stopped, healthy = _Reader(), _Reader()
    healthy.reads.set()
    assert [outbox.post(Asker("greedy"), 50, lambda: stopped.take(0)) for _ in range(5)] == [True] * 4 + [False]
    assert [outbox.post(Asker("greedy"), 0, lambda: stopped.take(0)) for _ in range(5)] == [True] * 4 + [False]
    for number in range(6):
        assert outbox.post(Asker("modest"), 20, lambda number=number: healthy.take(number))
        healthy.await_all(number + 1)
    assert not stopped.taken
    stopped.reads.set()
    stopped.await_all(8)


def test_an_answer_that_cannot_be_sent_is_no_end_of_the_others(outbox: Outbox) -> None:
    reader = _Reader()
    reader.reads.set()

    def broken() -> None:
        raise OSError("the link is gone")

    assert outbox.post(Asker(client="a"), 1, broken)
    assert outbox.post(Asker(client="a"), 1, lambda: reader.take(1))
    reader.await_all(1)


def test_an_end_waits_for_answers_and_not_for_ever() -> None:
    reader, box = _Reader(), Outbox()
    assert box.post(Asker(client="slow"), 1, lambda: reader.take(1))
    box.close(0.05)
    assert not reader.taken
    reader.reads.set()
    reader.await_all(1)
    sent, quick = threading.Event(), Outbox()
    assert quick.post(Asker(client="quick"), 1, sent.set)
    quick.close(PATIENCE)
    assert sent.is_set()


class _Source:
    """Where answers come from: posts what it is given, in the thread that polls."""

    def __init__(self) -> None:
        self.box = Outbox(self._poll)
        self.threads: list[int] = []
        self._come: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.box.begin_polling()

    def have_posted(self, asker: Asker, send: Callable[[], None]) -> None:
        self._come.put(lambda: self._post(asker, send))

    def _post(self, asker: Asker, send: Callable[[], None]) -> None:
        self.threads.append(threading.get_ident())
        assert self.box.post(asker, 1, send)

    def _poll(self) -> None:
        with contextlib.suppress(queue.Empty):
            self._come.get(timeout=0.05)()

    def close(self) -> None:
        self.box.end_polling(lambda: None)
        self.box.close(PATIENCE)


def test_who_polls_sends_what_has_come() -> None:
    source, senders = _Source(), queue.SimpleQueue[int]()
    for _ in range(20):
        source.have_posted(Asker(client="a"), lambda: senders.put(threading.get_ident()))
    sent = [senders.get(timeout=PATIENCE) for _ in range(20)]
    assert sent == source.threads
    source.close()


@pytest.mark.parametrize("name", ["greedy", ""])
def test_answers_come_while_who_polled_is_kept_by_one_that_does_not_read(name: str) -> None:
    source, stopped, healthy = _Source(), _Reader(), _Reader()
    healthy.reads.set()
    for number in range(3):
        source.have_posted(Asker(client=name), lambda number=number: stopped.take(number))
    for number in range(20):
        source.have_posted(Asker(client="healthy"), lambda number=number: healthy.take(number))
    healthy.await_all(20)
    assert not stopped.taken
    assert len(set(source.threads)) > 1
    stopped.reads.set()
    stopped.await_all(3)
    source.close()


def test_somebody_attends_while_every_thread_is_kept_by_users_who_do_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rooms, "MAX_THREADS", 2)
    source, stopped, healthy = _Source(), _Reader(), _Reader()
    healthy.reads.set()
    for user in ("greedy", "greedier"):
        source.have_posted(Asker(user), lambda: stopped.take(0))
    for number in range(5):
        source.have_posted(Asker("modest"), lambda number=number: healthy.take(number))
    healthy.await_all(5)
    assert not stopped.taken
    stopped.reads.set()
    stopped.await_all(2)
    source.close()
