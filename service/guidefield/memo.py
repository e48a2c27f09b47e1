"""Memoize functions of an object, or of values: results are freed with the object, or earlier if memory is short.

All results of a process are in one map bounded by `FOUND`; `size_of` estimates their memory. An object is marked with
an attribute, so it needs a `__dict__`.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import threading
from collections.abc import Callable
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, cast

from guidefield.memory import FOUND, BoundedMap

Key = TypeVar("Key")
Rest = ParamSpec("Rest")
Found = TypeVar("Found")

MAX_PER_OBJECT = 16
"""The largest number of results of a function for an object, the most recently used, since clients choose arguments."""
BYTES_PER_TRIANGLE = 560  # memory of a tree of Coal per triangle, which has two nodes
MISSING: Any = object()  # marks a missing result

_FOUND: BoundedMap[tuple[int, int, object], tuple[Any]] = BoundedMap(FOUND)

_MARK_ATTRIBUTE = "_found"  # attribute of an object with its mark

_numbers = itertools.count()

_MARKING = threading.Lock()  # held while an object is marked: two marks would lose the results of one thread


class _Mark:
    """Marks an object with memoized results, and frees these with it.

    Attributes:
        owner: The object's id, which distinguishes it from a copy of its fields.
        results: The map with the results: the module's name may be gone when the interpreter ends.
        asked: Arguments by number of the function, in the order of last use.
    """

    __slots__ = ("asked", "owner", "results")

    def __init__(self, owner: object) -> None:
        self.owner, self.results = id(owner), _FOUND
        self.asked: dict[int, dict[object, None]] = {}

    def __del__(self) -> None:
        for function, asked in self.asked.items():
            for each in asked:
                self.results.remove((id(self), function, each))

    def __reduce__(self) -> tuple[Any, ...]:
        return _no_mark, ()


def _no_mark() -> None:
    """Unpickle a mark as None: results stay in their process."""


class Answers(Generic[Found]):
    """The memoized results of one function; at most a number for an object, the most recently used."""

    def __init__(self, most: int = MAX_PER_OBJECT) -> None:
        self._most, self._number = most, next(_numbers)

    def of(self, owner: object, asked: object) -> Found:
        """Return the result for an object and arguments; `MISSING` if there is none, or it was freed."""
        mark = vars(owner).get(_MARK_ATTRIBUTE)
        if mark is None or mark.owner != id(owner):
            return cast(Found, MISSING)
        found: tuple[Found] | None = _FOUND.get((id(mark), self._number, asked))
        if found is None:
            return cast(Found, MISSING)
        latest = mark.asked[self._number]
        if len(latest) > 1:
            latest[asked] = latest.pop(asked, None)
        return found[0]

    def keep(self, owner: object, asked: object, answer: Found) -> Found:
        """Store a result unless there is one already; return the stored one."""
        with _MARKING:
            mark = vars(owner).get(_MARK_ATTRIBUTE)
            if mark is None or mark.owner != id(owner):
                mark = vars(owner)[_MARK_ATTRIBUTE] = _Mark(owner)
        latest = mark.asked.setdefault(self._number, {})  # before the result is there for other threads
        kept = _FOUND.insert((id(mark), self._number, asked), (answer,), size_of(answer))[0]
        latest[asked] = latest.pop(asked, None)
        while len(latest) > self._most:
            oldest = next(iter(latest))
            del latest[oldest]
            _FOUND.remove((id(mark), self._number, oldest))
        return cast(Found, kept)

    def forget(self, owner: object, asked: object) -> None:
        """Free the result for an object and arguments, if there is one."""
        mark = vars(owner).get(_MARK_ATTRIBUTE)
        if mark is not None and mark.owner == id(owner):
            mark.asked.get(self._number, {}).pop(asked, None)
            _FOUND.remove((id(mark), self._number, asked))


class MemoSet:
    """A set of objects, which are removed as memoized results are freed."""

    def __init__(self) -> None:
        self._done = Answers[bool](1)

    def __contains__(self, owner: object) -> bool:
        return self._done.of(owner, None) is not MISSING

    def add(self, owner: object) -> None:
        """Add an object."""
        self._done.keep(owner, None, True)


class SharedAnswer:
    """Base of dataclasses that several results refer to: their memory counts only in a result of their own."""


def memoized(find: Callable[Concatenate[Key, Rest], Found]) -> Callable[Concatenate[Key, Rest], Found]:
    """Memoize a function for at most the lifetime of its first argument.

    Results must not refer to the first argument, which would keep itself alive.

    Args:
        find: Takes one object with a `__dict__`, then hashable arguments.
    """
    return memoized_by(lambda key: key, find)


def memoized_by(
    owner: Callable[[Key], object], find: Callable[Concatenate[Key, Rest], Found], most: int = MAX_PER_OBJECT
) -> Callable[Concatenate[Key, Rest], Found]:
    """Memoize a function for all first arguments with the same owner, as `memoized`.

    Args:
        owner: Returns the owner of a first argument.
        find: The function.
        most: The largest number of results for an owner.
    """
    known = Answers[Found](most)

    @functools.wraps(find)
    def look_up(key: Key, /, *rest: Rest.args, **options: Rest.kwargs) -> Found:
        asked = (rest, *options.items())
        answer = known.of(owner(key), asked)
        return known.keep(owner(key), asked, find(key, *rest, **options)) if answer is MISSING else answer

    return look_up


def memoized_by_value(most: int) -> Callable[[Callable[Rest, Found]], Callable[Rest, Found]]:
    """Memoize at most a number of results of a function of hashable values, those used most recently."""

    def memoize(find: Callable[Rest, Found]) -> Callable[Rest, Found]:
        known = Answers[Found](most)

        @functools.wraps(find)
        def look_up(*values: Rest.args, **options: Rest.kwargs) -> Found:
            asked = (values, *options.items())
            answer = known.of(find, asked)
            return known.keep(find, asked, find(*values, **options)) if answer is MISSING else answer

        return look_up

    return memoize


MAX_FULLY_MEASURED, SAMPLE_SIZE = 64, 32  # of a sequence with more items, a sample is measured; 1st >= 2nd


_SMALL = frozenset({int, float, str, bool, type(None)})  # types whose size doesn't count

_CONTAINERS = tuple, list, dict


def size_of(answer: object) -> int:
    """Estimate the memory of a result [bytes]: its arrays, without those of objects with results, or shared ones."""
    sizes = dict[int, int]()
    _add_sizes(answer, sizes)
    return sum(sizes.values())


def _add_sizes(value: Any, sizes: dict[int, int]) -> None:
    kind: Any = type(value)
    if kind in _SMALL or id(value) in sizes:
        return
    add = _choose_measure(kind)
    if add is not None:
        add(value, sizes)


@functools.cache
def _choose_measure(kind: type) -> Callable[[Any, dict[int, int]], None] | None:
    """Return how the size of values of a type is added; None if they have none."""
    import numpy as np  # here: a service imports this module before it needs arrays

    add: Callable[[Any, dict[int, int]], None] | None = None
    if issubclass(kind, np.ndarray):
        add = _add_array
    elif issubclass(kind, bytes):
        add = lambda value, sizes: sizes.update({id(value): len(value)})  # noqa: E731
    elif issubclass(kind, _CONTAINERS):
        add = _add_container
    elif hasattr(kind, "to_record_batch"):  # a chunk of a recording
        add = lambda value, sizes: sizes.update({id(value): value.to_record_batch().nbytes})  # noqa: E731
    elif hasattr(kind, "num_tris"):
        add = lambda value, sizes: sizes.update({id(value): BYTES_PER_TRIANGLE * int(value.num_tris)})  # noqa: E731
    elif dataclasses.is_dataclass(kind):
        add = _add_shared if issubclass(kind, SharedAnswer) else _add_fields
    return add


def _add_array(value: Any, sizes: dict[int, int]) -> None:
    owner = id(value if value.base is None else value.base)  # of which there may be several views
    sizes[owner] = max(value.nbytes, sizes.get(owner, 0))


def _add_container(value: Any, sizes: dict[int, int]) -> None:
    sizes[id(value)] = 8 * len(value)
    if len(value) > MAX_FULLY_MEASURED and not isinstance(value, dict):
        some = value[:: len(value) // SAMPLE_SIZE]
        sizes[id(value)] += len(value) * sum(map(size_of, some)) // len(some)
        return
    for one in value.values() if isinstance(value, dict) else value:
        if type(one) not in _SMALL:
            _add_sizes(one, sizes)


def _add_shared(value: Any, sizes: dict[int, int]) -> None:
    if not sizes:
        _add_fields(value, sizes)


def _add_fields(value: Any, sizes: dict[int, int]) -> None:
    fields = getattr(value, "__dict__", _NO_FIELDS)
    if _MARK_ATTRIBUTE in fields:
        return
    sizes[id(value)] = 0
    for one in fields.values():
        if type(one) not in _SMALL:
            _add_sizes(one, sizes)


_NO_FIELDS: dict[str, Any] = {}  # of a value with slots
