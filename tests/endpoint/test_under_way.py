"""Runs under way: a name is one run's, who asks again waits for the same answer, and nobody waits for ever."""

import contextlib
import json
import os
import socket
import struct
from collections.abc import Iterator
from concurrent.futures import Future
from typing import Any

import pytest
import zenoh

from guidefield.cli.serving import LOOPBACK, free_port
from guidefield.endpoint.link import DESCRIPTORS, close_links_at_once, close_sockets_at_once
from guidefield.endpoint.under_way import UnderWay
from guidefield.errors import MalformedRequest, ServerBusy
from guidefield.pool.waiting import Answer, Task
from tests.journeys.service import await_that

NAME = ("plain", "runs", "r1")
PREEMPTED = True, b"preempted"
DONE = True, b"done"


class _Pool:
    """Takes tasks, or refuses them; the first time it does what it is told meanwhile."""

    def __init__(self, meanwhile: Any = lambda: None, *, full: bool = False) -> None:
        self.tasks: list[Task] = []
        self._meanwhile, self._full = meanwhile, full

    def submit(self, task: Task) -> Task:
        self.tasks.append(task)
        self._meanwhile()
        if self._full:
            raise ServerBusy("the queue is full")
        return task

    def cancel(self, task: Task, answer: Any) -> None:
        task.set_result(answer())


def _ask(under_way: UnderWay, words: str = "words", kept: Any = lambda: None) -> tuple[Future[Answer], Future[Answer]]:
    """What is waited for, and what comes to the answer once it is kept."""
    answer: Future[Answer] = Future()
    return under_way.submit(NAME, Task("job", 1.0), lambda: PREEMPTED, words, answer, kept), answer


def test_who_asks_again_waits_for_the_same_answer() -> None:
    under_way = UnderWay(_Pool())
    first, answer = _ask(under_way)
    again, _ = _ask(under_way)
    with pytest.raises(MalformedRequest, match="'r1' is taken"):
        _ask(under_way, "other words")
    answer.set_result(DONE)
    assert (first.result(0), again.result(0)) == (DONE, DONE)
    after, _ = _ask(under_way, "other words")
    assert not after.done(), "the name is free as far as it is known here"


def test_a_run_is_under_way_until_it_is_kept() -> None:
    pool = _Pool()
    under_way = UnderWay(pool)
    _, answer = _ask(under_way)
    pool.tasks[0].set_result(DONE)
    again, _ = _ask(under_way)
    assert len(pool.tasks) == 1
    assert not again.done()
    answer.set_result(DONE)
    assert again.result(0) == DONE


def test_what_was_answered_before_is_answered_again_to_all_who_ask() -> None:
    pool = _Pool()
    under_way = UnderWay(pool)
    before: Future[Answer] = Future()
    first, _ = _ask(under_way, kept=lambda: before)
    again, _ = _ask(under_way)
    before.set_result(DONE)
    assert (first.result(0), again.result(0), pool.tasks) == (DONE, DONE, [])


def test_who_asks_again_hears_that_the_first_was_refused() -> None:
    joined: list[Future[Answer]] = []
    pool = _Pool(lambda: joined.append(_ask(under_way)[0]), full=True)
    under_way = UnderWay(pool)
    with pytest.raises(ServerBusy):
        _ask(under_way)
    with pytest.raises(ServerBusy):
        joined[0].result(0)


def test_a_cancel_that_comes_first_ends_the_run_before_it_begins() -> None:
    pool = _Pool()
    under_way = UnderWay(pool)
    assert "if it arrives within" in under_way.cancel(NAME)
    task = Task("job", 1.0)
    under_way.submit(NAME, task, lambda: PREEMPTED, "words", Future())
    assert (task.result(0), pool.tasks) == (PREEMPTED, [])


LINGERING = struct.pack("ii", 1, 10)


@contextlib.contextmanager
def _session(way: str, port: int) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    for key, value in {
        "mode": "peer" if way == "listen" else "client",
        "listen/endpoints": [],
        f"{way}/endpoints": [f"tcp/{LOOPBACK}:{port}"],
        "scouting/multicast/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        yield session


def _links(port: int) -> list[bool]:
    """Of each link that was taken at a port, whether it waits for its reader when it is closed."""
    found = []
    for number in DESCRIPTORS.iterdir():
        try:
            one = socket.socket(fileno=int(number.name))
        except OSError:
            continue
        with contextlib.suppress(OSError):
            if one.getpeername() and one.getsockname() == (LOOPBACK, port):
                found.append(_lingers(one))
        one.detach()
    return found


def _lingers(one: socket.socket) -> bool:
    told = one.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, len(LINGERING))
    return bool(struct.unpack("ii", told)[0])


def test_zenoh_waits_for_readers_and_here_no_link_does() -> None:
    """The links that are there, and those that come later; where the first line fails, Zenoh waits no more."""
    with free_port() as port, _session("listen", port) as service, _session("connect", port):
        await_that(lambda: _links(port) == [True])
        with close_links_at_once(service):
            await_that(lambda: _links(port) == [False])
            with _session("connect", port):
                await_that(lambda: _links(port) == [False, False])


def test_open_files_that_are_no_links_are_left_as_they_are() -> None:
    near, far = socket.socketpair()
    reading, writing = os.pipe()
    with near, far, socket.socket() as link, os.fdopen(reading), os.fdopen(writing, "wb"):
        for one in (near, link):
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGERING)
        close_sockets_at_once()
        assert [_lingers(one) for one in (near, link)] == [True, False]
        near.sendall(b"here")
        assert far.recv(4) == b"here"
