"""Functions that find something once for an object: what is found goes with it, and sooner where memory is short."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, cast

import numpy as np

from guidefield.bounded_map import FOUND, BoundedMap

Key = TypeVar("Key")
Rest = ParamSpec("Rest")
Found = TypeVar("Found")

MAX_PER_OBJECT = 16
"""Most answers of one function about one object, those asked for last: clients choose arguments."""

BYTES_PER_TRIANGLE = 560
"""Memory of a tree of Coal, which has two nodes for a triangle."""

MISSING: Any = object()
"""In place of an answer that isn't there."""

_FOUND: BoundedMap[tuple[int, int, object], tuple[Any]] = BoundedMap(FOUND)

_PLACE = "_found"
"""Where an object has its mark."""

_numbers = itertools.count()


class _Mark:
    """Marks an object for which something was found, and forgets that when the object goes.

    Attributes:
        owner: The object's id, by which a copy of its fields is told from it.
        asked: What was asked of each function, by its number, in the order of last use.
    """

    __slots__ = ("asked", "known", "owner")

    def __init__(self, owner: object) -> None:
        self.owner, self.known = id(owner), _FOUND
        self.asked: dict[int, dict[object, None]] = {}

    def __del__(self) -> None:
        for function, asked in self.asked.items():
            for each in asked:
                self.known.remove((id(self), function, each))

    def __reduce__(self) -> tuple[Any, ...]:
        return _no_mark, ()


def _no_mark() -> None:
    """Found answers don't travel with an object to another process."""


class Answers(Generic[Found]):
    """The answers of one function about objects.

    Args:
        most: Most answers about one object, those asked for last.
    """

    def __init__(self, most: int = MAX_PER_OBJECT) -> None:
        self._most, self._number = most, next(_numbers)

    def of(self, owner: object, asked: object) -> Found:
        """Return what was found for an object when this was asked; `MISSING` if nothing was, or it is forgotten."""
        mark = vars(owner).get(_PLACE)
        if mark is None or mark.owner != id(owner):
            return cast(Found, MISSING)
        found = _FOUND.get((id(mark), self._number, asked))
        if found is None:
            return cast(Found, MISSING)
        latest = mark.asked[self._number]
        latest[asked] = latest.pop(asked, None)
        return cast(Found, found[0])

    def keep(self, owner: object, asked: object, answer: Found) -> Found:
        """Keep an answer, unless another one was sooner; return the one that is kept."""
        mark = vars(owner).get(_PLACE)
        if mark is None or mark.owner != id(owner):
            mark = vars(owner)[_PLACE] = _Mark(owner)
        kept = _FOUND.put((id(mark), self._number, asked), (answer,), size_of(answer))[0]
        latest = mark.asked.setdefault(self._number, {})
        latest[asked] = latest.pop(asked, None)
        while len(latest) > self._most:
            oldest = next(iter(latest))
            del latest[oldest]
            _FOUND.remove((id(mark), self._number, oldest))
        return cast(Found, kept)

    def forget(self, owner: object, asked: object) -> None:
        """Forget what was found for an object when this was asked, if anything was."""
        mark = vars(owner).get(_PLACE)
        if mark is not None and mark.owner == id(owner):
            mark.asked.get(self._number, {}).pop(asked, None)
            _FOUND.remove((id(mark), self._number, asked))


class MemoSet:
    """The objects for which something was done once; they are forgotten as answers are."""

    def __init__(self) -> None:
        self._done = Answers[bool](1)

    def __contains__(self, owner: object) -> bool:
        return self._done.of(owner, None) is not MISSING

    def add(self, owner: object) -> None:
        """Add an object."""
        self._done.keep(owner, None, True)


class SharedAnswer:
    """Base of answers that others hold: the memory of each counts where it is found alone."""


def memoized(find: Callable[Concatenate[Key, Rest], Found]) -> Callable[Concatenate[Key, Rest], Found]:
    """Call a function once for the same arguments, and keep what it finds at most as long as its first argument lives.

    What is found must not hold the first argument, which would keep itself alive.

    Args:
        find: Takes one object with a `__dict__`, then what can be hashed.
    """
    return memoized_by(lambda key: key, find)


def memoized_by(
    owner: Callable[[Key], object], find: Callable[Concatenate[Key, Rest], Found], most: int = MAX_PER_OBJECT
) -> Callable[Concatenate[Key, Rest], Found]:
    """Call a function once for all first arguments that have the same owner, as `memoized`.

    Args:
        owner: Returns what an argument has for which something is found once.
        find: The function.
        most: Most answers about one owner.
    """
    known = Answers[Found](most)

    @functools.wraps(find)
    def found(key: Key, /, *rest: Rest.args, **options: Rest.kwargs) -> Found:
        asked = (rest, *options.items())
        answer = known.of(owner(key), asked)
        return known.keep(owner(key), asked, find(key, *rest, **options)) if answer is MISSING else answer

    return found


def lasting(find: Callable[[Key], Found]) -> Callable[[Key], Found]:
    """Call a function once for an object and keep what it finds as long as that lives, whatever memory it takes.

    It is for what others hold addresses of, and must not hold the object.
    """
    place = f"{find.__module__}.{find.__qualname__}"

    @functools.wraps(find)
    def found(owner: Key) -> Found:
        kept = vars(owner)
        return cast(Found, kept[place] if place in kept else kept.setdefault(place, find(owner)))

    return found


MAX_FULLY_MEASURED, SAMPLE_SIZE = 512, 32
"""Of a sequence with more items the size of about so many tells that of all."""


def size_of(answer: object) -> int:
    """Estimate the memory of an answer [bytes]: its arrays, without those of objects that have or share answers."""
    sizes = dict[int, int]()
    _add_sizes(answer, sizes)
    return sum(sizes.values())


def _add_sizes(value: Any, sizes: dict[int, int]) -> None:
    if id(value) in sizes or isinstance(value, int | float | str | None) or (sizes and isinstance(value, SharedAnswer)):
        return
    if isinstance(value, np.ndarray):
        address = value.__array_interface__["data"][0]  # of which there are several views
        sizes[address] = max(value.nbytes, sizes.get(address, 0))
    elif isinstance(value, bytes):
        sizes[id(value)] = len(value)
    elif isinstance(value, tuple | list | dict):
        sizes[id(value)] = 8 * len(value)
        if len(value) > MAX_FULLY_MEASURED and not isinstance(value, dict):
            some = value[:: len(value) // SAMPLE_SIZE]
            sizes[id(value)] += len(value) * sum(map(size_of, some)) // len(some)
            return
        for one in value.values() if isinstance(value, dict) else value:
            _add_sizes(one, sizes)
    elif hasattr(value, "num_tris"):
        sizes[id(value)] = BYTES_PER_TRIANGLE * int(value.num_tris)
    elif dataclasses.is_dataclass(value) and not (hasattr(value, "__dict__") and _PLACE in vars(value)):
        sizes[id(value)] = 0
        for one in vars(value).values() if hasattr(value, "__dict__") else ():
            _add_sizes(one, sizes)
