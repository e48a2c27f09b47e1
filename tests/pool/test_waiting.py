"""Laws of the queue: nothing is lost, nobody is passed over, nobody can fill it alone."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given, strategies as st

from guidefield.errors import ServerBusy
from guidefield.pool.waiting import Deadline, Limits, Task, Waiting

CLIENTS = st.lists(st.sampled_from("abcd"), min_size=1, max_size=40)


def _filled(clients: list[str]) -> Waiting:
    waiting = Waiting(Limits())
    for number, client in enumerate(clients):
        waiting.put(Task(number, 1.0, client=client))
    return waiting


def _taken(waiting: Waiting) -> list[Task]:
    taken = []
    while (task := waiting.take(0.0)) is not None:
        taken.append(task)
    return taken


@given(CLIENTS)
def test_every_task_is_taken_once_and_each_clients_own_in_order(clients: list[str]) -> None:
    taken = _taken(_filled(clients))
    assert sorted(task.job for task in taken) == list(range(len(clients)))
    for client in set(clients):
        own = [task.job for task in taken if task.client == client]
        assert own == sorted(own)


@given(CLIENTS)
def test_whoever_waits_is_served_within_one_round(clients: list[str]) -> None:
    """Among any tasks taken, two clients that still have some waiting differ by at most one."""
    left, served = Counter(clients), Counter(dict.fromkeys(clients, 0))
    for task in _taken(_filled(clients)):
        left[task.client] -= 1
        served[task.client] += 1
        counts = [served[client] for client in served if left[client]]
        assert not counts or max(served.values()) - min(counts) <= 1


@given(CLIENTS, st.data())
def test_what_is_withdrawn_or_expires_is_not_taken(clients: list[str], data: st.DataObject) -> None:
    waiting = Waiting(Limits())
    tasks = [
        Task(number, 1.0, client=client, deadline=Deadline(float(number), lambda: (True, b"")))
        for number, client in enumerate(clients)
    ]
    for task in tasks:
        waiting.put(task)
    gone = data.draw(st.sets(st.sampled_from(tasks)))
    assert all(waiting.withdraw(task) for task in gone)
    assert not any(waiting.withdraw(task) for task in gone)
    now = data.draw(st.floats(-1.0, len(tasks) + 1.0))
    expired = waiting.take_expired(now)
    assert {task.job for task in expired} == {task.job for task in tasks if task.job < now and task not in gone}
    assert {task.job for task in _taken(waiting)} == {
        task.job for task in tasks if task not in gone and task not in expired
    }


def test_one_client_cannot_fill_the_queue() -> None:
    waiting = Waiting(Limits(tasks=4, tasks_of_client=2))
    for _ in range(2):
        waiting.put(Task(0, 1.0, client="greedy"))
    with pytest.raises(ServerBusy, match="2 requests of this client wait"):
        waiting.put(Task(0, 1.0, client="greedy"))
    waiting.put(Task(0, 1.0, client="modest"))
    waiting.put(Task(0, 1.0, client="another"))
    with pytest.raises(ServerBusy, match="4 requests wait"):
        waiting.put(Task(0, 1.0, client="late"))


def test_what_waits_is_bounded_in_bytes_too() -> None:
    waiting = Waiting(Limits(bytes=100, bytes_of_client=60))
    waiting.put(Task(0, 1.0, client="a", size=50))
    with pytest.raises(ServerBusy, match="of this client that wait take up to 60 bytes"):
        waiting.put(Task(0, 1.0, client="a", size=11))
    waiting.put(Task(0, 1.0, client="b", size=50))
    with pytest.raises(ServerBusy, match="that wait take up to 100 bytes"):
        waiting.put(Task(0, 1.0, client="c", size=1))
    alone = Waiting(Limits(bytes=100, bytes_of_client=60))
    alone.put(Task(0, 1.0, client="a", size=1000))  # a request that is small enough to be read has its turn


def test_a_closed_queue_gives_back_what_waited_and_takes_no_more() -> None:
    waiting = _filled(["a", "b", "a"])
    assert sorted(task.job for task in waiting.close()) == [0, 1, 2]
    assert waiting.take(0.0) is None
    with pytest.raises(ServerBusy, match="shutting down"):
        waiting.put(Task(0, 1.0))
