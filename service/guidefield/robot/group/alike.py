"""Results shared by all alike groups of a robot, as every request makes a group of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from guidefield.memo import memoized_by

Rest = ParamSpec("Rest")
Found = TypeVar("Found")


class Alike:
    """Stands for groups of a robot that differ in where they start and in the limits of their rates, and in no more."""


class OneOfAlike(Protocol):
    """A group that others may be alike."""

    @property
    def alike(self) -> Alike:
        """What stands for all of them."""


Group = TypeVar("Group", bound=OneOfAlike)


def memoized_for_alike(
    find: Callable[Concatenate[Group, Rest], Found],
) -> Callable[Concatenate[Group, Rest], Found]:
    """Call a function once for groups that are alike and the same further arguments; see `memoized`.

    It depends on nothing in which such groups differ: q_reference, q_origin, limits of velocities and accelerations.
    Its result must not hold the group.
    """
    return memoized_by(lambda group: group.alike, find)
