"""Scenes that are ours: nobody changes them any more, so that what is found of one is true as long as it lives.

A scene that a change makes of one that is ours is ours too, and knows what it was before.
"""

from __future__ import annotations

import copy
import weakref
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import msgspec

from guidefield.messages.scene import Obstacle, Scene

_Declared = TypeVar("_Declared", bound=msgspec.Struct)

MOST_GONE = 256
"""Where more obstacles are gone the others are numbered anew; so are they where more have numbers in other versions."""


class Before(NamedTuple):
    """The scene before a change.

    Attributes:
        scene: The scene then, as long as anybody has it.
        removed: Which of its obstacles are gone, ascending.
        moved: Which of the obstacles that are left are others now, by where they stand now, ascending.
        added: How many stand behind those.
    """

    scene: weakref.ref[Scene]
    removed: Sequence[int]
    moved: Sequence[int]
    added: int


class Places:
    """Indices of a scene's obstacles by name, updated by each change, because all are many.

    Obstacles have numbers in the order in which they came: one stands as many places before its number as of those
    before it are gone. Versions of a scene share the numbers, so that a name may have got another one in a version of
    which this one knows nothing. Then they are numbered anew.

    Args:
        obstacles: Of the scene; nobody changes them.
    """

    def __init__(self, obstacles: Sequence[Obstacle]) -> None:
        self._obstacles = obstacles
        self._numbered: tuple[dict[str, int], Sequence[int]] | None = None

    def of(self, name: str) -> int | None:
        """The index of an obstacle; None if there is none of that name."""
        numbers, gone = self._numbers()
        number = numbers.get(name)
        if number is None:
            return None
        before = bisect_left(gone, number)
        if self._stands(name, number - before) and not (before < len(gone) and gone[before] == number):
            return number - before
        self._numbered = None
        return self._numbers()[0].get(name)

    def after(self, obstacles: Sequence[Obstacle], removed: Sequence[int], added: int) -> Places:
        """Those of the obstacles of a scene that a change made of this one.

        Args:
            obstacles: As they are now, those behind that were added.
            removed: Which of the obstacles here are gone, ascending.
            added: How many were added.
        """
        places, (numbers, gone) = Places(obstacles), self._numbers()
        of_others = len(numbers) - len(gone) - len(self._obstacles)  # versions that were changed apart from this one
        if max(len(gone) + len(removed), of_others) <= MOST_GONE:
            gone = sorted([*gone, *(_number_of(index, gone) for index in removed)]) if removed else gone
            for index in range(len(obstacles) - added, len(obstacles)):
                numbers[obstacles[index].name] = index + len(gone)
            places._numbered = numbers, gone
        return places

    def _stands(self, name: str, index: int) -> bool:
        return index < len(self._obstacles) and self._obstacles[index].name == name

    def _numbers(self) -> tuple[dict[str, int], Sequence[int]]:
        """The number of each name, and the numbers that are gone, ascending."""
        if self._numbered is None:
            self._numbered = {one.name: index for index, one in enumerate(self._obstacles)}, ()
        return self._numbered


def _number_of(index: int, gone: Sequence[int]) -> int:
    """The number of what stands at an index, where some numbers are gone, ascending."""
    number = index
    while (higher := index + bisect_right(gone, number)) > number:
        number = higher
    return number


@dataclass
class Own:
    """The facts known of a frozen scene.

    Attributes:
        before: What it was before it was changed; None: it came as it is.
        places: Where its obstacles stand, once somebody asked.
        content: What it is known by among those that were built, once somebody asked.
    """

    before: Before | None = None
    places: Places | None = None
    content: bytes | None = None


def make_own(scene: Scene, known: Own | None = None) -> Scene:
    """Take a scene for ours, which whoever calls this may; the same object."""
    scene.__dict__["own"] = Own() if known is None else known
    return scene


def own(scene: Scene) -> Own | None:
    """Return the facts known of a frozen scene; None of another."""
    return scene.__dict__.get("own")


def places_of(scene: Scene) -> Places:
    """Return the indices of a scene's obstacles by name."""
    known = own(scene)
    if known is None:
        return Places(scene.obstacles)
    if known.places is None:
        known.places = Places(scene.obstacles)
    return known.places


def to_give(scene: Scene) -> Scene:
    """The same scene for somebody who may change it."""
    given = _with_own_lists(scene)
    for field in ("obstacles", "guide_planes"):
        msgspec.structs.force_setattr(given, field, [_with_own_lists(one) for one in getattr(scene, field)])
    return given


def _with_own_lists(declared: _Declared) -> _Declared:
    """A message with copies of its lists and of those of what moves it; itself where it has none."""
    lists = {field: [*value] for field in declared.__struct_fields__ if type(value := getattr(declared, field)) is list}
    trajectory = getattr(declared, "trajectory", None)
    if not lists and trajectory is None:
        return declared
    copied = copy.copy(declared)
    for field, value in lists.items():
        msgspec.structs.force_setattr(copied, field, value)
    if trajectory is not None:
        msgspec.structs.force_setattr(copied, "trajectory", _with_own_lists(trajectory))
    return copied
