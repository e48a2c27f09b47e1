"""Scenes that were built already: the last few are kept, known by their content."""

from __future__ import annotations

import hashlib
from collections import OrderedDict

from guidefield.messages import codec, scene as messages
from guidefield.scene import scene as scenes
from guidefield.scene.scene import Scene


class BuiltScenes:
    """The scenes that were built last.

    Args:
        most: How many are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._scenes: OrderedDict[bytes, Scene] = OrderedDict()

    def of(self, message: messages.Scene) -> Scene:
        """The scene that a message describes; raises as `build`."""
        content = hashlib.sha256(codec.encode(message, codec.Encoding.MSGPACK)).digest()
        built = self._scenes.pop(content, None) or scenes.build(message)
        self._scenes[content] = built
        if len(self._scenes) > self._most:
            self._scenes.popitem(last=False)
        return built
