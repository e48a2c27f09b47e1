"""A process for one conversation: what it is told and tells, and how it ends."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from guidefield.errors import GuidefieldError, Preempted
from guidefield.pool import process
from guidefield.pool.process import Companion, Conversation
from tests.journeys.service import SO_WITHIN, await_death
from tests.worker_setups import converse, converse_with_nobody


class Heard:
    """What a conversation told, and how it ended."""

    def __init__(self) -> None:
        self.told: list[Any] = []
        self.why: GuidefieldError | None = None
        self.end: GuidefieldError | None = None
        self.changed = threading.Condition()

    def hear(self, what: Any) -> None:
        with self.changed:
            self.told.append(what)
            self.changed.notify_all()

    def ended(self, error: GuidefieldError) -> None:
        with self.changed:
            self.end = error
            self.changed.notify_all()

    def await_told(self, count: int) -> list[Any]:
        with self.changed:
            assert self.changed.wait_for(lambda: len(self.told) >= count, SO_WITHIN)
            return self.told

    def await_end(self) -> GuidefieldError:
        with self.changed:
            assert self.changed.wait_for(lambda: self.end is not None, SO_WITHIN)
            assert self.end is not None
            return self.end


@contextmanager
def conversation(what: Conversation = converse, memory: int = 1 << 30) -> Iterator[tuple[Companion, Heard]]:
    heard = Heard()
    one = Companion(what, memory, heard.hear, lambda: heard.why, heard.ended)
    one.start()
    yield one, heard
    heard.why = heard.why or Preempted("the test is over")
    assert one.join(SO_WITHIN)


def test_what_is_told_is_answered_in_order_until_it_is_to_end() -> None:
    with conversation() as (one, heard):
        for index in range(50):
            assert one.tell(("echo", index), 8)
        assert heard.await_told(51)[1:] == list(range(50))
        pid = heard.told[0]
        assert one.pid == pid
        assert one.memory > 0
        heard.why = Preempted("enough")
        assert heard.await_end().message == "enough"
        await_death(pid)
        assert not one.tell(("echo", 1), 8)
        assert len(heard.told) == 51


def test_a_process_that_dies_or_ends_is_noticed() -> None:
    with conversation() as (_, heard):
        os.kill(heard.await_told(1)[0], signal.SIGKILL)
        assert "died" in heard.await_end().message
    with conversation() as (one, heard):
        one.tell(("end", None), 8)
        assert "died" in heard.await_end().message


def test_what_waits_for_a_process_that_takes_nothing_is_bounded_and_it_is_ended(monkeypatch):
    monkeypatch.setattr(process, "MAX_SILENCE_S", 0.5)
    monkeypatch.setattr(process, "MAX_WAITING_MESSAGES", 5)
    with conversation(converse_with_nobody) as (one, heard):
        large = b"x" * (1 << 22)  # more than a pipe takes
        told = [one.tell(large, len(large)) for _ in range(8)]
        assert not all(told)
        assert "got on with nothing" in heard.await_end().message


def test_a_process_that_takes_too_much_is_ended() -> None:
    with conversation(memory=1 << 20) as (_, heard):
        assert "took more than 1 MiB" in heard.await_end().message
