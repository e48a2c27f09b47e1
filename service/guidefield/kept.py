"""What is found once for an object, and forgotten together with it."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec, TypeVar

Key = TypeVar("Key")
Rest = ParamSpec("Rest")
Found = TypeVar("Found")


def kept_with(find: Callable[Concatenate[Key, Rest], Found]) -> Callable[Concatenate[Key, Rest], Found]:
    """Call a function once for the same arguments, and keep what it finds as long as its first argument lives.

    A request makes planning groups and scenes that nothing else will ask for: kept by number, what was found for
    the last of them would stay in memory for ever. What is found must not hold the first argument, which would keep
    itself alive.

    Args:
        find: Takes one object that can be weakly referenced, then what can be hashed.
    """
    return kept_by(lambda key: key, find)


def kept_by(
    owner: Callable[[Key], object], find: Callable[Concatenate[Key, Rest], Found]
) -> Callable[Concatenate[Key, Rest], Found]:
    """The same with something that the first argument has: found once for all that have it, as long as it lives."""
    known: weakref.WeakKeyDictionary[Any, dict[Any, Found]] = weakref.WeakKeyDictionary()

    @functools.wraps(find)
    def found(key: Key, /, *rest: Rest.args, **options: Rest.kwargs) -> Found:
        answers = known.setdefault(owner(key), {})
        asked = (rest, *options.items())
        if asked not in answers:
            answers[asked] = find(key, *rest, **options)
        return answers[asked]

    return found
