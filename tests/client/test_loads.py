"""Which of several instances is the freest."""

from collections import Counter

from hypothesis import given, strategies as st

from guidefield.client.exchange import Loads


def test_a_burst_is_spread_though_nobody_told_anything_yet() -> None:
    loads, asked = Loads(), []
    for _ in range(8):
        least = loads.least({"a", "b"}, "b")
        loads.begin(least)
        asked.append(least)
    assert Counter(asked) == {"a": 4, "b": 4}
    assert asked[0] == "b", "of those that are equal the preferred one"
    for name in asked:
        loads.end(name)
    assert loads.least({"a", "b"}, "b") == "b"


def test_what_others_ask_counts_and_ones_own_only_once() -> None:
    loads = Loads()
    loads.begin("a")
    loads.report("a", workers=2, work=1)  # this client's own
    loads.report("b", workers=2, work=2)
    assert loads.least({"a", "b"}, "b") == "a"
    loads.report("a", workers=2, work=5)
    assert loads.least({"a", "b"}, "a") == "b"
    loads.forget("a")
    loads.end("a")
    assert loads.least({"a", "b"}, "b") == "a", "one that came back has nothing to do"
    assert loads.least((), "a") is None


@given(
    st.dictionaries(st.sampled_from("abcd"), st.tuples(st.integers(1, 4), st.integers(0, 9)), min_size=1),
    st.integers(1, 40),
)
def test_nobody_is_given_more_while_another_one_has_less(told: dict[str, tuple[int, int]], burst: int) -> None:
    loads, own = Loads(), Counter[str]()
    for name, (workers, others) in told.items():
        loads.report(name, workers, others)
    for _ in range(burst):
        least = loads.least(told, None)
        shares = {name: (own[name] + others) / workers for name, (workers, others) in told.items()}
        assert shares[least] == min(shares.values())
        loads.begin(least)
        own[least] += 1
