"""The scene: obstacles as Coal shapes and as charges of the field, and guide planes; built once, found by content.

A scene never changes; a changed one is another that shares what stayed (`incremental.py`), with the same result as one
built anew. Tables for kernels are made of it elsewhere, on demand, and memoized with it.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import msgspec
import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.geometry.charged import expand_at_angle, field_tables
from guidefield.kernels.collide.primitive import PLACED
from guidefield.kernels.field.field import FieldTables
from guidefield.memo import SharedAnswer, memoized_by
from guidefield.memory import BUILT_SCENES, BYTES_PER_FACE, BoundedMap, Limit, pause_collector
from guidefield.messages import scene as messages
from guidefield.messages.scene_changes import Derivation, FrozenFacts, frozen_facts
from guidefield.scene import guide_plane, obstacle
from guidefield.scene.guide_plane import GuidePlane
from guidefield.scene.incremental import Rows, incremental, note_change
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.obstacle_message import Content, ObstacleMotion, are_many, change_content, put_at, scene_content

OPENING = 0.2
"""In the field, parts of a large mesh smaller than this times their distance are expanded: good to 5e-4, as
service/docs/algorithm.md says. Minimizers go other ways with another value; no proof reads the field."""

NO_CONTENTS: Mapping[int, Content] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class Scene(SharedAnswer):
    """A scene, ready to plan in: obstacles in the message's order, guide planes in the order to pass them.

    The warnings name obstacles with harmless oddities.
    """

    message: messages.Scene
    name: str
    obstacles: tuple[Obstacle, ...]
    guide_planes: tuple[GuidePlane, ...]
    warnings: tuple[str, ...]

    @cached_property
    def others(self) -> tuple[int, ...]:
        """Indices of obstacles that are no primitives at rest, ascending: few of thousands."""
        return tuple(index for index, one in enumerate(self.obstacles) if is_other(one))

    @cached_property
    def end(self) -> float:
        """Time at which the last obstacle comes to rest [s]; 0 if all are at rest."""
        return max((one.motion.end for one in self._others() if one.motion is not None), default=0.0)

    @cached_property
    def moves(self) -> bool:
        """True if any obstacle moves."""
        return any(one.motion is not None for one in self._others())

    @cached_property
    def most_faces(self) -> int:
        """The number of triangles or points of its largest obstacle; 0 if all are convex."""
        return max((one.faces for one in self._others()), default=0)

    @cached_property
    def faces(self) -> int:
        """The number of triangles and points of all obstacles that aren't convex."""
        return sum(one.faces for one in self._others())

    @cached_property
    def names(self) -> frozenset[str]:
        """The names of its obstacles."""
        return frozenset(one.name for one in self.obstacles)

    @cached_property
    def convex(self) -> bool:
        """True if Coal tests every obstacle as one convex body."""
        return all(one.convex for one in self._others())

    def _others(self) -> Iterator[Obstacle]:
        return map(self.obstacles.__getitem__, self.others)

    @property
    def resting(self) -> Scene:
        """The scene without the obstacles that move."""
        return self._resting if self.moves else self  # not cached in itself, or it would never be freed

    @cached_property
    def _resting(self) -> Scene:
        return self.of([index for index, one in enumerate(self.obstacles) if one.motion is None])

    def at(self, time: float) -> Scene:
        """Return the scene with every obstacle at rest where it is at a time [s]."""
        return _held(self, float(time)) if self.moves else self

    def since(self, time: float) -> Scene:
        """Return the scene from a time on [s], which is its time 0; obstacles that have stopped are at rest."""
        return self if time == 0.0 else self.with_moved(lambda one, motion: _since(one, motion, time))

    def with_moved(self, become: Callable[[messages.Obstacle, ObstacleMotion], messages.Obstacle]) -> Scene:
        """Return the scene with moving obstacles replaced by what `become` makes of them."""
        moving = [(index, motion) for index in self.others if (motion := self.obstacles[index].motion) is not None]
        if not moving:
            return self
        source, declared = np.arange(len(self.obstacles)), list(self.message.obstacles)
        for index, motion in moving:
            source[index], declared[index] = -1, become(declared[index], motion)
        return changed(self, declare_with(self.message, declared), Rows.of(source, len(self.obstacles)))

    def of(self, chosen: Sequence[int]) -> Scene:
        """Return the scene with some of its obstacles alone, by their indices."""
        message = declare_with(self.message, [self.message.obstacles[index] for index in chosen])
        return dataclasses.replace(self, message=message, obstacles=tuple(self.obstacles[index] for index in chosen))

    @cached_property
    def tables(self) -> FieldTables:
        """The field of all obstacles together."""
        return _tables(self.obstacles)

    def obstacle(self, name: str) -> Obstacle | None:
        """Return the obstacle of that name, or None."""
        return next((obstacle for obstacle in self.obstacles if obstacle.name == name), None)


def build(message: messages.Scene, contents: Mapping[int, Content] = NO_CONTENTS) -> Scene:
    """Build a scene from its message; hashes of some of its obstacles, by index, may be given.

    Raises SceneInvalid if an obstacle or guide plane can't be used; its details hold the name (as `obstacle` or
    `guide_plane`) and the `path` in the scene.
    """
    obstacles = obstacle.build_all(message.obstacles, contents)
    guide_planes = guide_plane.build_all(message.guide_planes)
    return Scene(
        message=message,
        name=message.name,
        obstacles=obstacles,
        guide_planes=guide_planes,
        warnings=tuple(warning for one in obstacles for warning in one.warnings),
    )


def changed(before: Scene, message: messages.Scene, rows: Rows, contents: Mapping[int, Content] = NO_CONTENTS) -> Scene:
    """Build a scene from its message, with the guide planes of the one that it was derived from.

    Only other obstacles, as the rows say, are built. Raises SceneInvalid as `build`.
    """
    fresh = [obstacle.build(message.obstacles[index], index, contents.get(index)) for index in rows.fresh]
    return with_others(before, rows, fresh, message)


def declare_with(message: messages.Scene, obstacles: list[messages.Obstacle]) -> messages.Scene:
    """Return a declared scene with other obstacles, which aren't checked again."""
    some = copy.copy(message)
    msgspec.structs.force_setattr(some, "obstacles", obstacles)
    return some


def with_others(before: Scene, rows: Rows, fresh: Sequence[Obstacle], message: messages.Scene) -> Scene:
    """Make a scene of another one's obstacles and some fresh ones, as the rows say, with its guide planes."""
    warned = before.warnings or any(one.warnings for one in fresh)
    obstacles = tuple(rows.listed(before.obstacles, fresh))
    scene = Scene(
        message=message,
        name=message.name,
        obstacles=obstacles,
        guide_planes=before.guide_planes,
        warnings=tuple(warning for one in obstacles for warning in one.warnings) if warned else (),
    )
    gone, come = ({one.name for one in some} for some in (map(before.obstacles.__getitem__, rows.removed), fresh))
    lost, new = gone - come, come - gone
    names = before.names.difference(lost) if lost else before.names  # a set of thousands is copied where it must be
    vars(scene)["names"] = names.union(new) if new else names
    others = [index for index, one in zip(rows.fresh, fresh, strict=True) if is_other(one)]
    vars(scene)["others"] = tuple(sorted([*rows.stayed(before.others), *others]))
    note_change(scene, before, rows)
    return scene


def is_other(one: Obstacle) -> bool:
    """Return whether an obstacle is no primitive at rest."""
    return one.motion is not None or not one.placed


def _held_at(scene: Scene, time: float) -> Scene:
    return scene.with_moved(lambda one, motion: put_at(one, motion.at(time)))


HELD = 2  # scenes at a time (`Scene.at`) that are kept: the first and the last are needed often

_held = memoized_by(lambda scene: scene, _held_at, HELD)


def _since(message: messages.Obstacle, motion: ObstacleMotion, time: float) -> messages.Obstacle:
    declared = message.trajectory
    assert declared is not None, "it moves"
    if motion.end <= time:
        return put_at(message, motion.placements[-1])
    later = messages.ObstacleTrajectory([at - time for at in declared.times], declared.placements)
    moving: messages.Obstacle = msgspec.structs.replace(message, trajectory=later)
    return moving


def _tables(obstacles: tuple[Obstacle, ...]) -> FieldTables:
    owners = [np.full(len(one.charges.triangles), index) for index, one in enumerate(obstacles)]
    return field_tables(
        np.concatenate([np.empty((0, 3, 3)), *(one.charges.triangles for one in obstacles)]),
        _charge_of_each(obstacles, "triangles"),
        *(_charge_rows(obstacles, kind, width) for kind, width in (("spheres", 4), ("capsules", 7), ("planes", 4))),
        triangle_owner=np.concatenate([np.empty(0, np.int64), *owners]),
        quads=np.concatenate([np.empty((0, 4, 3)), *(one.charges.quads for one in obstacles)]),
        quad_charge=_charge_of_each(obstacles, "quads"),
        boxes=_charge_rows(obstacles, "boxes", 15),
        cloud=np.concatenate(
            [np.empty((0, 5)), *(one.charges.cloud * [1.0, 1.0, 1.0, one.charge, 1.0] for one in obstacles)]
        ),
        opening=expand_at_angle(OPENING),
    )


def _charge_of_each(obstacles: tuple[Obstacle, ...], kind: str) -> np.ndarray:
    return np.concatenate([np.empty(0), *(np.full(len(getattr(one.charges, kind)), one.charge) for one in obstacles)])


def _charge_rows(obstacles: tuple[Obstacle, ...], kind: str, width: int) -> np.ndarray:
    rows = [np.insert(getattr(one.charges, kind), width, one.charge, axis=1) for one in obstacles]
    return np.concatenate([np.empty((0, width + 1)), *rows])


_NONE = bytes(PLACED.size)


def rows_of(obstacles: Sequence[Obstacle]) -> np.ndarray:
    """Return `Obstacle.placed` of each as a row, shape (n, 12), read-only; zeros if it is no primitive."""
    return np.frombuffer(b"".join([one.placed or _NONE for one in obstacles])).reshape(-1, PLACED.size // 8)


def _over(known: np.ndarray, rows: Rows, scene: Scene) -> np.ndarray:
    placed = rows.carry(known, rows_of([scene.obstacles[index] for index in rows.fresh]))
    placed.setflags(write=False)
    return placed


@incremental(_over)
def placed_rows(scene: Scene) -> np.ndarray:
    """Return `rows_of` a scene's obstacles; made once."""
    return rows_of(scene.obstacles)


def unplaced(scene: Scene) -> list[int]:
    """Return the indices of obstacles that are no primitives, ascending."""
    return [index for index in scene.others if not scene.obstacles[index].placed]


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
                return build(message, parts)
            return changed(found[0], message, found[1], parts)

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
