"""Scenes that were checked already: who asks about a large one again and again has it checked once."""

from __future__ import annotations

import contextlib
from typing import Any, NamedTuple

from guidefield.messages.own_scenes import make_own
from guidefield.messages.scene import Scene
from guidefield.messages.scene_changes import RequestScene
from guidefield.messages.seen_parts import Parts, SeenParts
from guidefield.messages.seen_payload import Payload, SeenPayload
from guidefield.messages.seen_plain import SeenPlain
from guidefield.messages.seen_scene import SeenScene, parts_of
from guidefield.messages.values import Look, never

WORTH = 64
"""Scenes of fewer obstacles, corners and triangles are sooner checked than known again."""

MOST_PARTS = 4_000_000
"""Obstacles, corners and triangles of all that are kept; a million take some tens of megabytes."""

MOST_BYTES = 2**28
"""Of arrays, packed numbers and payloads that are kept."""


_Seen = SeenScene | SeenParts | SeenPlain | SeenPayload


class _Checked(NamedTuple):
    seen: Any
    scene: Scene
    parts: int


class CheckedScenes:
    """The scenes that were checked last, in the forms in which they were given.

    Args:
        most: How many are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: tuple[_Checked, ...] = ()

    def __bool__(self) -> bool:
        """Whether any is kept."""
        return bool(self._kept)

    def of(self, given: Any, look: Look = never) -> Scene | None:
        """The checked form of a scene that holds what one did that was checked; None where none is known.

        Args:
            given: As it is given: a message, a dict, or the payload that it is in.
            look: Called again and again while a large one is compared.
        """
        for kind in _kinds_of(given):
            kept = [one for one in self._kept if type(one.seen) is kind]
            asked = _asked(kind, given) if kept else None
            if asked is not None and (like := next((one for one in kept if one.seen.is_like(asked, look)), None)):
                return like.scene
        return None

    def keep(self, given: Any, checked: object, look: Look = never) -> None:
        """Keep a scene that passed, if it is worth it.

        Args:
            given: As it was given.
            checked: As the decoder made it: nobody may change it any more, it is ours.
            look: Called again and again while a large one is looked at.
        """
        if not isinstance(checked, Scene) or (isinstance(checked, RequestScene) and checked.base is not None):
            return
        parts = parts_of(checked)
        seen = _seen(given, look) if parts >= WORTH else None
        if seen is None:
            return
        kept = [_Checked(seen, make_own(checked), parts)]
        left, bytes_left = MOST_PARTS - parts, MOST_BYTES - _size(seen)
        for one in self._kept[: self._most - 1]:
            left, bytes_left = left - one.parts, bytes_left - _size(one.seen)
            if min(left, bytes_left) >= 0:
                kept.append(one)
        self._kept = tuple(kept)


def _kinds_of(given: object) -> tuple[type[_Seen], ...]:
    """What a scene in a form may be known by."""
    if isinstance(given, Payload):
        return (SeenPayload,)
    if type(given) is Scene:
        return SeenScene, SeenParts
    if isinstance(given, dict):
        return SeenParts, SeenPlain
    return (SeenParts,) if isinstance(given, Scene) else ()


def _asked(kind: type[_Seen], given: Any) -> Any:
    """A scene as a kind is asked about it; None where it can't be."""
    return Parts.of(given) if kind is SeenParts else given


def _seen(given: Any, look: Look) -> _Seen | None:
    """What a scene can be known by; None if there is nothing, or it isn't worth it."""
    for kind in _kinds_of(given):
        asked = _asked(kind, given)
        if asked is not None:
            with contextlib.suppress(TypeError):
                seen: _Seen = kind(asked, look)
                return seen
    return None


def _size(seen: _Seen) -> int:
    return 0 if isinstance(seen, SeenScene) else seen.size
