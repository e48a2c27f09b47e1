"""Who gives a plan up is not held up, and hears of nothing else, where the service doesn't answer any more."""

import asyncio
import contextlib
from concurrent.futures import Future
from typing import Any

import pytest

from guidefield.client import asynchronous, client
from guidefield.errors import NoService
from guidefield.messages.requests import JointsGoal, PlanRequest

PLAN = PlanRequest(robot="panda", scene="table", goal=JointsGoal(positions={}))


class Exchange:
    """Brings no answer, or that nobody is there to be asked for the run's end."""

    def __init__(self, gone: bool) -> None:
        self.asked: list[str] = []
        self._gone = gone

    def watching_run(self, *_about: object) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def ask(self, question: Any) -> Future[bytes]:
        self.asked.append(question.key)
        answer: Future[bytes] = Future()
        if self._gone and len(self.asked) > 1:
            answer.set_exception(NoService("nobody answers"))
        return answer


@pytest.fixture(params=[False, True], ids=["silent", "gone"])
def exchange(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Exchange:
    for room in (asynchronous, client):
        monkeypatch.setattr(room, "GIVE_UP_WITHIN", 0.05)
    return Exchange(request.param)


def test_a_task_that_is_cancelled_is_cancelled(exchange: Exchange) -> None:
    async def journey() -> None:
        task = asyncio.create_task(asynchronous.AsyncClient(exchange).plan(PLAN))
        while not exchange.asked and not task.done():
            await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(journey())
    assert exchange.asked[0] == "plan"
    assert exchange.asked[1].endswith("/cancel")


def test_a_ctrl_c_is_a_ctrl_c(exchange: Exchange, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_answer: Future[bytes]) -> bytes:
        raise KeyboardInterrupt

    monkeypatch.setattr(client, "await_answer", interrupted)
    with pytest.raises(KeyboardInterrupt):
        client.Client(exchange).plan(PLAN)
    assert exchange.asked[1].endswith("/cancel")
