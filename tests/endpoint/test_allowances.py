"""What is left to a user of its quota."""

import pytest
from hypothesis import given, strategies as st

from guidefield.endpoint import allowances as rooms
from guidefield.endpoint.allowances import Allowances
from guidefield.errors import QuotaExceeded
from guidefield.messages.identities import Asker, Quota, Quotas
from guidefield.pool import waiting as queue
from guidefield.pool.waiting import Limits, Task, Waiting


class _Clock:
    """Stands in for the clock of a room."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 1_000.0
        for room in (rooms, queue):
            monkeypatch.setattr(room, "time", self)

    def monotonic(self) -> float:
        return self.now


@given(st.floats(0.5, 50.0), st.lists(st.floats(0.0, 2.0), min_size=1, max_size=60))
def test_queries_are_answered_at_the_rate_and_no_faster(rate: float, pauses: list[float]) -> None:
    """In any span of time at most the rate times it, and as many at once; who waits as long as told is let in."""
    with pytest.MonkeyPatch.context() as patch:
        clock = _Clock(patch)
        allowances = Allowances(Quotas(default=Quota(per_second=rate)), Waiting(Limits()))
        let_in: list[float] = []
        for pause in pauses:
            clock.now += pause
            try:
                allowances.ask("alice")
            except QuotaExceeded as refused:
                clock.now += refused.details["retry_after"] + 0.001
                allowances.ask("alice")
            let_in.append(clock.now)
        for first in range(len(let_in)):
            for last in range(first, len(let_in)):
                assert last - first + 1 <= max(1.0, rate) + rate * (let_in[last] - let_in[first]) + 1e-6


def test_one_users_queries_cost_no_other_user_any() -> None:
    allowances = Allowances(Quotas(default=Quota(per_second=1.0)), Waiting(Limits()))
    allowances.ask("alice")
    for _ in range(100):
        with pytest.raises(QuotaExceeded, match="1 queries a second; ask again in"):
            allowances.ask("alice")
    allowances.ask("bob")


@given(st.floats(0.5, 50.0))
def test_a_list_counts_as_ten_queries(rate: float) -> None:
    with pytest.MonkeyPatch.context() as patch:
        clock = _Clock(patch)
        allowances = Allowances(Quotas(default=Quota(per_second=rate)), Waiting(Limits()))
        for _ in range(int((max(1.0, rate) - 1.0) / rooms.LIST_COUNTS) + 1):
            allowances.ask("alice", lists=True)
        with pytest.raises(QuotaExceeded) as refused:
            allowances.ask("alice", lists=True)
        assert refused.value.details["retry_after"] <= rooms.LIST_COUNTS / rate + 0.001
        clock.now += refused.value.details["retry_after"] + 0.001
        allowances.ask("alice", lists=True)


def test_what_waits_is_bounded_for_each_user() -> None:
    waiting = Waiting(Limits())
    quotas = Quotas(users={"alice": Quota(waiting=2)})
    allowances = Allowances(quotas, waiting)
    for _ in range(2):
        allowances.work("alice")
        waiting.add(Task(0, 1.0, asker=Asker("alice")))
    with pytest.raises(QuotaExceeded, match="2 requests that wait") as refused:
        allowances.work("alice")
    assert refused.value.details["waiting"] == 2
    assert refused.value.details["retry_after"] > 0.0
    allowances.work("bob")


def test_who_got_enough_of_the_processors_waits_until_it_counts_less(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, waiting = _Clock(monkeypatch), Waiting(Limits())
    allowances = Allowances(Quotas(default=Quota(processor_per_minute=6.0)), waiting)
    begun = 0.0
    for _ in range(2_000):
        try:
            allowances.work("alice")
        except QuotaExceeded as refused:
            clock.now += refused.details["retry_after"] + 0.001
            allowances.work("alice")
        waiting.add(Task(0, 1.0, asker=Asker("alice")))
        task = waiting.take()
        assert task is not None
        clock.now += 0.5
        waiting.settle(task, 0.5, 0.5)
        begun += 0.5
    assert begun / (clock.now - 1_000.0) * 60.0 == pytest.approx(6.0, rel=0.1)


@given(st.floats(1e6, 1e8), st.lists(st.tuples(st.floats(0.0, 5.0), st.integers(1, 2**26)), min_size=1, max_size=40))
def test_payloads_come_at_the_rate_and_no_faster(rate: float, sent: list[tuple[float, int]]) -> None:
    """In any span of time the rate times it, what may come at once, and the last one, which may be in debt."""
    with pytest.MonkeyPatch.context() as patch:
        clock = _Clock(patch)
        allowances = Allowances(Quotas(default=Quota(payload_per_second=rate)), Waiting(Limits()))
        let_in: list[tuple[float, int]] = []
        for pause, size in sent:
            clock.now += pause
            try:
                allowances.ask("alice", size)
            except QuotaExceeded as refused:
                allowances.ask("alice")  # what has no payload
                clock.now += refused.details["retry_after"] + 0.001
                allowances.ask("alice", size)
            let_in.append((clock.now, size))
        for first in range(len(let_in)):
            for last in range(first, len(let_in)):
                before = sum(size for _, size in let_in[first:last])
                assert before <= rooms.BURST_BYTES + rate * (let_in[last][0] - let_in[first][0]) + 1.0


def test_a_query_that_is_refused_costs_no_payload(monkeypatch: pytest.MonkeyPatch) -> None:
    _Clock(monkeypatch)
    quota = Quota(per_second=1.0, payload_per_second=1.0)
    allowances = Allowances(Quotas(default=quota, users={"bob": quota}), Waiting(Limits()))
    allowances.ask("alice", rooms.BURST_BYTES - 1)
    with pytest.raises(QuotaExceeded, match="1 queries a second"):
        allowances.ask("alice", 100)
    allowances.ask("bob", rooms.BURST_BYTES)
    assert allowances._payloads.rest("alice", 1.0, rooms.BURST_BYTES, 1_000.0) == 1.0


def test_who_is_idle_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = _Clock(monkeypatch)
    allowances = Allowances(Quotas(default=Quota(per_second=1.0)), Waiting(Limits()))
    for number in range(3 * rooms.MAX_USERS):
        clock.now += 0.1
        allowances.ask(f"user{number}")
    assert len(allowances._queries) <= rooms.MAX_USERS + 1
