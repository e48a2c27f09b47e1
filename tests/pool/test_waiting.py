"""Laws of the queue: nothing is lost, nobody is passed over, nobody can fill it alone."""

import math
import time
from collections import Counter

import pytest
from hypothesis import given, strategies as st

from guidefield.errors import ServerBusy
from guidefield.messages.identities import Asker
from guidefield.pool.waiting import STANDBY_WAIT_S, TRIAL_S, Limits, Task, TimedAnswer, Waiting

CLIENTS = st.lists(st.sampled_from("abcd"), min_size=1, max_size=40)


def _filled(clients: list[str]) -> Waiting:
    waiting = Waiting(Limits())
    for number, client in enumerate(clients):
        waiting.add(Task(number, 1.0, asker=Asker(client=client)))
    return waiting


def _taken(waiting: Waiting) -> list[Task]:
    taken = []
    while (task := waiting.take()) is not None:
        taken.append(task)
    return taken


@given(CLIENTS)
def test_every_task_is_taken_once_and_each_clients_own_in_order(clients: list[str]) -> None:
    taken = _taken(_filled(clients))
    assert sorted(task.job for task in taken) == list(range(len(clients)))
    for client in set(clients):
        own = [task.job for task in taken if task.asker.client == client]
        assert own == sorted(own)


@given(CLIENTS)
def test_whoever_waits_is_served_within_one_round(clients: list[str]) -> None:
    """Among any tasks taken, two clients that still have some waiting differ by at most one."""
    left, served = Counter(clients), Counter(dict.fromkeys(clients, 0))
    for task in _taken(_filled(clients)):
        left[task.asker.client] -= 1
        served[task.asker.client] += 1
        counts = [served[client] for client in served if left[client]]
        assert not counts or max(served.values()) - min(counts) <= 1


@given(CLIENTS, st.data())
def test_what_is_withdrawn_or_expires_is_not_taken(clients: list[str], data: st.DataObject) -> None:
    waiting = Waiting(Limits())
    tasks = [
        Task(number, 1.0, asker=Asker(client=client), deadline=TimedAnswer(float(number), lambda: (True, b"")))
        for number, client in enumerate(clients)
    ]
    for task in tasks:
        waiting.add(task)
    assert waiting.due_at == 0.0
    gone = data.draw(st.sets(st.sampled_from(tasks)))
    assert all(waiting.withdraw(task) for task in gone)
    assert not any(waiting.withdraw(task) for task in gone)
    now = data.draw(st.floats(-1.0, len(tasks) + 1.0))
    expired = waiting.take_expired(now)
    assert {task.job for task in expired} == {task.job for task in tasks if task.job <= now and task not in gone}
    left = [task.job for task in tasks if task not in gone and task not in expired]
    assert waiting.due_at == min(left, default=float("inf")), "whoever attends wakes up for the next one"
    assert {task.job for task in _taken(waiting)} == {
        task.job for task in tasks if task not in gone and task not in expired
    }


def test_one_client_cannot_fill_the_queue() -> None:
    waiting = Waiting(Limits(tasks=4, tasks_of_client=2))
    for _ in range(2):
        waiting.add(Task(0, 1.0, asker=Asker(client="greedy")))
    with pytest.raises(ServerBusy, match="2 requests of this client wait"):
        waiting.add(Task(0, 1.0, asker=Asker(client="greedy")))
    waiting.add(Task(0, 1.0, asker=Asker(client="modest")))
    waiting.add(Task(0, 1.0, asker=Asker(client="another")))
    with pytest.raises(ServerBusy, match="4 requests wait"):
        waiting.add(Task(0, 1.0, asker=Asker(client="late")))


def test_what_waits_is_bounded_in_bytes_too() -> None:
    waiting = Waiting(Limits(bytes=100, bytes_of_client=60))
    waiting.add(Task(0, 1.0, asker=Asker(client="a"), size=50))
    with pytest.raises(ServerBusy, match="of this client that wait take up to 60 bytes"):
        waiting.add(Task(0, 1.0, asker=Asker(client="a"), size=11))
    waiting.add(Task(0, 1.0, asker=Asker(client="b"), size=50))
    with pytest.raises(ServerBusy, match="that wait take up to 100 bytes"):
        waiting.add(Task(0, 1.0, asker=Asker(client="c"), size=1))
    alone = Waiting(Limits(bytes=100, bytes_of_client=60))
    alone.add(
        Task(0, 1.0, asker=Asker(client="a"), size=1000)
    )  # a request that is small enough to be read has its turn


def test_a_closed_queue_gives_back_what_waited_and_takes_no_more() -> None:
    waiting = _filled(["a", "b", "a"])
    assert sorted(task.job for task in waiting.close()) == [0, 1, 2]
    assert waiting.take() is None
    with pytest.raises(ServerBusy, match="shutting down"):
        waiting.add(Task(0, 1.0))


ASKERS = st.lists(st.builds(Asker, st.sampled_from("uvw"), st.sampled_from("ab")), min_size=1, max_size=40)
SECONDS = st.lists(st.floats(0.01, 5.0), min_size=40, max_size=40)


@given(ASKERS, SECONDS)
def test_a_worker_goes_to_the_user_who_has_the_fewest_and_got_the_least(askers, seconds):
    """Against a plain account of who has how many workers and got how much, of work that is done at random."""
    waiting = Waiting(Limits())
    for asker in askers:
        waiting.add(Task(0, 1.0, asker=asker))
    left, running, got = Counter(asker.user for asker in askers), Counter[str](), Counter[str]()
    held: list[Task] = []
    for spent in seconds[: len(askers)]:
        task = waiting.take()
        user = task.asker.user
        for other in (other for other in left if left[other]):
            assert (running[user], round(got[user], 2)) <= (running[other], round(got[other], 2) + 0.01)
        left[user] -= 1
        running[user] += 1
        held.append(task)
        if len(held) == 3 or spent < 1.0:
            done = held.pop(0)
            waiting.settle(done, spent, spent)
            running[done.asker.user] -= 1
            got[done.asker.user] += spent
    assert waiting.take() is None
    assert {user: waiting.running(user) for user in left} == {user: running[user] for user in left}


def test_whoever_asks_for_little_comes_first_however_much_others_have_waiting() -> None:
    waiting = Waiting(Limits())
    for user in "abcd":
        for _ in range(10):
            waiting.add(Task(user, 1.0, asker=Asker(user)))
    for _ in range(8):
        task = waiting.take()
        assert task is not None
        waiting.settle(task, 1.0, 1.0)
    busy = [waiting.take(), waiting.take()]
    waiting.add(Task("quiet", 1.0, asker=Asker("quiet")))
    assert busy[0] is not None
    waiting.settle(busy[0], 1.0, 1.0)
    quiet = waiting.take()
    assert quiet.job == "quiet"


@given(ASKERS, st.integers(1, 8))
def test_a_full_queue_pushes_out_who_has_the_most_and_refuses_nobody_who_has_less(askers, most):
    waiting, counts = Waiting(Limits(tasks=most)), Counter[str]()
    for number, asker in enumerate(askers):
        if counts.total() == most and max(counts.values()) <= counts[asker.user] + 1:
            with pytest.raises(ServerBusy, match="wait already; ask again later"):
                waiting.add(Task(number, 1.0, asker=asker))
            continue
        pushed = waiting.add(Task(number, 1.0, asker=asker))
        assert len(pushed) == (counts.total() == most)
        for task in pushed:
            assert counts[task.asker.user] == max(counts.values()) > counts[asker.user] + 1
            counts[task.asker.user] -= 1
        counts[asker.user] += 1
        assert counts.total() == len(waiting) <= most
        assert {user: waiting.of_user(user) for user in "uvw"} == {user: counts[user] for user in "uvw"}


def test_whoever_asked_steadily_for_little_comes_before_those_who_just_came_with_much() -> None:
    waiting = Waiting(Limits(tasks=100))
    for _ in range(50):
        waiting.add(Task("steady", 1.0, asker=Asker("steady")))
        task = waiting.take()
        assert task is not None
        waiting.settle(task, 1.0, 1.0)
    for user in ("new", "newer"):
        for _ in range(20):
            waiting.add(Task(user, 1.0, asker=Asker(user)))
    for round_ in range(5):
        running = waiting.take()
        waiting.add(Task("steady", 1.0, asker=Asker("steady")))
        assert running is not None
        waiting.settle(running, 1.0, 1.0)
        before = 0
        while (task := waiting.take()) is not None and task.job != "steady":
            waiting.settle(task, 1.0, 1.0)
            before += 1
        assert before <= 2, round_
        assert task is not None
        waiting.settle(task, 0.1, 0.1)


@given(ASKERS, st.integers(1, 3), st.data())
def test_who_stands_by_takes_only_what_waits_too_long_of_users_without_a_worker(askers, free, data):
    """Whatever ordinary workers hold, what is taken and set back is each task once at a time, and none is lost."""
    waiting = Waiting(Limits())
    tasks = [Task(number, 1.0, asker=asker) for number, asker in enumerate(askers)]
    for task in tasks:
        task.since -= data.draw(st.sampled_from([0.0, 2 * STANDBY_WAIT_S + 60.0]))
        waiting.add(task)
    held = [task for _ in range(free) if (task := waiting.take()) is not None]
    for _ in askers:
        before, users = len(waiting), {task.asker.user for task in held}
        task = waiting.take_held_up(time.monotonic())
        if task is None:
            assert not waiting.is_held_up(math.inf)
            break
        assert task.asker.user not in users
        assert time.monotonic() - task.since >= STANDBY_WAIT_S
        assert len(waiting) == before - 1
        waiting.settle(task, 1.0, 1.0)
        if data.draw(st.booleans()):
            assert waiting.put_back(task)
            assert len(waiting) == before
        else:
            tasks.remove(task)
    for task in held:
        waiting.settle(task, 1.0, 1.0)
        tasks.remove(task)
    left = _taken(waiting)
    assert sorted(task.job for task in left) == sorted(task.job for task in tasks)
    back = {task.asker.user: task for task in left if task.set_back}
    assert all(next(one for one in left if one.asker.user == user) is task for user, task in back.items())


def test_whoever_gave_way_takes_anothers_place_after_twice_as_long_each_time_and_after_who_did_not() -> None:
    waiting = Waiting(Limits())
    often, fresh = (Task(user, 1.0, asker=Asker(user)) for user in ("often", "fresh"))
    for task in (often, fresh):
        task.since -= 2 * STANDBY_WAIT_S
    often.set_back = 3
    waiting.add(often)
    assert [waiting.is_held_up(share * TRIAL_S) for share in (1.0, 7.9, 8.0)] == [False, False, True]
    waiting.add(fresh)
    assert [waiting.is_held_up(share * TRIAL_S) for share in (0.9, 1.0)] == [False, True]
    assert [waiting.take_held_up(time.monotonic()) for _ in range(2)] == [fresh, often]


def test_what_was_never_begun_comes_first_again_and_gave_way_to_nobody() -> None:
    waiting = _filled(["a", "a"])
    task = waiting.take()
    assert waiting.put_back(task, gave_way=False)
    assert task.set_back == 0
    assert waiting.take() is task
