"""Changes of a scene, which add, move and remove obstacles; scenes of requests, declared by changes; frozen scenes.

A frozen scene isn't changed any more, so that all that is computed of it stays valid (`FrozenFacts`). A change of one
makes another frozen scene, which knows the one before it: scene/scene.py then builds only what changed. Fields and
docstrings of messages are the wire, and in docs/wire.schema.json: after a change, `tools/wire_page`.
"""

from __future__ import annotations

import copy
import weakref
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Protocol, TypeVar

import msgspec

from guidefield.errors import SceneInvalid
from guidefield.messages.faults import list_choices, suggest
from guidefield.messages.scene import Obstacle, Placed, Scene, Sphere
from guidefield.messages.values import Message, Name, Placement, Reply

_Declared = TypeVar("_Declared", bound=msgspec.Struct)

MAX_GONE_NUMBERS = 256
"""`NameIndex` numbers the obstacles anew after more removals, or more obstacles that only other versions have."""


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
        of_others = len(numbers) - len(gone) - len(self._obstacles)  # obstacles that only other versions have
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


MOST_CHANGES = 100_000
"""The largest number of obstacles that a change adds, moves or removes."""
MAX_SINGLE_DELETIONS = 64
"""Up to this number, deleting obstacles one by one is faster than making a new list of thousands."""
MAX_VERSIONS = 16
"""The number of newest versions of a stored scene that can be read; keys.py, clients and docs/scenes.md tell it."""

Added = Annotated[list[Obstacle], msgspec.Meta(max_length=MOST_CHANGES)]
Moved = Annotated[dict[Name, Placement], msgspec.Meta(max_length=MOST_CHANGES)]
Removed = Annotated[list[Name], msgspec.Meta(max_length=MOST_CHANGES)]
Version = Annotated[int, msgspec.Meta(ge=1)]


class SceneChange(Protocol):
    """Obstacles that are removed, moved and added, in this order."""

    @property
    def add(self) -> Sequence[Obstacle]:
        """Added obstacles."""

    @property
    def move(self) -> Mapping[str, Placement]:
        """New placements in the world, by name of the obstacle."""

    @property
    def remove(self) -> Sequence[str]:
        """Names of removed obstacles."""


class SceneDiff(Message, tag_field="type", tag="scene_diff", kw_only=True):
    """A change of a stored scene.

    Attributes:
        add: Added obstacles.
        move: New placements of obstacles in the world; of a sphere only the position counts.
        remove: Names of obstacles that are removed before others are added: one in both is replaced.
        version: The version to change; if the scene has another by now, nothing changes. None: the newest.
    """

    add: Added = []
    move: Moved = {}
    remove: Removed = []
    version: Version | None = None


class SceneChanged(Reply):
    """The message that is published when a stored scene was changed.

    Attributes:
        name: Its name.
        version: Its new version; None: it was deleted.
        diff: The change; None: it was stored anew, or deleted.
    """

    name: str
    version: int | None
    diff: SceneDiff | None = None
    schema: int = 1


class RequestScene(Scene, kw_only=True, omit_defaults=True):
    """A scene that is sent with a request: declared whole, or as changes of a stored one.

    Attributes:
        name: Its name; optional with a `base`.
        base: Name of the stored scene; None: obstacles and guide planes are declared here.
        version: The version of it; None: the newest.
        add, move, remove: As in `SceneDiff`, for this request only.
    """

    name: Name = ""
    base: Name | None = None
    version: Version | None = None
    add: Added = []
    move: Moved = {}
    remove: Removed = []

    def __post_init__(self) -> None:
        if self.base is None:
            if not self.name:
                raise ValueError("Object missing required field `name`")
            for field in ("version", "add", "move", "remove"):
                if getattr(self, field):
                    raise ValueError(f"`{field}` needs `base`, the name of the stored scene that it is about")
        else:
            for field, instead in (("obstacles", "use `add`"), ("guide_planes", "the request has `guide_planes`")):
                if getattr(self, field):
                    raise ValueError(f"`{field}` can't stand beside `base`: {instead}")
        super().__post_init__()

    @property
    def declared(self) -> Scene:
        """The scene itself; only without a `base`."""
        assert self.base is None, "a base is in a store"
        return Scene(self.name, self.schema, self.frame, self.obstacles, self.guide_planes)


def apply_change(scene: Scene, change: SceneChange, name: str = "") -> Scene:
    """Apply a change to a scene of a name; return the same object if nothing changes, a frozen one if it was frozen.

    Raises:
        SceneInvalid: if a named obstacle doesn't exist, an added one has a name that is taken, or a moved one has no
            placement; `details` hold its name (as `obstacle`) and the `path` in the change.
    """
    if not (change.remove or change.move or change.add) and name in ("", scene.name):
        return scene
    places, obstacles = name_index(scene), [*scene.obstacles]
    removed = _find_removed(scene, places, change.remove)
    if removed:
        obstacles = _drop(obstacles, removed)
        places = places.after(obstacles, removed, 0)
    moved = _move(scene.name, obstacles, places, change.move)
    if change.add:
        _require_new(scene.name, places, change.add)
        obstacles += change.add
        places = places.after(obstacles, (), len(change.add))
    after = copy.copy(scene)  # the other fields stay, and aren't checked again
    msgspec.structs.force_setattr(after, "name", name or scene.name)
    msgspec.structs.force_setattr(after, "obstacles", obstacles)
    if frozen_facts(scene) is not None:
        freeze(after, FrozenFacts(Derivation(weakref.ref(scene), removed, moved, len(change.add)), places))
    return after


def _find_removed(scene: Scene, places: NameIndex, names: Sequence[str]) -> list[int]:
    removed: set[int] = set()
    for index, name in enumerate(names):
        place = places.of(name)
        if place is None or place in removed:
            left = [one for at, one in enumerate(scene.obstacles) if at not in removed]
            raise _make_absent_error(scene.name, name, left, f"$.remove[{index}]")
        removed.add(place)
    return sorted(removed)


def _drop(obstacles: list[Obstacle], removed: Sequence[int]) -> list[Obstacle]:
    if len(removed) > MAX_SINGLE_DELETIONS:
        gone = set(removed)
        return [one for index, one in enumerate(obstacles) if index not in gone]
    for index in reversed(removed):
        del obstacles[index]
    return obstacles


def _move(scene: str, obstacles: list[Obstacle], places: NameIndex, moves: Mapping[str, Placement]) -> list[int]:
    """Replace the obstacles that move, and return their indices, ascending; the others aren't visited."""
    moved = list[int]()
    for name in moves:
        place = places.of(name)
        if place is None:
            raise _make_absent_error(scene, name, obstacles, f"$.move.{name}")
        moved.append(place)
    moved.sort()
    for place in moved:
        obstacles[place] = _place_obstacle(obstacles[place], moves[obstacles[place].name])
    return moved


def _require_new(scene: str, there: NameIndex, coming: Sequence[Obstacle]) -> None:
    new = set[str]()
    for index, one in enumerate(coming):
        path = f"$.add[{index}].name"
        if one.name in new:
            raise _make_error(f"two obstacles {one.name!r} are to be added to scene {scene!r}", one.name, path)
        if there.of(one.name) is not None:
            raise _make_error(
                f"scene {scene!r} has an obstacle {one.name!r} already; `remove` it in the same change to replace it",
                one.name,
                path,
            )
        new.add(one.name)


def _place_obstacle(obstacle: Obstacle, placement: Placement) -> Obstacle:
    where: dict[str, Any] = {"position": placement.position}
    if isinstance(obstacle, Placed):
        where["quaternion_xyzw"] = placement.quaternion_xyzw
    elif not isinstance(obstacle, Sphere):
        kind = type(obstacle).__struct_config__.tag
        raise _make_error(
            f"obstacle {obstacle.name!r} can't be moved: a {kind} has no placement of its own; `remove` it and `add` "
            "it anew in the same change",
            obstacle.name,
            f"$.move.{obstacle.name}",
        )
    if obstacle.trajectory is not None:
        raise _make_error(
            f"obstacle {obstacle.name!r} can't be moved: its `trajectory` says where it is; `remove` it and `add` it "
            "anew in the same change",
            obstacle.name,
            f"$.move.{obstacle.name}",
        )
    moved: Obstacle = msgspec.structs.replace(obstacle, **where)
    return moved


def _make_absent_error(scene: str, name: str, there: Iterable[Obstacle], path: str) -> SceneInvalid:
    names = [one.name for one in there]
    others = f"there are {list_choices(names)}" if names else "there is none left"
    return _make_error(f"scene {scene!r} has no obstacle {name!r}; {suggest(name, names)}{others}", name, path)


def _make_error(message: str, obstacle: str, path: str) -> SceneInvalid:
    return SceneInvalid(message, obstacle=obstacle, path=path)
