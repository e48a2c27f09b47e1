"""What changes about a scene: obstacles that are added, moved and removed; and a request's scene that is told so."""

from __future__ import annotations

import copy
import operator
from collections.abc import Mapping, Sequence
from itertools import compress, count
from typing import Annotated, Any, Protocol

import msgspec

from guidefield.errors import SceneInvalid
from guidefield.messages.faults import listed, meant
from guidefield.messages.scene import Box, Capsule, Cylinder, Mesh, Obstacle, Scene, Sphere
from guidefield.messages.values import Message, Name, Placement, Reply

MOST_CHANGES = 100_000
"""Most obstacles that one change may add, move or remove."""
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
        """Where those named stand from now on, in the world."""

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
    """What is published when a stored scene was changed.

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

    Raises:
        SceneInvalid: if an obstacle is named that isn't there, comes under a name that is taken, comes twice, or has no
            placement that could be changed; `details` hold its name (as `obstacle`) and the `path` in the change.
    """
    obstacles = _removed(scene, change.remove)
    _move(scene.name, obstacles, change.move)
    _add(scene.name, obstacles, change.add)
    after = copy.copy(scene)  # what a change leaves is not checked again
    msgspec.structs.force_setattr(after, "name", name or scene.name)
    msgspec.structs.force_setattr(after, "obstacles", obstacles)
    return after


_NAME = operator.attrgetter("name")


def _removed(scene: Scene, gone: Sequence[str]) -> list[Obstacle]:
    """The obstacles of a scene but for those that go, in a list of their own."""
    if not gone:
        return list(scene.obstacles)
    left = {one.name: one for one in scene.obstacles}
    for index, name in enumerate(gone):
        if name not in left:
            raise _absent(scene.name, name, list(left), f"remove[{index}]")
        del left[name]
    return list(left.values())


def _move(scene: str, obstacles: list[Obstacle], moves: Mapping[str, Placement]) -> None:
    """Put those that move where they are from now on; nothing is done for the others but to look at their names."""
    if not moves:
        return
    places = list(compress(count(), map(moves.__contains__, map(_NAME, obstacles))))
    if len(places) < len(moves):
        names = [*map(_NAME, obstacles)]
        there = set(names)
        absent = next(name for name in moves if name not in there)
        raise _absent(scene, absent, names, f"move.{absent}")
    for place in places:
        obstacles[place] = _moved(obstacles[place], moves[obstacles[place].name])


def _add(scene: str, obstacles: list[Obstacle], coming: Sequence[Obstacle]) -> None:
    """Put those that come behind the others."""
    if not coming:
        return
    there, added = set(map(_NAME, obstacles)), set[str]()
    for index, one in enumerate(coming):
        path = f"add[{index}].name"
        if one.name in added:
            raise _refused(f"two obstacles {one.name!r} are to be added to scene {scene!r}", one.name, path)
        if one.name in there:
            raise _refused(
                f"scene {scene!r} has an obstacle {one.name!r} already; `remove` it in the same change to replace it",
                one.name,
                path,
            )
        added.add(one.name)
        obstacles.append(one)


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
            f"move.{obstacle.name}",
        )
    if obstacle.trajectory is not None:
        raise _refused(
            f"obstacle {obstacle.name!r} can't be moved: its `trajectory` says where it is; `remove` it and `add` it "
            "anew in the same change",
            obstacle.name,
            f"move.{obstacle.name}",
        )
    moved: Obstacle = msgspec.structs.replace(obstacle, **where)
    return moved


def _absent(scene: str, name: str, names: list[str], path: str) -> SceneInvalid:
    there = f"there are {listed(names)}" if names else "there is none left"
    return _refused(f"scene {scene!r} has no obstacle {name!r}; {meant(name, names)}{there}", name, path)


def _refused(message: str, obstacle: str, path: str) -> SceneInvalid:
    return SceneInvalid(message, obstacle=obstacle, path=path)
