"""Two files of answers beside each other: the same to the bit, or by how much each array differs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

Leaf = tuple[str, Any]
"""The place of a value in its array, such as "[3][0]", and the value."""


def compare(first: Path, second: Path) -> int:
    """Print how the second file's answers differ from the first's; 0 if they are the same to the bit, else 1."""
    before, now = (json.loads(file.read_text()) for file in (first, second))
    for name in sorted({*before["made_with"], *now["made_with"]}):
        one, other = (file["made_with"].get(name) for file in (before, now))
        if one != other:
            print(f"{name}: {one} -> {other}")
    names = list(dict.fromkeys([*before["answers"], *now["answers"]]))
    differing = 0
    for name in names:
        lines = list(_differences(before["answers"].get(name), now["answers"].get(name)))
        differing += bool(lines)
        print(f"{name}: {'differs' if lines else 'same to the bit'}")
        for line in lines:
            print(f"    {line}")
    print(f"{len(names) - differing} of {len(names)} are the same to the bit")
    return 1 if differing else 0


def _differences(before: Any, now: Any) -> Iterator[str]:
    if before is None or now is None:
        yield f"only in the {'second' if before is None else 'first'} file"
        return
    one, other = _arrays(before), _arrays(now)
    for name in dict.fromkeys([*one, *other]):
        if name not in one or name not in other:
            yield f"{name}: only in the {'second' if name not in one else 'first'}"
        elif repr(one[name]) != repr(other[name]):  # repr tells -0.0 from 0.0, and no two floats alike
            yield f"{name}: {_difference(one[name], other[name])}"


def _difference(one: list[Leaf], other: list[Leaf]) -> str:
    if [place for place, _ in one] != [place for place, _ in other]:
        return f"another shape: {len(one)} -> {len(other)} values"
    pairs = [(a, b, place) for (place, a), (_, b) in zip(one, other, strict=True) if repr(a) != repr(b)]
    numbers = [(abs(b - a), place) for a, b, place in pairs if _is_number(a) and _is_number(b)]
    if len(numbers) < len(pairs):
        a, b, place = next(pair for pair in pairs if not (_is_number(pair[0]) and _is_number(pair[1])))
        return f"{a!r} -> {b!r}{f' at {place}' if place else ''}"
    largest, place = max(numbers)
    return f"{len(pairs)} of {len(one)} values, by at most {largest:.3g}{f' at {place}' if place else ''}"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _arrays(answer: Any) -> dict[str, list[Leaf]]:
    """The values of an answer by the names on the way to them; values in lists under one name are one array."""
    found: dict[str, list[Leaf]] = {}
    for name, place, value in _leaves(answer, "", ""):
        found.setdefault(name, []).append((place, value))
    return found


def _leaves(value: Any, name: str, place: str) -> Iterator[tuple[str, str, Any]]:
    if isinstance(value, dict) and value:
        for key, one in value.items():
            yield from _leaves(one, f"{name}.{key}" if name else key, place)
    elif isinstance(value, list) and value:
        for i, one in enumerate(value):
            yield from _leaves(one, name, f"{place}[{i}]")
    else:
        yield name, place, value
