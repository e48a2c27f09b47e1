"""Frozen scenes: nobody changes them, so that memoized results about one stay valid as long as it lives.

A change of a frozen scene makes another frozen scene, which knows the one before it.
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

MAX_GONE_NUMBERS = 256
"""With more removed obstacles the others get new numbers; so they do with more obstacles in other versions."""


class Derivation(NamedTuple):
    """The change that made a scene from the one before, if that lives: indices removed there and moved here."""

    scene: weakref.ref[Scene]
    removed: Sequence[int]
    moved: Sequence[int]
    added: int


class NameIndex:
    """Indices of a scene's obstacles by name, updated by each change, because all are many.

    Obstacles are numbered in the order in which they were added: the index of one is its number minus the number of
    removed obstacles before it. Versions of a scene share the numbers, so that a name may have got another number in a
    version that this one doesn't know. Then they are numbered anew.
    """

    def __init__(self, obstacles: Sequence[Obstacle]) -> None:
        self._obstacles = obstacles
        self._numbered: tuple[dict[str, int], Sequence[int]] | None = None

    def of(self, name: str) -> int | None:
        """Return the index of an obstacle; None if there is none of that name."""
        numbers, gone = self._numbers()
        number = numbers.get(name)
        if number is None:
            return None
        before = bisect_left(gone, number)
        if self._stands(name, number - before) and not (before < len(gone) and gone[before] == number):
            return number - before
        self._numbered = None
        return self._numbers()[0].get(name)

    def after(self, obstacles: Sequence[Obstacle], removed: Sequence[int], added: int) -> NameIndex:
        """Return the index of a scene that a change made of this one: some removed by index, some added at the end."""
        places, (numbers, gone) = NameIndex(obstacles), self._numbers()
        of_others = len(numbers) - len(gone) - len(self._obstacles)  # versions that were changed apart from this one
        if max(len(gone) + len(removed), of_others) <= MAX_GONE_NUMBERS:
            gone = sorted([*gone, *(_find_number(index, gone) for index in removed)]) if removed else gone
            for index in range(len(obstacles) - added, len(obstacles)):
                numbers[obstacles[index].name] = index + len(gone)
            places._numbered = numbers, gone
        return places

    def _stands(self, name: str, index: int) -> bool:
        return index < len(self._obstacles) and self._obstacles[index].name == name

    def _numbers(self) -> tuple[dict[str, int], Sequence[int]]:
        if self._numbered is None:
            self._numbered = {one.name: index for index, one in enumerate(self._obstacles)}, ()
        return self._numbered


def _find_number(index: int, gone: Sequence[int]) -> int:
    """Return the number of the obstacle at an index, given the removed numbers, ascending."""
    number = index
    while (higher := index + bisect_right(gone, number)) > number:
        number = higher
    return number


@dataclass
class FrozenFacts:
    """The facts known of a frozen scene: the change that made it, unless it was declared whole; its index and hash."""

    before: Derivation | None = None
    places: NameIndex | None = None
    content: bytes | None = None


def freeze(scene: Scene, known: FrozenFacts | None = None) -> Scene:
    """Mark a scene as frozen and return it; the caller must be its only owner."""
    scene.__dict__["frozen"] = FrozenFacts() if known is None else known
    return scene


def frozen_facts(scene: Scene) -> FrozenFacts | None:
    """Return the facts known of a frozen scene; None of another."""
    return scene.__dict__.get("frozen")


def name_index(scene: Scene) -> NameIndex:
    """Return the indices of a scene's obstacles by name."""
    known = frozen_facts(scene)
    if known is None:
        return NameIndex(scene.obstacles)
    if known.places is None:
        known.places = NameIndex(scene.obstacles)
    return known.places


def copy_scene(scene: Scene) -> Scene:
    """Copy a scene for a caller who may change it."""
    given = _copy_lists(scene)
    for field in ("obstacles", "guide_planes"):
        msgspec.structs.force_setattr(given, field, [_copy_lists(one) for one in getattr(scene, field)])
    return given


def _copy_lists(declared: _Declared) -> _Declared:
    lists = {field: [*value] for field in declared.__struct_fields__ if type(value := getattr(declared, field)) is list}
    trajectory = getattr(declared, "trajectory", None)
    if not lists and trajectory is None:
        return declared
    copied = copy.copy(declared)
    for field, value in lists.items():
        msgspec.structs.force_setattr(copied, field, value)
    if trajectory is not None:
        msgspec.structs.force_setattr(copied, "trajectory", _copy_lists(trajectory))
    return copied
