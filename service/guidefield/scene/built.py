"""Scenes that were built already: the last few are kept, known by their content."""

from __future__ import annotations

import hashlib
from collections import OrderedDict

import msgspec
import numpy as np

from guidefield.messages import scene as messages
from guidefield.scene import scene as scenes
from guidefield.scene.mesh import MOST_FACES, faces
from guidefield.scene.scene import Scene


class BuiltScenes:
    """The scenes that were built last, fewer where they have very many triangles or points.

    Args:
        most: How many are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._scenes: OrderedDict[bytes, Scene] = OrderedDict()

    def of(self, message: messages.Scene) -> Scene:
        """The scene that a message describes; raises as `build`."""
        content = hashlib.sha256(msgspec.msgpack.encode(message, enc_hook=np.generic.tolist)).digest()
        built = self._scenes.pop(content, None)
        if built is None:
            built = scenes.build(message)
            while self._scenes and (len(self._scenes) >= self._most or self._faces() + _faces(built) > MOST_FACES):
                self._scenes.popitem(last=False)
        self._scenes[content] = built
        return built

    def _faces(self) -> int:
        """Of all of them, as if none shared an obstacle."""
        return sum(map(_faces, self._scenes.values()))


def _faces(scene: Scene) -> int:
    return sum(faces(one.shape) for one in scene.obstacles)
