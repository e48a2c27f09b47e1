"""Scenes that were built already: the last few are kept, known by their content."""

from __future__ import annotations

import hashlib
from collections import OrderedDict

import msgspec
import numpy as np

from guidefield.aside import Spent, done_aside, wait_for_others
from guidefield.messages import scene as messages
from guidefield.messages.values import Float32Array
from guidefield.scene import scene as scenes
from guidefield.scene.mesh import MOST_FACES
from guidefield.scene.scene import Scene

MANY = 1000
"""A scene of fewer obstacles, triangles and points is built within a hundredth of a second or two."""


class BuiltScenes:
    """The scenes that were built last, fewer where they have very many triangles or points.

    Args:
        most: How many are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._scenes: OrderedDict[bytes, Scene] = OrderedDict()

    def of(self, message: messages.Scene, spent: Spent | None = None) -> Scene:
        """The scene that a message describes; raises as `build`.

        Args:
            message: The scene.
            spent: Whether time is up; None: it may take as long as it does.

        Raises:
            StoppedError: if time was up before it was built.
        """
        content = hashlib.sha256(msgspec.msgpack.encode(message, enc_hook=np.generic.tolist)).digest()
        built = self._scenes.pop(content, None)
        if built is None:
            built = scenes.build(message) if spent is None else _built_in_time(message, spent)
            while self._scenes and (len(self._scenes) >= self._most or self._faces() + _faces(built) > MOST_FACES):
                self._scenes.popitem(last=False)
        self._scenes[content] = built
        return built

    def _faces(self) -> int:
        """Of all of them, as if none shared an obstacle."""
        return sum(map(_faces, self._scenes.values()))


def _built_in_time(message: messages.Scene, spent: Spent) -> Scene:
    doing = f"scene {message.name} was built"
    if sum(map(_declared, message.obstacles)) < MANY:
        wait_for_others(spent)
        return scenes.build(message)
    return done_aside(lambda: scenes.build(message), spent, lambda: doing)


def _declared(obstacle: messages.Obstacle) -> int:
    """Of how many parts an obstacle is declared."""
    lists = (getattr(obstacle, parts, ()) for parts in ("triangles", "points", "vertices"))
    return 1 + sum(len(one.float32) // 12 if isinstance(one, Float32Array) else len(one) for one in lists)


def _faces(scene: Scene) -> int:
    return sum(one.faces for one in scene.obstacles)
