"""A bounded map keeps what was used last, within its entries and bytes."""

from __future__ import annotations

from guidefield.bounded_map import BoundedMap, Limit


def test_the_entry_used_least_recently_goes_first() -> None:
    known = BoundedMap[str, str](Limit(2, 100))
    for key in "ab":
        known.put(key, key.upper())
    assert known.get("a") == "A"
    known.put("c", "C")
    assert [known.get(key) for key in "abc"] == ["A", None, "C"]


def test_bytes_count_and_one_entry_stays_however_large() -> None:
    known = BoundedMap[str, str](Limit(9, 100))
    for key, size in (("a", 40), ("b", 40), ("c", 30)):
        known.put(key, key.upper(), size)
    assert [known.get(key) for key in "abc"] == [None, "B", "C"]
    known.put("d", "D", 1000)
    assert [known.get(key) for key in "bcd"] == [None, None, "D"]
    known.put("e", "E", 10)
    assert [known.get(key) for key in "de"] == [None, "E"]


def test_the_first_value_of_a_key_stays() -> None:
    known = BoundedMap[str, str](Limit(2, 100))
    assert known.put("a", "first", 60) == "first"
    assert known.put("a", "second", 60) == "first"
    known.put("b", "B", 40)
    assert known.get("a") == "first", "it was counted once"
