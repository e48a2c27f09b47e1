"""Build scenes; the last few are kept, by content."""

from __future__ import annotations

import contextlib

from guidefield.bounded_map import BUILT_SCENES, BYTES_PER_FACE, BoundedMap, Limit
from guidefield.collector import pause_collector
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.messages import scene as messages
from guidefield.messages.scene_changes import Derivation, FrozenFacts, frozen_facts
from guidefield.scene import scene as scenes
from guidefield.scene.content import Content, are_many, change_content, scene_content
from guidefield.scene.incremental import Rows
from guidefield.scene.scene import Scene

MANY = 1000  # a scene of fewer obstacles, corners, triangles and points is built within a hundredth of a second or two


class BuiltScenes:
    """The last built scenes, bounded in number and bytes."""

    def __init__(self, limit: Limit = BUILT_SCENES) -> None:
        self._scenes = BoundedMap[bytes, Scene](limit)

    def of(self, message: messages.Scene, deadline: Deadline = UNLIMITED) -> Scene:
        """Build the scene of a message, unless it is there.

        Raises as `build`, and DeadlineExpired if the deadline passed before a large one was built.
        """
        content, parts = self._content(message, deadline)
        built = self._scenes.get(content)
        if built is None:
            built = self._build(message, parts, deadline)
            size = BYTES_PER_FACE * built.faces  # as if none shared an obstacle
            built = self._scenes.insert(content, built, size)
        return built

    def _content(self, message: messages.Scene, deadline: Deadline) -> tuple[bytes, dict[int, Content]]:
        """Return the hash of a scene, and the hashes of those of its meshes and clouds that were hashed, by index.

        A frozen scene is hashed once; one that was derived from another, by its change alone.
        """
        changes: list[tuple[messages.Scene, FrozenFacts, Derivation]] = []
        while (mine := frozen_facts(message)) is not None and mine.content is None and mine.before is not None:
            before = mine.before.scene()
            if before is None:
                break
            changes.append((message, mine, mine.before))
            message = before
        content, parts = None if mine is None else mine.content, dict[int, Content]()
        if content is None:
            if _has_many(message):
                deadline.check(f"scene {message.name} was looked at")
            content, parts = scene_content(message)
            if mine is not None:
                mine.content = content
        for later, known, change in reversed(changes):
            content, parts = change_content(content, change, later)
            known.content = content
        return content, parts

    def _build(self, message: messages.Scene, parts: dict[int, Content], deadline: Deadline) -> Scene:
        """Build a scene, reusing the last built scene that it was derived from."""
        found = self._find_before(message)
        many = _has_many(message) if found is None else are_many([message.obstacles[k] for k in found[1].fresh], MANY)
        if many:
            deadline.check(f"scene {message.name} was built")
        with pause_collector() if many else contextlib.nullcontext():
            if found is None:
                return scenes.build(message, parts)
            return scenes.changed(found[0], message, found[1], parts)

    def _find_before(self, message: messages.Scene) -> tuple[Scene, Rows] | None:
        rows: Rows | None = None
        while (mine := frozen_facts(message)) is not None and mine.before is not None:
            before = mine.before.scene()
            if before is None:
                return None
            removed, moved = mine.before.removed, mine.before.moved
            step = Rows.changed(len(before.obstacles), removed, moved, len(message.obstacles))
            rows = step if rows is None else rows.after(step)
            known = frozen_facts(before)
            built = None if known is None or known.content is None else self._scenes.get(known.content)
            if built is not None:
                return (built, rows) if rows.are_few else None
            message = before
        return None


def _has_many(message: messages.Scene) -> bool:
    return are_many(message.obstacles, MANY) or are_many(message.guide_planes, MANY)
