"""What is found once for an object, and forgotten together with it."""

from __future__ import annotations

import functools
import threading
import weakref
from collections.abc import Callable
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, cast

Key = TypeVar("Key")
Rest = ParamSpec("Rest")
Found = TypeVar("Found")

MOST = 16
"""Answers about one object that are kept, those asked for last: clients choose arguments, and memory is bounded."""

MISSING: Any = object()
"""In place of an answer that isn't there."""


class Answers(Generic[Found]):
    """What was found for objects, forgotten together with them.

    Args:
        most: So many about one object are kept, those asked for last.
    """

    def __init__(self, most: int = MOST) -> None:
        self._known: weakref.WeakKeyDictionary[Any, dict[Any, Found]] = weakref.WeakKeyDictionary()
        self._most = most
        self._changing = threading.RLock()  # what is forgotten may ask for something as it goes

    def of(self, owner: object, asked: object) -> Found:
        """What was found for an object when this was asked; `MISSING` if nothing was."""
        with self._changing:
            answers = self._known.get(owner, {})
            answer = answers.pop(asked, MISSING)
            if answer is not MISSING:
                answers[asked] = answer  # the last one asked for stands last
            return cast(Found, answer)

    def keep(self, owner: object, asked: object, answer: Found) -> Found:
        """Keep an answer, unless another one was sooner; the one that is kept."""
        with self._changing:
            answers = self._known.setdefault(owner, {})
            answer = answers.setdefault(asked, answer)
            while len(answers) > self._most:
                del answers[next(iter(answers))]
            return answer

    def forget(self, owner: object, asked: object) -> None:
        """Forget what was found for an object when this was asked, if anything was."""
        with self._changing:
            self._known.get(owner, {}).pop(asked, None)


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
    known = Answers[Found](most)

    @functools.wraps(find)
    def found(key: Key, /, *rest: Rest.args, **options: Rest.kwargs) -> Found:
        asked = (rest, *options.items())
        answer = known.of(owner(key), asked)
        return known.keep(owner(key), asked, find(key, *rest, **options)) if answer is MISSING else answer

    return found
