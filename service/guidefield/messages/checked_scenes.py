"""Scenes that were checked already: who asks about a large one again and again has it checked once."""

from __future__ import annotations

from typing import NamedTuple

from guidefield.messages.own_scenes import make_own
from guidefield.messages.scene import Scene
from guidefield.messages.seen_scene import SeenScene
from guidefield.messages.values import Look, never

WORTH = 64
"""Scenes of fewer obstacles, corners and triangles are sooner checked than known again."""

MOST_PARTS = 4_000_000
"""Obstacles, corners and triangles of all that are kept; a million take some tens of megabytes."""


class _Checked(NamedTuple):
    seen: SeenScene
    scene: Scene


class CheckedScenes:
    """The scenes that were checked last.

    Args:
        most: How many are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: tuple[_Checked, ...] = ()

    def of(self, given: object, look: Look = never) -> Scene | None:
        """The checked form of a scene that holds what one did that was checked; None where none is known.

        Args:
            given: As it is given.
            look: Called again and again while a large one is compared.
        """
        if type(given) is not Scene:
            return None
        return next((one.scene for one in self._kept if one.seen.is_like(given, look)), None)

    def keep(self, given: object, checked: object, look: Look = never) -> None:
        """Keep a scene that passed.

        Args:
            given: As it was given.
            checked: As the decoder made it: nobody may change it any more, it is ours.
            look: Called again and again while a large one is looked at.
        """
        if type(given) is not Scene or not isinstance(checked, Scene):
            return
        try:
            seen = SeenScene(given, look)
        except TypeError:
            return
        if seen.parts >= WORTH:
            kept, left = [_Checked(seen, make_own(checked))], MOST_PARTS - seen.parts
            for one in self._kept[: self._most - 1]:
                left -= one.seen.parts
                if left >= 0:
                    kept.append(one)
            self._kept = tuple(kept)
