"""A bounded map keeps what was used last, within its entries and bytes."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from guidefield.bounded_map import BoundedMap, Limit


def test_the_entry_used_least_recently_goes_first() -> None:
    known = BoundedMap[str, str](Limit(2, 100))
    for key in "ab":
        known.insert(key, key.upper())
    assert known.get("a") == "A"
    known.insert("c", "C")
    assert [known.get(key) for key in "abc"] == ["A", None, "C"]


def test_bytes_count_and_one_entry_stays_however_large() -> None:
    known = BoundedMap[str, str](Limit(9, 100))
    for key, size in (("a", 40), ("b", 40), ("c", 30)):
        known.insert(key, key.upper(), size)
    assert [known.get(key) for key in "abc"] == [None, "B", "C"]
    known.insert("d", "D", 1000)
    assert [known.get(key) for key in "bcd"] == [None, None, "D"]
    known.insert("e", "E", 10)
    assert [known.get(key) for key in "de"] == [None, "E"]


def test_the_first_value_of_a_key_stays() -> None:
    known = BoundedMap[str, str](Limit(2, 100))
    assert known.insert("a", "first", 60) == "first"
    assert known.insert("a", "second", 60) == "first"
    known.insert("b", "B", 40)
    assert known.get("a") == "first", "it was counted once"


def test_threads_that_ask_at_once_get_one_value_and_what_fails_is_tried_again() -> None:
    known, made, begun = BoundedMap[str, list[int]](Limit(2, 100)), list[list[int]](), threading.Barrier(4)

    def make() -> list[int]:
        time.sleep(0.05)  # the others have come by then
        made.append([7])
        return made[-1]

    def ask() -> list[int]:
        begun.wait()
        return known.find("a", make, len)

    def fail() -> list[int]:
        raise ValueError("flat")

    with pytest.raises(ValueError, match="flat"):
        known.find("a", fail, len)
    with ThreadPoolExecutor(4) as pool:
        found = [one.result() for one in [pool.submit(ask) for _ in range(4)]]
    assert len(made) == 1
    assert all(one is made[0] for one in found)
    assert known.size == 1
