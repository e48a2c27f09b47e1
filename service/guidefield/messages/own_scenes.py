"""Scenes that are ours: nobody changes them any more, so that what is found of one is true as long as it lives.

A scene that a change makes of one that is ours is ours too, and knows what it was before.
"""

from __future__ import annotations

import copy
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import msgspec

from guidefield.messages.scene import Scene

_Declared = TypeVar("_Declared", bound=msgspec.Struct)


class Before(NamedTuple):
    """What a scene was before a change; obstacles behind those that are left were added.

    Attributes:
        scene: The scene then, as long as anybody has it.
        left: Which of its obstacles are left, in their order; a range where it is all of them.
        moved: Which of the obstacles of the scene now are others than those that stood in their places.
    """

    scene: weakref.ref[Scene]
    left: Sequence[int]
    moved: Sequence[int]


@dataclass
class Own:
    """What is known of a scene that is ours.

    Attributes:
        before: What it was before it was changed; None: it came as it is.
        places: Index of each obstacle by its name, once somebody asked.
        content: What it is known by among those that were built, once somebody asked.
    """

    before: Before | None = None
    places: dict[str, int] | None = None
    content: bytes | None = None


def make_own(scene: Scene, known: Own | None = None) -> Scene:
    """Take a scene for ours, which whoever calls this may; the same object."""
    scene.__dict__["own"] = Own() if known is None else known
    return scene


def own(scene: Scene) -> Own | None:
    """What is known of a scene that is ours; None of another."""
    return scene.__dict__.get("own")


def places_of(scene: Scene) -> dict[str, int]:
    """Index of each obstacle by its name; nobody changes it."""
    known = own(scene)
    if known is not None and known.places is not None:
        return known.places
    places = {one.name: index for index, one in enumerate(scene.obstacles)}
    if known is not None:
        known.places = places
    return places


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
