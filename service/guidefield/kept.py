"""What is found once for an object, and forgotten together with it."""

from __future__ import annotations

import functools
import threading
import weakref
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

Key = TypeVar("Key")
Rest = ParamSpec("Rest")
Found = TypeVar("Found")

MOST = 16
"""Answers about one object that are kept, those asked for last: clients choose arguments, and memory is bounded."""

_MISSING: Any = object()


def kept_with(find: Callable[Concatenate[Key, Rest], Found]) -> Callable[Concatenate[Key, Rest], Found]:
    """Call a function once for the same arguments, and keep what it finds as long as its first argument lives.

    Of answers to several further arguments the `MOST` are kept that were asked for last.

    A request makes planning groups and scenes that nothing else will ask for: kept by number, what was found for
    the last of them would stay in memory for ever. What is found must not hold the first argument, which would keep
    itself alive.

    Args:
        find: Takes one object that can be weakly referenced, then what can be hashed.
    """
    return kept_by(lambda key: key, find)


def kept_by(
    owner: Callable[[Key], object], find: Callable[Concatenate[Key, Rest], Found], most: int = MOST
) -> Callable[Concatenate[Key, Rest], Found]:
    """The same with something that the first argument has: found once for all that have it, as long as it lives.

    `most` answers about one object are kept.
    """
    known: weakref.WeakKeyDictionary[Any, dict[Any, Found]] = weakref.WeakKeyDictionary()
    changing = threading.RLock()  # what is forgotten may ask for something as it goes

    @functools.wraps(find)
    def found(key: Key, /, *rest: Rest.args, **options: Rest.kwargs) -> Found:
        answers = known.setdefault(owner(key), {})
        asked = (rest, *options.items())
        with changing:
            answer = answers.pop(asked, _MISSING)
            if answer is not _MISSING:
                answers[asked] = answer  # the last one asked for stands last
                return cast(Found, answer)
        answer = find(key, *rest, **options)
        with changing:
            answer = answers.setdefault(asked, answer)
            while len(answers) > most:
                del answers[next(iter(answers))]
        return answer

    return found
