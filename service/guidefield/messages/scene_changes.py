"""Changes of a scene, which add, move and remove obstacles, and a request's scene declared by them."""

from __future__ import annotations

import copy
import weakref
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Protocol

import msgspec

from guidefield.errors import SceneInvalid
from guidefield.messages.faults import list_choices, suggest
from guidefield.messages.own_scenes import Before, Own, Places, make_own, own, places_of
from guidefield.messages.scene import Box, Capsule, Cylinder, Mesh, Obstacle, Scene, Sphere
from guidefield.messages.values import Message, Name, Placement, Reply

MOST_CHANGES = 100_000
"""Most obstacles that one change may add, move or remove."""
FEW = 64
"""So few obstacles are sooner taken out one by one, of thousands."""
VERSIONS_KEPT = 16
"""So many versions of a stored scene can be asked for, the newest included."""

Added = Annotated[list[Obstacle], msgspec.Meta(max_length=MOST_CHANGES)]
Moved = Annotated[dict[Name, Placement], msgspec.Meta(max_length=MOST_CHANGES)]
Removed = Annotated[list[Name], msgspec.Meta(max_length=MOST_CHANGES)]
Version = Annotated[int, msgspec.Meta(ge=1)]


class SceneChange(Protocol):
    """Obstacles that are removed, moved and added, in this order."""

    @property
    def add(self) -> Sequence[Obstacle]:
        """Those that come."""

    @property
    def move(self) -> Mapping[str, Placement]:
        """New placements in the world, by the names of obstacles."""

    @property
    def remove(self) -> Sequence[str]:
        """The names of those that go."""


class SceneDiff(Message, tag_field="type", tag="scene_diff", kw_only=True):
    """A change of a stored scene.

    Attributes:
        add: Obstacles that come.
        move: Where obstacles stand from now on, in the world; of a sphere the position counts.
        remove: Names of obstacles that go, before others come: what is in both is replaced.
        version: The version that is meant; if the scene has another by now, nothing changes. None: whichever it has.
    """

    add: Added = []
    move: Moved = {}
    remove: Removed = []
    version: Version | None = None


class SceneChanged(Reply):
    """The message that is published when a stored scene was changed.

    Attributes:
        name: Its name.
        version: Its version from now on; None: it was deleted.
        diff: What changed; None: it was stored anew, or deleted.
    """

    name: str
    version: int | None
    diff: SceneDiff | None = None
    schema: int = 1


class RequestScene(Scene, kw_only=True, omit_defaults=True):
    """A scene that is sent with a request: declared whole, or as a stored one and what is changed about it.

    Attributes:
        name: Its name; where there is a `base` it may be left out.
        base: Name of the stored scene; None: obstacles and guide planes are declared here.
        version: The version of it that is meant; None: the newest.
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
        assert self.base is None, "what a base holds isn't known here"
        return Scene(self.name, self.schema, self.frame, self.obstacles, self.guide_planes)


def changed(scene: Scene, change: SceneChange, name: str = "") -> Scene:
    """A scene after a change.

    Args:
        scene: As it was.
        change: What goes, moves and comes.
        name: Its name from now on; empty: the one that it had.

    Returns:
        The scene from now on; the very same where nothing changes. It is ours where the one before was.

    Raises:
        SceneInvalid: if an obstacle is named that isn't there, comes under a name that is taken, comes twice, or has no
            placement that could be changed; `details` hold its name (as `obstacle`) and the `path` in the change.
    """
    if not (change.remove or change.move or change.add) and name in ("", scene.name):
        return scene
    places, obstacles = places_of(scene), [*scene.obstacles]
    removed = _removed(scene, places, change.remove)
    if removed:
        obstacles = _without(obstacles, removed)
        places = places.after(obstacles, removed, 0)
    moved = _move(scene.name, obstacles, places, change.move)
    if change.add:
        _require_new(scene.name, places, change.add)
        obstacles += change.add
        places = places.after(obstacles, (), len(change.add))
    after = copy.copy(scene)  # what a change leaves is not checked again
    msgspec.structs.force_setattr(after, "name", name or scene.name)
    msgspec.structs.force_setattr(after, "obstacles", obstacles)
    if own(scene) is not None:
        make_own(after, Own(Before(weakref.ref(scene), removed, moved, len(change.add)), places))
    return after


def _removed(scene: Scene, places: Places, names: Sequence[str]) -> list[int]:
    """Return the indices of removed obstacles, ascending."""
    removed: set[int] = set()
    for index, name in enumerate(names):
        place = places.of(name)
        if place is None or place in removed:
            left = [one for at, one in enumerate(scene.obstacles) if at not in removed]
            raise _absent(scene.name, name, left, f"$.remove[{index}]")
        removed.add(place)
    return sorted(removed)


def _without(obstacles: list[Obstacle], removed: Sequence[int]) -> list[Obstacle]:
    """Obstacles without some of them, by their indices."""
    if len(removed) > FEW:
        gone = set(removed)
        return [one for index, one in enumerate(obstacles) if index not in gone]
    for index in reversed(removed):
        del obstacles[index]
    return obstacles


def _move(scene: str, obstacles: list[Obstacle], places: Places, moves: Mapping[str, Placement]) -> list[int]:
    """Put those that move where they are from now on; which these are. The others aren't looked at."""
    moved = list[int]()
    for name in moves:
        place = places.of(name)
        if place is None:
            raise _absent(scene, name, obstacles, f"$.move.{name}")
        moved.append(place)
    moved.sort()
    for place in moved:
        obstacles[place] = _moved(obstacles[place], moves[obstacles[place].name])
    return moved


def _require_new(scene: str, there: Places, coming: Sequence[Obstacle]) -> None:
    """Refuse an obstacle that comes under a name that is taken."""
    new = set[str]()
    for index, one in enumerate(coming):
        path = f"$.add[{index}].name"
        if one.name in new:
            raise _refused(f"two obstacles {one.name!r} are to be added to scene {scene!r}", one.name, path)
        if there.of(one.name) is not None:
            raise _refused(
                f"scene {scene!r} has an obstacle {one.name!r} already; `remove` it in the same change to replace it",
                one.name,
                path,
            )
        new.add(one.name)


def _moved(obstacle: Obstacle, placement: Placement) -> Obstacle:
    where: dict[str, Any] = {"position": placement.position}
    if isinstance(obstacle, Box | Cylinder | Capsule | Mesh):
        where["quaternion_xyzw"] = placement.quaternion_xyzw
    elif not isinstance(obstacle, Sphere):
        kind = type(obstacle).__struct_config__.tag
        raise _refused(
            f"obstacle {obstacle.name!r} can't be moved: a {kind} has no placement of its own; `remove` it and `add` "
            "it anew in the same change",
            obstacle.name,
            f"$.move.{obstacle.name}",
        )
    if obstacle.trajectory is not None:
        raise _refused(
            f"obstacle {obstacle.name!r} can't be moved: its `trajectory` says where it is; `remove` it and `add` it "
            "anew in the same change",
            obstacle.name,
            f"$.move.{obstacle.name}",
        )
    moved: Obstacle = msgspec.structs.replace(obstacle, **where)
    return moved


def _absent(scene: str, name: str, there: Iterable[Obstacle], path: str) -> SceneInvalid:
    names = [one.name for one in there]
    others = f"there are {list_choices(names)}" if names else "there is none left"
    return _refused(f"scene {scene!r} has no obstacle {name!r}; {suggest(name, names)}{others}", name, path)


def _refused(message: str, obstacle: str, path: str) -> SceneInvalid:
    return SceneInvalid(message, obstacle=obstacle, path=path)
