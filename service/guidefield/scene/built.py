"""Scenes that were built already: the last few are kept, known by their content."""

from __future__ import annotations

from collections import OrderedDict

from guidefield.aside import Spent, StoppedError, done_aside, wait_for_others
from guidefield.messages import codec, scene as messages
from guidefield.scene import scene as scenes
from guidefield.scene.content import Content, scene_content
from guidefield.scene.mesh import MOST_FACES
from guidefield.scene.points import count_of
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
        content, parts = self._known(message), dict[int, Content]()
        if content is None:
            if spent is not None and _has_many(message) and spent():
                raise StoppedError(f"scene {message.name} was looked at")
            content, parts = scene_content(message)
        built = self._scenes.pop(content, None)
        if built is None:
            built = scenes.build(message, parts) if spent is None else _built_in_time(message, parts, spent)
            while self._scenes and (len(self._scenes) >= self._most or self._faces() + _faces(built) > MOST_FACES):
                self._scenes.popitem(last=False)
        self._scenes[content] = built
        return built

    def _known(self, message: messages.Scene) -> bytes | None:
        """The hash of a checked message of which a scene was built; None of another."""
        same = (content for content, scene in self._scenes.items() if scene.message is message)
        return next(same, None) if codec.is_kept(message) else None

    def _faces(self) -> int:
        """Of all of them, as if none shared an obstacle."""
        return sum(map(_faces, self._scenes.values()))


def _built_in_time(message: messages.Scene, contents: dict[int, Content], spent: Spent) -> Scene:
    doing = f"scene {message.name} was built"
    if not _has_many(message):
        wait_for_others(spent)
        return scenes.build(message, contents)
    return done_aside(lambda: scenes.build(message, contents), spent, lambda: doing)


def _has_many(message: messages.Scene) -> bool:
    return len(message.obstacles) + sum(map(_parts, message.obstacles)) >= MANY


def _parts(obstacle: messages.Obstacle) -> int:
    """Of how many corners, triangles and points an obstacle is declared; 0 of a primitive."""
    match obstacle:
        case messages.Mesh():
            return count_of(obstacle.triangles) + count_of(obstacle.vertices)
        case messages.Polygon():
            return len(obstacle.vertices)
        case messages.PointCloud():
            return count_of(obstacle.points)
    return 0


def _faces(scene: Scene) -> int:
    return sum(one.faces for one in scene.obstacles)
