"""The answer to work that was asked for in another way than by a query on one of the keys."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Protocol

from guidefield.pool.waiting import Answer


class Settled(Protocol):
    """Whoever waits for an answer."""

    def settle(self, future: Future[Answer]) -> None:
        """Take what a future holds."""


class Promised:
    """An answer that will be there.

    Args:
        count: Is told whether it was answered or refused.

    Attributes:
        answer: A future of it.
    """

    def __init__(self, count: Callable[[str], None]) -> None:
        self.answer: Future[Answer] = Future()
        self._count = count

    def settle(self, future: Future[Answer]) -> None:
        """Hand on what a future holds."""
        error = future.exception()
        if error is not None:
            self._count("refused")
            self.answer.set_exception(error)
            return
        self._count("answered" if future.result()[0] else "refused")
        self.answer.set_result(future.result())
